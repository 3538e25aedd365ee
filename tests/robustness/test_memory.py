"""A process that goes on and on needs no more memory than at first: what a run, its folder or a
diagnosis took is given back.
"""

from __future__ import annotations

import ctypes
import gc
import itertools
import platform
from collections.abc import Callable
from pathlib import Path

import pytest

from hiltestbed import diagnose, load_scenario, run, run_batch, write_run
from hiltestbed.run_folder.result import Run
from tests.diagnosis.recorded import recorded
from tests.slow import SLOW

STATUS = Path("/proc/self/status")
LINUX = pytest.mark.skipif(
    platform.libc_ver()[0] != "glibc",
    reason="needs the resident size that Linux tells, and the C library of GNU",
)
BLOCKS = 3
# times, after which modules, kernels and models that are kept once a process are there
AT_FIRST = 3


def resident() -> float:
    """[byte] of the memory that this process holds, without what is free and not given back yet."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    return next(
        1024.0 * int(line.split()[1])
        for line in STATUS.read_text().splitlines()
        if line.startswith("VmRSS")
    )


def grown(once: Callable[[int], object], times: int) -> float:
    """[byte] by which the process grows in so many ``times`` more, from the block of them in which
    it grew least.

    What leaks grows in every block; what is loaded, or lies between other allocations, in one of
    them.
    """
    for i in range(AT_FIRST):
        once(i)
    sizes = [resident()]
    for block in range(BLOCKS):
        for i in range(times // BLOCKS):
            once(AT_FIRST + block * (times // BLOCKS) + i)
        sizes.append(resident())
    return BLOCKS * min(after - before for before, after in itertools.pairwise(sizes))


def size_of(done: Run) -> int:
    """[byte] of the trace of a run."""
    return sum(column.nbytes for column in done.trace.columns().values())


def short(seed: int, name: str = "04-bumper-delay-compensated"):
    return load_scenario(name, {"duration": 0.25, "seed": seed})


@LINUX
def test_runs_leave_nothing_behind() -> None:
    """Half of what twenty-one runs would grow by if each kept its trace: physics, loop and buffers are
    larger.
    """
    most = 0.5 * 21 * size_of(run_batch([short(0)], trace=True)[0])
    assert grown(lambda i: run_batch([short(i)], trace=True), 21) < most


@LINUX
@SLOW
def test_folders_leave_nothing_behind(tmp_path: Path) -> None:
    """Nor the stability that a run is told, or its report with two pictures of some 800 x 400
    points of 4 byte.

    Without the recording, of each of which the rerun library itself keeps some 5 MB for as long as
    the process lives.
    """
    kept = 2 * 800 * 400 * 4 + size_of(run(short(0)))
    more = grown(lambda i: write_run(run(short(i)), tmp_path / "run", rerun=False), 21)
    assert more < 0.5 * 21 * kept


@LINUX
@SLOW
def test_diagnoses_leave_nothing_behind(tmp_path: Path) -> None:
    """Each holds some hundred replays of two records of 800 rows, six columns of 8 byte and more: 8
    MB. A tenth a diagnosis would show.
    """
    file = recorded(tmp_path, [{"kind": "sensor.delay", "delay": 0.002}])
    assert grown(lambda i: diagnose(file), 9) < 0.1 * 9 * 100 * 2 * 800 * 6 * 8
