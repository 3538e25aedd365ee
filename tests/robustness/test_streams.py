"""What is shown is text, whoever writes it; a stream that is closed or full, a name that is no
UTF-8 and a limit of memory end in words, with the results written.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest
from rich.table import Table

from hiltestbed.analysis.comparison import compare, write_comparison
from hiltestbed.errors import InputError
from hiltestbed.process.output import console, escaped, overwrite
from hiltestbed.run_folder.store import refuse_foreign, whole_folder, write_run
from hiltestbed.scenario import load_scenario
from tests.robustness.test_world import BUMPER
from tests.running import run
from tests.scripts import CLI, program

HOSTILE = "\x1b]0;owned\a \x9b31m \u202e \x7f \udcff"


def shell(folder: Path, redirection: str, *arguments: str) -> tuple[int, str]:
    """A command with its streams redirected by the shell: status, all that could be read."""
    order = ["/bin/sh", "-c", f'"$0" -m hiltestbed.cli "$@" {redirection}', sys.executable]
    path = os.pathsep.join([str(Path.cwd()), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [*order, *arguments],
        capture_output=True,
        timeout=300,
        text=True,
        cwd=folder,
        env=os.environ | {"PYTHONPATH": path},
    )
    return done.returncode, done.stdout + done.stderr


def test_every_writer_is_escaped(capsys: pytest.CaptureFixture[str]) -> None:
    with escaped():
        print(HOSTILE, json.dumps({"name": HOSTILE}), sep="\n")
        sys.stderr.write(HOSTILE)
        overwrite(HOSTILE)
        table = Table(title=HOSTILE)
        table.add_column(HOSTILE)
        table.add_row(HOSTILE)
        console().print(table)
    out, err = capsys.readouterr()
    assert all(c.isprintable() or c == "\n" for c in out + err)
    assert json.loads(out.splitlines()[1]) == {"name": HOSTILE}


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize(
    ("redirection", "status", "more"),
    [
        (">&- 2>&- <&-", 0, ()),
        ("| :", 0, ()),  # nobody reads; the status is that of the reader
        (">/dev/full", 1, ()),
        (">/dev/full 2>/dev/full", 1, ("--json",)),
    ],
)
def test_streams_that_cannot_be_written(
    redirection: str, status: int, more: tuple[str, ...], tmp_path: Path
) -> None:
    """The file that the command writes is there, whatever becomes of its words."""
    found, said = shell(tmp_path, redirection, "new", "mine", *more)
    assert (found, "Traceback" in said) == (status, False), said
    assert (tmp_path / "mine.yaml").stat().st_size > 100
    if redirection == ">/dev/full":
        assert "standard output" in said


def test_names_that_are_no_utf8(tmp_path: Path) -> None:
    place = tmp_path / os.fsdecode(b"d\xff")
    scenario = load_scenario(BUMPER, {"duration": 0.02})
    folders = [write_run(run(scenario), place / os.fsdecode(name)) for name in (b"\xe4", b"\xfe")]
    found = compare(folders)
    assert all(name.isprintable() for name in found.names)
    page = place / os.fsdecode(b"\xe4.html")
    write_comparison(found, page)
    assert "\\udce4" in page.read_text(encoding="utf-8")


def test_a_folder_that_cannot_be_replaced_is_refused_before_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inner = tmp_path / "a" / "b"
    inner.mkdir(parents=True)
    monkeypatch.chdir(inner)
    for path in (Path(), Path("../b"), inner):
        with pytest.raises(InputError, match="working folder"), whole_folder(path):
            pass
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os.path, "ismount", lambda path: Path(path) == inner)
    with pytest.raises(InputError, match="mount point"):
        refuse_foreign(inner)
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="not a folder"):
        refuse_foreign(tmp_path / "file" / "new")
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["a", "b", "file"]


def test_the_longest_name_that_a_disk_takes(tmp_path: Path) -> None:
    path = tmp_path / ("n" * 255)
    for _ in range(2):
        with whole_folder(path) as folder:
            (folder / "summary.json").touch()
    assert os.listdir(tmp_path) == [path.name]


def test_a_working_folder_that_is_gone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    with pytest.raises(InputError, match="has been removed"):
        refuse_foreign(Path("new"))
    refuse_foreign(tmp_path / "new")


def test_a_limit_of_memory_is_named() -> None:
    size = 300_000_000
    done = program(
        *(*CLI, "check", str(BUMPER)),
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (size, size)),
    )
    assert done.returncode == 1
    assert "ulimit -v" in done.stderr
    assert len(done.stderr.splitlines()) == 1
