"""Faults of the world: no space, no place, no reader, no locale, killed. Nothing half-written, and
the same command goes on.
"""

from __future__ import annotations

import hashlib
import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hiltestbed.compiled.kernel_cache import VARIABLE, settle
from hiltestbed.config.gallery import shipped
from hiltestbed.run_folder.store import read_run
from tests.slow import SLOW

BUMPER = shipped("scenarios") / "02-bumper.yaml"
CAMPAIGN = f"""scenario: {BUMPER}
set: {{duration: 0.3}}
vary: {{sensor.delay: {{values: [0.001, 0.002, 0.003, 0.004, 0.005, 0.006]}}}}
design: {{kind: grid}}
"""
LANGUAGES = {
    "ascii": {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"},
    "unknown": {"LANG": "xx_XX"},
}

FILES = {"scenario.yaml", "summary.json", "trace.parquet", "report.html"}


def start(
    *arguments: str,
    env: dict[str, str] | None = None,
    before: Callable[[], None] | None = None,
    **more,
) -> subprocess.Popen:
    order = [sys.executable, "-m", "hiltestbed.cli", *arguments]
    return subprocess.Popen(
        order, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=env, preexec_fn=before, **more
    )


def ended(process: subprocess.Popen, seconds: float = 300.0) -> tuple[int, str, str]:
    out, err = process.communicate(timeout=seconds)
    return process.returncode, out.decode(errors="replace"), err.decode(errors="replace")


def short(folder: Path, *more: str) -> list[str]:
    return ["run", str(BUMPER), "--set", "duration=0.2", "--no-rerun", "--out", str(folder), *more]


def _small_files(size: int) -> Callable[[], None]:
    def before() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    return before


@pytest.fixture(scope="session")
def warm(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Compiled kernels, so that what is timed below is the work."""
    assert ended(start(*short(tmp_path_factory.mktemp("warm") / "r")))[0] == 0


@pytest.mark.parametrize("size", [20_000, 300_000, 1_000_000])
def test_a_full_disk_leaves_nothing_half_written(tmp_path: Path, size: int) -> None:
    """The trace does not fit; and, of a run with a recording, the recording alone."""
    order = short(tmp_path / "r", "--set", "duration=0.4")
    order.remove("--no-rerun")
    status, _, err = ended(start(*order, before=_small_files(size)), 120)
    assert status == 1
    assert "Traceback" not in err
    assert "File too large" in err
    assert list(tmp_path.iterdir()) == []
    if size == 20_000:
        assert ended(start(*short(tmp_path / "r")))[0] == 0


@SLOW
def test_nobody_reads_standard_output(tmp_path: Path) -> None:
    process = start(*short(tmp_path / "r"))
    assert process.stdout is not None
    process.stdout.close()
    assert process.stderr is not None
    err = process.stderr.read()
    assert process.wait(timeout=300) == 1
    assert b"Traceback" not in err
    assert set(os.listdir(tmp_path / "r")) == FILES


# each compiles the kernels: nowhere to keep them
@SLOW
@pytest.mark.parametrize("language", LANGUAGES)
def test_no_home_no_locale_and_forty_columns(tmp_path: Path, language: str) -> None:
    names = {"PATH", "PYTHONPATH", VARIABLE} & set(os.environ)
    env = {name: os.environ[name] for name in names} | {"COLUMNS": "40", "TERM": "dumb"}
    env |= LANGUAGES[language]
    scenario = BUMPER.read_text().replace("name: ", "name: ß→µ ")
    (tmp_path / "s.yaml").write_text(scenario, encoding="utf-8")
    order = ["run", str(tmp_path / "s.yaml"), *short(tmp_path / "r")[2:]]
    status, out, err = ended(start(*order, env=env))
    assert (status, "Traceback" in err) == (0, False), err
    assert out
    files = str(tmp_path / "r" / "scenario.yaml"), str(tmp_path / "none.yaml")
    status, _, err = ended(start("check", *files, env=env))
    assert (status, "Traceback" in err) == (2, False)


@pytest.mark.parametrize("part", [0.3, 0.6, 0.85])
@SLOW
@pytest.mark.usefixtures("warm")
def test_killed_while_it_runs(tmp_path: Path, part: float) -> None:
    """The folder is complete or absent, whenever the process dies; the same command then does
    it.
    """
    whole = time.monotonic()
    assert ended(start(*short(tmp_path / "whole")))[0] == 0
    whole = time.monotonic() - whole
    process = start(*short(tmp_path / "r"))
    time.sleep(part * whole)
    process.kill()
    process.communicate()
    if (tmp_path / "r").exists():
        assert read_run(tmp_path / "r").trace is not None
    assert ended(start(*short(tmp_path / "r")))[0] == 0
    assert _sha(tmp_path / "r" / "trace.parquet") == _sha(tmp_path / "whole" / "trace.parquet")


@SLOW
def test_a_sweep_that_is_killed_goes_on_to_the_same_bytes(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text(CAMPAIGN)
    order = ["sweep", str(tmp_path / "c.yaml"), "--workers", "1", "--chunk", "1"]
    begin = time.monotonic()
    assert ended(start(*order, "--out", str(tmp_path / "whole")))[0] == 0
    lasts = time.monotonic() - begin
    rng = np.random.default_rng(5)
    for _ in range(2):
        process = start(*order, "--out", str(tmp_path / "killed"))
        time.sleep(lasts * rng.uniform(0.3, 1.0))
        process.kill()
        process.communicate()
    assert ended(start(*order, "--out", str(tmp_path / "killed")))[0] == 0
    assert json.loads((tmp_path / "killed" / "campaign.json").read_text())["status"] == "complete"
    assert _sha(tmp_path / "killed" / "cases.parquet") == _sha(tmp_path / "whole" / "cases.parquet")


def _bytes(folder: Path, **way) -> str:
    """SHA-256 of the trace of a run with noise."""
    order = short(folder, "--set", "sensor.noise=0.5", "--set", "seed=11")
    status, _, err = ended(start(*order, **way), 590)
    assert status == 0, err
    return _sha(folder / "trace.parquet")


def test_same_seed_same_bytes(tmp_path: Path) -> None:
    """In another process, folder and working directory, with other numbers of threads."""
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    found = {"PYTHONPATH": os.pathsep.join([str(Path.cwd()), os.environ.get("PYTHONPATH", "")])}
    threads = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "PYTHONHASHSEED": "7"}
    there = _bytes(elsewhere / "r", env=os.environ | found | threads, cwd=elsewhere)
    assert there == _bytes(tmp_path / "plain")


@SLOW
def test_same_seed_same_bytes_of_kernels_compiled_anew(tmp_path: Path) -> None:
    fresh = os.environ | {VARIABLE: str(tmp_path / "kernels")}
    assert _bytes(tmp_path / "fresh", env=fresh) == _bytes(tmp_path / "plain")


def _sha(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_kernels_have_a_place_where_package_and_home_are_read_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    for environment in ({}, {"HOME": "/nowhere"}, {VARIABLE: "/dev/null/x"}):
        settle(Path("/usr/lib/hiltestbed"), environment, lambda folder: False)
        assert Path(environment[VARIABLE]).is_dir()
    left_alone: dict[str, str] = {"HOME": "/home/x"}
    settle(Path("/usr/lib/hiltestbed"), left_alone, lambda folder: "home" in str(folder))
    assert VARIABLE not in left_alone
    hostile = Path(tmp_path) / f"hiltestbed-kernels-{os.getuid()}"
    hostile.chmod(0o777)
    environment = {}
    settle(Path("/usr/lib/hiltestbed"), environment, lambda folder: False)
    assert environment[VARIABLE] != str(hostile)


@SLOW
def test_a_cache_that_cannot_be_written_is_passed_over(tmp_path: Path) -> None:
    env = os.environ | {VARIABLE: "/dev/null/x", "TMPDIR": str(tmp_path)}
    status, _, err = ended(start(*short(tmp_path / "r"), env=env), 590)
    assert status == 0, err
