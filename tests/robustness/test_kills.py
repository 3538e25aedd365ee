"""Commands that are killed or interrupted: every folder complete or absent, and the same command
then gives the result of one left alone.

A killed command ends without warning (SIGKILL, to its own process alone). An interrupted one
receives SIGINT twice, as from Ctrl-C in a terminal: with all processes of its group.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import pytest

from hiltestbed.config.gallery import shipped
from tests.measured import bounce
from tests.slow import SLOW

pytestmark = SLOW
PATIENCE = 900.0  # [s] after which a command counts as hanging; time for compilation included
ENDS = 120.0  # [s] within which an interrupted command must end
PART = 0.5  # of its duration, at which a command is ended
CAMPAIGN = """scenario: {base}
set: {{duration: 0.2}}
vary: {{sensor.delay: {{values: [0.001, 0.002, 0.003, 0.004]}}}}
design: {{kind: grid}}
"""


class Command(NamedTuple):
    """A command of the command line: its arguments, the contents of a complete folder, the result
    file that has the same bytes in every run (empty if there is none), and its exit codes.
    """

    line: str
    files: frozenset[str] = frozenset()
    same: str = ""
    statuses: tuple[int, ...] = (0,)


REPORT = frozenset({"bench.json", "report.html"})
COMMANDS = {
    "run": Command(
        "run 02-bumper --set duration=0.5 --no-rerun --out {out}",
        frozenset({"scenario.yaml", "summary.json", "trace.parquet", "report.html"}),
        "trace.parquet",
    ),
    "sweep": Command(
        "sweep {inputs}/campaign.yaml --workers 1 --chunk 1 --out {out}", same="cases.parquet"
    ),
    "diagnose": Command(
        "diagnose {inputs}/dataset.yaml --out {out}", frozenset({"diagnosis.json", "report.html"})
    ),
    "bench": Command("bench diagnosis --for 0.05 --workers 1 --out {out}", REPORT),
    "live": Command(
        "live 02-bumper --set rate=250 --set devices.communication.misses_in_window=1000 --for 1 "
        "--arm --no-rerun --sensor udp://127.0.0.1:{sensor} --platform udp://127.0.0.1:{platform} "
        "--out {out}",
        frozenset({"scenario.yaml", "summary.json"}),
        statuses=(0, 3),
    ),
}


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign and a dataset."""
    folder = tmp_path_factory.mktemp("inputs")
    base = shipped("scenarios") / "02-bumper.yaml"
    (folder / "campaign.yaml").write_text(CAMPAIGN.format(base=base), encoding="utf-8")
    bounce.write_dataset(folder, bounce.columns())
    return folder


def started(arguments: list[str]) -> subprocess.Popen[bytes]:
    """A command in a process group of its own."""
    order = [sys.executable, "-m", "hiltestbed.cli", *arguments]
    none, pipe = subprocess.DEVNULL, subprocess.PIPE
    return subprocess.Popen(order, stdin=none, stdout=none, stderr=pipe, start_new_session=True)


@contextmanager
def running(name: str, inputs: Path, out: Path) -> Iterator[subprocess.Popen[bytes]]:
    """The command, and beside `live` the devices of the same scenario on free ports."""
    words = COMMANDS[name].line.split()
    if name != "live":
        yield started([word.format(inputs=inputs, out=out) for word in words])
        return
    held = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(4)]
    for one in held:
        one.bind(("127.0.0.1", 0))
    sensor, platform, listen, heard = (one.getsockname()[1] for one in held)
    for one in held:
        one.close()
    devices = started(
        f"emulate 02-bumper --set rate=250 --for {PATIENCE:g} "
        f"--sensor udp://127.0.0.1:{sensor}?peer={listen} "
        f"--platform udp://127.0.0.1:{platform}?peer={heard}".split()
    )
    try:
        assert devices.stderr.readline()
        ports = {"sensor": f"{sensor}?listen={listen}", "platform": f"{platform}?listen={heard}"}
        yield started([word.format(out=out, **ports) for word in words])
    finally:
        gone(devices)


def gone(process: subprocess.Popen[bytes]) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


def whole(name: str, inputs: Path, out: Path) -> tuple[float, bytes]:
    """Duration [s] and result of the command left alone."""
    command, begin = COMMANDS[name], time.monotonic()
    with running(name, inputs, out) as process:
        try:
            err = process.communicate(timeout=PATIENCE)[1].decode(errors="replace")
        finally:
            gone(process)
    assert process.returncode in command.statuses, err[-300:]
    assert complete_or_absent(name, out)
    return time.monotonic() - begin, (out / command.same).read_bytes() if command.same else b""


def complete_or_absent(name: str, out: Path) -> bool:
    """Whether the folder is there; fails where it is not whole."""
    if out.exists():
        assert {f.name for f in out.iterdir()} >= COMMANDS[name].files
    for file in out.glob("*.json"):
        json.loads(file.read_text(encoding="utf-8"))
    return out.exists()


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_that_is_ended_leaves_a_whole_folder_or_none(
    name: str, inputs: Path, tmp_path: Path, subtests: pytest.Subtests
) -> None:
    whole(name, inputs, tmp_path / "cold")
    lasts, result = whole(name, inputs, tmp_path / "warm")
    for hard in (True, False):
        with subtests.test("killed" if hard else "interrupted"):
            out = tmp_path / f"{hard}"
            with running(name, inputs, out) as process:
                time.sleep(PART * lasts)
                if hard:
                    process.kill()
                for _ in range(0 if hard else 2):
                    with contextlib.suppress(ProcessLookupError):
                        os.killpg(process.pid, signal.SIGINT)
                    time.sleep(0.1)
                try:
                    err = process.communicate(timeout=ENDS)[1].decode(errors="replace")
                finally:
                    gone(process)
            assert "Traceback" not in err
            complete_or_absent(name, out)
            assert whole(name, inputs, out)[1] == result
