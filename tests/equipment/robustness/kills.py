"""Commands killed, or interrupted twice, at a random moment: every folder must be complete or
absent, and a repeated command must work.

A killed command ends without warning (SIGKILL, to its own process alone). An interrupted one
receives SIGINT twice, as from Ctrl-C in a
terminal: with all processes of its group.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from numpy.random import Generator

import hiltestbed

PATIENCE = 900.0  # [s] after which a command counts as hanging; time for compilation included
ENDS = 120.0  # [s] within which an interrupted command must end
TWICE = 0.3  # [s] between two interruptions, at most
AGAIN = 0.5  # fraction of the trials after which the same command is repeated
FRAME = re.compile(r'File "([^"]+)", line')
PACKAGE = Path(hiltestbed.__file__).parent
# files of the package that are imported before the program can handle Ctrl-C
BEFORE = {"__init__.py", "kernel_cache.py"}
RUN = {"scenario.yaml", "summary.json", "trace.parquet", "report.html"}
CAMPAIGN = """scenario: {base}
set: {{duration: 0.2}}
vary: {{sensor.delay: {{values: [0.001, 0.002, 0.003, 0.004]}}}}
design: {{kind: grid}}
"""


class KillError(AssertionError):
    """A command that was killed has left an invalid result, failed, or hangs."""


@contextmanager
def _nothing() -> Iterator[dict[str, object]]:
    yield {}


@dataclass(frozen=True)
class Command:
    """A command of the command line.

    Attributes:
        line: its arguments, with {inputs} and {out} for the folders. files: contents of a complete
            folder. same: result file that has the same bytes in every run, empty if there is none.
        beside: context that must be active while it runs; gives further words of the line.
            statuses: allowed exit codes without interruption.
    """

    line: str
    files: frozenset[str]
    same: str = ""
    beside: Callable[[], contextlib.AbstractContextManager[dict[str, object]]] = _nothing
    statuses: frozenset[int] = frozenset({0})

    @contextmanager
    def started(self, inputs: Path, out: Path) -> Iterator[subprocess.Popen[bytes]]:
        """Start the command in a process group of its own."""
        with self.beside() as more:
            given = {"inputs": inputs, "out": out, **more}
            yield started([word.format(**given) for word in self.line.split()])


def kill(rng: Generator, folder: Path, only: str | None = None) -> str:
    """Start a command, end it at a random moment, check what it left, and sometimes repeat it.
    Raises KillError.
    """
    name = only or str(rng.choice(list(COMMANDS)))
    command = COMMANDS[name]
    inputs = prepared(folder)
    lasts, whole = _whole(name, inputs)
    with tempfile.TemporaryDirectory(prefix="killed-", dir=folder) as place:
        out = Path(place) / "out"
        with command.started(inputs, out) as process:
            hard, part = bool(rng.random() < 0.5), float(rng.uniform(0.02, 1.0))
            err = _ended_early(process, part * lasts, hard, float(rng.uniform(0.0, TWICE)))
        how = f"{name}, {'killed' if hard else 'interrupted'} after {part:.2f} of {lasts:.1f} s"
        if "Traceback" in err and not in_pythons_own_start(err):
            raise KillError(f"{how}: {err[-300:]}")
        _complete_or_absent(out, command, how)
        if rng.random() < AGAIN:
            status, err = run_whole(command, inputs, out)
            if status not in command.statuses:
                raise KillError(f"{how}, given again: status {status}: {err[-300:]}")
            _complete_or_absent(out, command, how)
            if not out.exists() or (command.same and digest(out / command.same) != whole):
                raise KillError(
                    f"{how}, given again: the result is not that of a command left alone"
                )
    return "survived"


def in_pythons_own_start(err: str) -> bool:
    """Whether Ctrl-C came before the program's first line, while Python itself was starting: no
    program can catch that.

    The traceback then contains only files that are imported with the package, and none of the
    processes that it starts.
    """
    files = [Path(file) for file in FRAME.findall(err)]
    own = [file.relative_to(PACKAGE) for file in files if file.is_relative_to(PACKAGE)]
    return all(str(file) in BEFORE for file in own) and not any(
        {"multiprocessing", "concurrent"} & set(file.parts) for file in files
    )


def started(arguments: list[str]) -> subprocess.Popen[bytes]:
    """Start a command in a process group of its own."""
    order = [sys.executable, "-m", "hiltestbed.cli", *arguments]
    none, pipe = subprocess.DEVNULL, subprocess.PIPE
    return subprocess.Popen(order, stdin=none, stdout=none, stderr=pipe, start_new_session=True)


def _ended_early(process: subprocess.Popen[bytes], after: float, hard: bool, twice: float) -> str:
    """End the process after ``after`` seconds; returns its messages."""
    time.sleep(after)
    if hard:
        process.kill()
    else:
        for pause in (twice, 0.0):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGINT)
            time.sleep(pause)
    try:
        return process.communicate(timeout=ENDS)[1].decode(errors="replace")
    except subprocess.TimeoutExpired:
        raise KillError(f"does not end within {ENDS:g} s") from None
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def run_whole(command: Command, inputs: Path, out: Path) -> tuple[int, str]:
    """Exit code and messages of the command without interruption. Raises KillError if it hangs."""
    with command.started(inputs, out) as process:
        try:
            err = process.communicate(timeout=PATIENCE)[1].decode(errors="replace")
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            raise KillError(f"does not end within {PATIENCE:g} s") from None
    return process.returncode, err


def _complete_or_absent(out: Path, command: Command, how: str) -> None:
    if out.exists() and not command.files <= {f.name for f in out.iterdir()}:
        raise KillError(f"{how}: {out.name} holds {sorted(f.name for f in out.iterdir())}")
    for file in out.glob("*.json"):
        json.loads(file.read_text(encoding="utf-8"))


def digest(file: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _whole(name: str, inputs: Path) -> tuple[float, str]:
    """Duration of the command without interruption [s], and the digest of its result; measured
    once, with compiled kernels.
    """
    known = inputs / f"{name}.json"
    if not known.exists():
        command = COMMANDS[name]
        with tempfile.TemporaryDirectory(prefix="whole-", dir=inputs) as place:
            for out in (Path(place) / "cold", Path(place) / "out"):
                begin = time.monotonic()
                status, err = run_whole(command, inputs, out)
                if status not in command.statuses:
                    raise KillError(f"{name}, left alone: status {status}: {err[-300:]}")
            lasts = time.monotonic() - begin
            made = digest(Path(place) / "out" / command.same) if command.same else ""
            known.write_text(json.dumps([lasts, made]))
    lasts, made = json.loads(known.read_text())
    return lasts, made


def prepared(folder: Path) -> Path:
    """The folder of inputs beside ``folder``: a campaign and a short dataset."""
    inputs = folder.parent / "kill"
    if not inputs.exists():
        from hiltestbed.config.gallery import shipped
        from hiltestbed.config.yaml_source import dump_yaml, read_source

        made = Path(tempfile.mkdtemp(dir=folder))
        (made / "campaign.yaml").write_text(
            CAMPAIGN.format(base=shipped("scenarios") / "02-bumper.yaml"), encoding="utf-8"
        )
        shutil.copytree(good_set(folder.parent), made / "set")
        whole = read_source(made / "set" / "dataset.yaml").data
        (made / "set" / "dataset.yaml").write_text(
            dump_yaml(whole | {"runs": whole["runs"][:1]}), encoding="utf-8"
        )
        _in_place(made, inputs)
    return inputs


def good_set(shared: Path) -> Path:
    """A healthy data set in ``shared``, made by the first worker that needs it."""
    place = shared / "good"
    if not place.exists():
        import numpy as np

        from tests.equipment.independent_rig.log import write_set
        from tests.equipment.independent_rig.sets import draw_set

        made = Path(tempfile.mkdtemp(dir=shared)) / "set"
        _in_place(write_set(made, draw_set(np.random.default_rng(3), "healthy")), place)
    return place


def _in_place(made: Path, place: Path) -> None:
    with contextlib.suppress(OSError):  # another worker was first
        made.rename(place)


@contextmanager
def _devices() -> Iterator[dict[str, object]]:
    """The devices of the same scenario on free ports, started before the loop."""
    held = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(4)]
    for one in held:
        one.bind(("127.0.0.1", 0))
    sensor, platform, listen, heard = (one.getsockname()[1] for one in held)
    for one in held:
        one.close()
    words = (
        f"emulate 02-bumper --set rate=250 --for {PATIENCE:g} "
        f"--sensor udp://127.0.0.1:{sensor}?peer={listen} "
        f"--platform udp://127.0.0.1:{platform}?peer={heard}"
    )
    process = started(words.split())
    try:
        if process.stderr is None or not process.stderr.readline():
            raise KillError("the emulated devices did not start")
        yield {"sensor": f"{sensor}?listen={listen}", "platform": f"{platform}?listen={heard}"}
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


COMMANDS: dict[str, Command] = {
    "run": Command(
        "run 02-bumper --set duration=0.5 --no-rerun --out {out}", frozenset(RUN), "trace.parquet"
    ),
    "sweep": Command(
        "sweep {inputs}/campaign.yaml --workers 1 --chunk 1 --out {out}",
        frozenset(),
        "cases.parquet",
    ),
    "diagnose": Command(
        "diagnose {inputs}/set/dataset.yaml --out {out}",
        frozenset({"diagnosis.json", "report.html"}),
    ),
    "bench": Command(
        "bench robustness --for 0.05 --workers 1 --out {out}",
        frozenset({"bench.json", "report.html"}),
    ),
    "live": Command(
        "live 02-bumper --set rate=250 --set devices.communication.misses_in_window=1000 --for 1 "
        "--arm --no-rerun --sensor udp://127.0.0.1:{sensor} --platform udp://127.0.0.1:{platform} "
        "--out {out}",
        frozenset({"scenario.yaml", "summary.json"}),
        beside=_devices,
        statuses=frozenset({0, 3}),
    ),
}
