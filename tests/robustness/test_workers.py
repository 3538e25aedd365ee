"""When a worker of the random trials hangs."""

from __future__ import annotations

import math
import subprocess
import sys
from itertools import pairwise

import pytest

from tests.equipment.robustness.run import hangs, worked

WORK = """
import time
while True:
    print(time.process_time(), flush=True)
    end = time.process_time() + float(input())
    while time.process_time() < end: pass
"""
TICK = 0.01  # [s] in which Linux counts


@pytest.mark.parametrize(
    ("wall", "busy", "expected"),
    [
        (9.0, 0.0, False),  # asleep, and not for long enough
        (10.0, 0.0, True),  # asleep
        (10.0, 0.2, False),  # at work, or waiting for a core
        (500.0, 9.9, False),  # waiting for a core, for long
        (500.0, 10.1, True),  # at work for too long
        (500.0, 4.9, True),  # asleep nearly all the time
        (9.0, math.nan, False),
        (10.0, math.nan, True),
    ],
)
def test_who_sleeps_or_works_too_long_hangs_and_who_waits_for_a_core_does_not(
    wall: float, busy: float, expected: bool
) -> None:
    assert hangs(wall, busy, 10.0) is expected


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the wall clock alone tells")
def test_the_time_that_a_process_worked_is_what_it_counts_itself() -> None:
    with subprocess.Popen([sys.executable, "-c", WORK], stdin=-1, stdout=-1, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        told = []
        for _ in range(3):
            own = float(process.stdout.readline())
            told.append((own, worked(process.pid)))
            process.stdin.write("0.1\n")
            process.stdin.flush()
        for (own, seen), (own_next, seen_next) in pairwise(told):
            assert seen_next - seen == pytest.approx(own_next - own, abs=3 * TICK)
        process.kill()
