"""The result folder: the same bytes whoever ran it, however often ended; never another's."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from hiltestbed.campaign import store
from hiltestbed.campaign.engines import run_chunk_of
from hiltestbed.campaign.schema import LoadedCampaign, load_campaign
from hiltestbed.campaign.store import Store
from hiltestbed.campaign.sweep import case_scenario, read_sweep, sweep
from hiltestbed.errors import HiltestbedError, InputError
from hiltestbed.run_folder.versions import provenance
from hiltestbed.scenario import scenario_sha256
from tests.campaign.conftest import written
from tests.slow import SLOW, slow

DEADLINE = 120.0  # [s] for what takes a few: a busy machine compiles slowly


@pytest.fixture(scope="module")
def in_one_go(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result folder of the campaign, run in this process in chunks of 256."""
    file = written(tmp_path_factory.mktemp("expected"))
    return sweep(file, file.parent / "out", chunk=256).folder


@pytest.fixture(scope="module")
def of_small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = written(tmp_path_factory.mktemp("small"))
    return sweep(load_campaign(file, {"design.cases": 8}), file.parent / "out").folder


@pytest.fixture
def swept(of_small: Path, tmp_path: Path) -> Path:
    """The result folder of the small campaign."""
    return Path(shutil.copytree(of_small, tmp_path / "out"))


@pytest.fixture
def expected(in_one_go: Path) -> bytes:
    """cases.parquet as it has to be."""
    return (in_one_go / "cases.parquet").read_bytes()


def command(file: Path, *more: str) -> list[str]:
    called = [sys.executable, "-m", "hiltestbed.cli", "sweep", str(file)]
    return [*called, "--out", str(file.parent / "out"), *more]


def wait_for(condition, what: str) -> None:
    end = time.monotonic() + DEADLINE
    while not condition():
        assert time.monotonic() < end, f"waited {DEADLINE:.0f} s for {what}"
        time.sleep(0.02)


def chunks_in(folder: Path) -> int:
    return len(list((folder / "chunks").glob("*.parquet")))


def is_gone(group: int) -> bool:
    """Whether no process of a group is left."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return True
    return False


def test_the_same_bytes_whatever_the_chunks(
    campaign: LoadedCampaign, tmp_path: Path, expected: bytes
) -> None:
    result = sweep(campaign, tmp_path / "out", chunk=7)
    assert (tmp_path / "out" / "cases.parquet").read_bytes() == expected
    assert result.about["status"] == "complete"
    assert result.about["counts"] == {"completed": 96}
    assert result.cases()["case"].to_pylist() == list(range(96))
    assert not (tmp_path / "out" / "chunks").exists()


def test_a_second_sweep_has_nothing_to_do(small: LoadedCampaign, swept: Path) -> None:
    before = {file.name: file.stat().st_mtime_ns for file in swept.iterdir()}
    sweep(small, swept, chunk=8)
    assert {file.name: file.stat().st_mtime_ns for file in swept.iterdir()} == before


def begun(file: Path, *more: str) -> subprocess.Popen:
    """A sweep in a process group of its own, after its first chunk."""
    before = chunks_in(file.parent / "out")
    process = subprocess.Popen(
        command(file, *more),
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )
    wait_for(lambda: chunks_in(file.parent / "out") > before, "a chunk")
    return process


def interrupted(file: Path) -> None:
    """Ctrl-C, as a terminal does it: the workers get it too."""
    process = begun(file, "--workers", "2", "--chunk", "3")
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=DEADLINE)
    assert process.returncode == 1
    assert b"the same command resumes" in err
    assert b"Traceback" not in err
    wait_for(lambda: is_gone(process.pid), "the workers to end")


def killed_alone(file: Path) -> None:
    """`kill -9` of the command; its workers end by themselves."""
    process = begun(file, "--workers", "2", "--chunk", "2")
    process.kill()
    process.wait()
    wait_for(lambda: is_gone(process.pid), "the workers to end")


@pytest.mark.parametrize("way", [interrupted, slow(killed_alone)], ids=lambda way: way.__name__)
def test_ended_in_every_way_it_goes_on_to_the_same_bytes(
    way: Callable[[Path], None], file: Path, tmp_path: Path, expected: bytes
) -> None:
    """In other chunks, and in this process."""
    out = tmp_path / "out"
    way(file)
    assert not (out / "cases.parquet").exists()
    assert 2 <= int(store.Store(out, load_campaign(file)).done().sum()) < 96
    sweep(file, out, chunk=7)
    assert (out / "cases.parquet").read_bytes() == expected


@SLOW
def test_a_worker_that_is_killed_is_replaced(file: Path, tmp_path: Path, expected: bytes) -> None:
    out = tmp_path / "out"
    process = begun(file, "--workers", "2", "--chunk", "3")
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    spawned = (p for p in children if b"spawn_main" in Path(f"/proc/{p}/cmdline").read_bytes())
    os.kill(int(next(spawned)), signal.SIGKILL)
    _, err = process.communicate(timeout=DEADLINE)
    assert process.returncode == 0, err
    assert (out / "cases.parquet").read_bytes() == expected


@SLOW
def test_on_a_cluster_with_a_worker_killed_the_same_bytes(
    file: Path, tmp_path: Path, expected: bytes
) -> None:
    """A scheduler and two workers on the loopback address, started as a user starts them."""
    pytest.importorskip("distributed")
    dask = str(Path(sys.executable).with_name("dask"))
    where = tmp_path / "scheduler.json"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": tmp_path}
    at = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(where)]
    started = [subprocess.Popen([dask, "scheduler", *at], **quiet)]
    try:
        wait_for(where.exists, "the scheduler")
        time.sleep(0.2)
        address = json.loads(where.read_text())["address"]
        worker = [dask, "worker", address, "--nthreads", "1", "--no-dashboard", "--no-nanny"]
        started += [subprocess.Popen(worker, **quiet) for _ in range(2)]
        process = subprocess.Popen(
            command(file, "--scheduler", address, "--chunk", "3"),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        wait_for(lambda: chunks_in(tmp_path / "out") >= 2, "two chunks")
        started[1].kill()
        _, err = process.communicate(timeout=DEADLINE)
    finally:
        for other in started:
            other.kill()
            other.wait()
    assert process.returncode == 0, err
    assert (tmp_path / "out" / "cases.parquet").read_bytes() == expected


def test_a_scheduler_that_does_not_answer_is_said_within_seconds(
    small: LoadedCampaign, tmp_path: Path
) -> None:
    pytest.importorskip("distributed")
    start = time.monotonic()
    with pytest.raises(InputError, match="does not answer within"):
        sweep(small, tmp_path / "out", scheduler="tcp://127.0.0.1:9")
    assert time.monotonic() - start < 15.0
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "address", ["nonsense", "http://127.0.0.1:8786", "tcp://127.0.0.1", "tcp://a b:1"]
)
def test_what_is_no_address_is_refused_at_once(
    small: LoadedCampaign, tmp_path: Path, address: str
) -> None:
    with pytest.raises(InputError, match="is no address of a scheduler"):
        sweep(small, tmp_path / "out", scheduler=address)
    assert not (tmp_path / "out").exists()


def test_a_folder_of_another_campaign_is_refused_untouched(file: Path, swept: Path) -> None:
    before = {path.name: path.read_bytes() for path in swept.iterdir()}
    for change in (
        {"design.seed": 4},
        {"vary": {"sensor.delay": {"uniform": [0.0, 0.02]}}},
        {"keep": "trace"},
        {"set": {"sensor.noise": 0.1}},
    ):
        other = load_campaign(file, {"design.cases": 8} | change)
        with pytest.raises(InputError, match="belongs to another campaign"):
            sweep(other, swept)
    assert {path.name: path.read_bytes() for path in swept.iterdir()} == before


def test_a_folder_with_other_things_in_it_is_refused_untouched(
    small: LoadedCampaign, tmp_path: Path
) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.tex").write_text("x")
    (tmp_path / "file").write_text("x")
    for name in ("thesis", "file"):
        with pytest.raises(InputError, match="allowed is a new folder or this campaign's own"):
            sweep(small, tmp_path / name)
    assert [path.name for path in (tmp_path / "thesis").iterdir()] == ["chapter.tex"]


def test_a_folder_begun_with_other_versions_is_refused(
    small: LoadedCampaign, swept: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store, "provenance", lambda: {"mujoco": "9.9"})
    with pytest.raises(InputError, match="other versions of mujoco"):
        sweep(small, swept)


def test_a_folder_whose_first_write_met_a_full_disk_goes_on(
    small: LoadedCampaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whichever write it was: the first, or one of the files that belong to it."""
    whole = store.write_whole
    for name in (store.ABOUT, store.SCENARIO, store.CAMPAIGN):

        def full(path: Path, content: bytes, name: str = name) -> None:
            if path.name == name:
                path.with_name(path.name + ".partial").touch()  # killed
                raise OSError(28, "No space left on device", str(path))
            whole(path, content)

        monkeypatch.setattr(store, "write_whole", full)
        with pytest.raises(OSError, match="No space left"):
            sweep(small, tmp_path / "out")
    monkeypatch.setattr(store, "write_whole", whole)
    assert sweep(small, tmp_path / "out").about["status"] == "complete"
    assert not list((tmp_path / "out").rglob("*.partial"))
    assert (tmp_path / "out" / store.SCENARIO).is_file()


def test_a_folder_with_a_name_that_is_no_utf8(small: LoadedCampaign, tmp_path: Path) -> None:
    done = sweep(small, tmp_path / os.fsdecode(b"\xff"))
    assert done.cases().num_rows == small.spec.cases


def test_a_worker_with_other_code_under_the_same_version_is_refused(small: LoadedCampaign) -> None:
    expected = provenance()
    assert len(run_chunk_of(small, (0,), expected).rows) == 1
    for other in ({"hiltestbed's code": "0" * 64}, {"plugin mine.py": "0" * 64}):
        with pytest.raises(HiltestbedError, match=f"other code.*{next(iter(other))}"):
            run_chunk_of(small, (0,), expected | other)


def test_two_sweeps_do_not_work_in_one_folder(small: LoadedCampaign, tmp_path: Path) -> None:
    with (
        Store.opened(tmp_path / "out", small),
        pytest.raises(InputError, match="another sweep is at work"),
    ):
        sweep(small, tmp_path / "out")


def test_a_full_disk_loses_the_chunk_under_way_and_a_garbled_one_is_run_again(
    campaign: LoadedCampaign, tmp_path: Path, expected: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = store.write_whole
    written = []

    def until_full(path: Path, content: bytes) -> None:
        if path.suffix == ".parquet" and sum(other.suffix == ".parquet" for other in written) == 2:
            path.with_name(path.name + ".partial").write_bytes(content[:100])
            raise OSError(28, "No space left on device")
        written.append(path)
        whole(path, content)

    monkeypatch.setattr(store, "write_whole", until_full)
    with pytest.raises(OSError, match="No space left"):
        sweep(campaign, tmp_path / "out", chunk=8)
    assert chunks_in(tmp_path / "out") == 2
    monkeypatch.undo()
    garbled = min((tmp_path / "out" / "chunks").glob("*.parquet"))
    garbled.write_bytes(garbled.read_bytes()[:-200])
    sweep(campaign, tmp_path / "out", chunk=32)
    assert (tmp_path / "out" / "cases.parquet").read_bytes() == expected


def test_the_report_stands_alone_and_names_the_commands(in_one_go: Path) -> None:
    page = (in_one_go / "report.html").read_text()
    assert "http" not in page
    for words in ("96 cases: 96 completed", "--case", "Sobol", "data:image/png"):
        assert words in page


def test_a_case_repeats_from_the_folder_alone(file: Path, tmp_path: Path) -> None:
    """The campaign was swept with an override; the folder is moved and its sources are gone."""
    changed = load_campaign(file, {"design.cases": 8, "set": {"spacecraft.chaser.mass": 60.0}})
    row = sweep(changed, tmp_path / "out").cases().to_pylist()[5]
    (tmp_path / "out").rename(tmp_path / "moved")
    file.unlink()
    again = load_campaign(tmp_path / "moved" / "campaign.yaml")
    assert scenario_sha256(case_scenario(again, 5)) == row["scenario_sha256"]
    assert sweep(again, tmp_path / "moved").about["status"] == "complete", "the folder is its own"


def test_what_is_read_back_is_what_was_swept(small: LoadedCampaign, swept: Path) -> None:
    assert read_sweep(swept) == sweep(small, swept)
    with pytest.raises(InputError, match="is not a campaign's folder"):
        read_sweep(swept.parent)


@pytest.mark.parametrize("options", [{"chunk": 0}, {"chunk": 10**6}, {"workers": 0}])
def test_options_out_of_range_are_refused(
    small: LoadedCampaign, tmp_path: Path, options: dict[str, int]
) -> None:
    with pytest.raises(HiltestbedError, match="out of range"):
        sweep(small, tmp_path / "out", **options)  # type: ignore[arg-type]
