"""On a terminal: the time left is that of the work, and a table breaks no word."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from numba.core.event import unregister

from hiltestbed.bench.contacts import BenchContact, bounce, effort
from hiltestbed.compiled import warm as kernels
from hiltestbed.process.progress import UnitTime
from hiltestbed.report.table import print_comparison, print_run

from .slow import SLOW


def pace_of(times: list[float], done: list[float]) -> UnitTime:
    clock = iter(times)
    pace = UnitTime(lambda: next(clock))
    for units in done:
        pace.update(units)
    return pace


PARTS = {
    "too little is known": ([40.0, 40.1], [1, 500], 1000, None),
    # until the first tick
    "compiling": ([40.0, 40.1, 40.2, 40.3, 40.4], [0, 500, 1000, 1500, 2000], 1000, 0.2),
    "one slow part": (
        [0.0, 0.1, 0.2, 20.2, 20.3, 20.4], [0, 500, 1000, 1500, 2000, 2500], 500, 0.1
    ),
    "unequal work": ([0.0, 0.1, 1.1, 5.1, 6.0], [0, 1, 11, 51, 60], 30, 3.0),
}  # fmt: skip


@pytest.mark.parametrize("what", PARTS)
def test_the_time_left_is_that_of_the_parts_at_their_pace(what: str) -> None:
    times, done, more, left = PARTS[what]
    assert pace_of(times, done).left(more) == (left and pytest.approx(left))


def test_a_time_is_not_told_while_parts_differ_too_much() -> None:
    """After parts of 1 and 9 s for the same work three do not tell the mean; after many it is told,
    slow ones counted.
    """
    times = [0.0]
    for i in range(24):
        times.append(times[-1] + (9.0 if i % 2 else 1.0))
    assert pace_of(times[:5], [0, 1, 2, 3, 4]).left(10) is None
    assert pace_of(times, list(range(25))).left(10) == pytest.approx(50.0)


@pytest.mark.parametrize("spread", [0.3, 0.7])
def test_the_first_time_that_is_told_is_right_by_a_factor_of_two(spread) -> None:
    """Sets that two processes work on, of lengths that differ by a factor of exp(spread), after
    half a minute of compiling in each.
    """
    right = 0
    for seed in range(200):
        lengths = 8.0 * np.exp(spread * np.random.default_rng(seed).standard_normal(60))
        free, ends = [30.0, 30.0], []
        for seconds in lengths:
            worker = free.index(min(free))
            free[worker] += seconds
            ends.append(free[worker])
        ends.sort()
        clock = iter(ends)
        pace = UnitTime(lambda clock=clock: next(clock))
        for i, now in enumerate(ends[:-8], 1):
            pace.update(i)
            told = pace.left(len(ends) - i)
            if told is not None:
                right += 0.5 < told / (ends[-1] - now) < 2.0
                break
    assert right >= 0.93 * 200


@SLOW
def test_the_effort_of_a_batch_is_what_it_takes() -> None:
    """Processor time of small and large batches, ideal and servo, within a factor of two of the
    ratio that is assumed.
    """
    cases = [
        [BenchContact(f, 0.005, 0.05, tracking=t)] * n
        for f, t, n in ((2.0, "ideal", 4), (1.0, "ideal", 48), (2.0, "servo", 16))
    ]
    bounce([c.scenario({"kind": "none"}) for c in cases[0]])
    bounce([c.scenario({"kind": "none"}) for c in cases[2][:1]])  # from here on all is loaded
    paces = []
    for contacts in cases:
        start = time.process_time()
        bounce([c.scenario({"kind": "none"}) for c in contacts])
        paces.append((time.process_time() - start) / effort(contacts))
    assert max(paces) < 2.0 * min(paces), paces


def test_compiling_is_told_once_and_only_where_it_takes_long(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # one of its own, whatever commands were called in this process before
    listener = kernels.listen()
    unregister("numba:compile", listener)  # fails where it was not registered
    for patience, told in ((3600.0, 0), (0.0, 1), (0.0, 0)):
        monkeypatch.setattr(kernels, "PATIENCE", patience)
        for step in (listener.on_start, listener.on_start, listener.on_end, listener.on_end):
            step(None)
            time.sleep(0.001)
        assert capsys.readouterr().err.count("compiling") == told


NAMES = ("late", "right", "with-a-long-name-of-a-run")
ROWS = [
    ["mechanism.contact.stiffness", "100000.0", "120000.0", "80000.0"],
    ["stability.net_damping [N s/m, N m s/rad]", "12.34", "-1.2", "3.456"],
    ["approach.velocity", "[0.0, 0.0, 0.03]", "[0.0, 0.0, 0.02]", "[0.001, 0.0, 0.03]"],
    [
        "energy",
        "neutral: within 0.5 % of the approach energy",
        "active: made 3 % of the approach energy",
        "passive",
    ],
]


@pytest.mark.parametrize("width", [40, 60, 80, 100, 140])
def test_a_comparison_breaks_no_word(
    width: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    print_comparison(NAMES, ROWS, None)
    printed = capsys.readouterr().out
    words = printed.split()
    for cell in (*NAMES, *(cell for row in ROWS for cell in row)):
        assert all(word in words or f"{word}:" in words for word in cell.split())


@pytest.mark.parametrize(
    ("ratio", "shown"), [(-1e-6, "+0.0 %"), (0.0, "+0.0 %"), (1e-6, "+0.0 %"), (-0.02, "-2.0 %")]
)
def test_nought_has_no_minus(ratio: float, shown: str, capsys: pytest.CaptureFixture[str]) -> None:
    summary = {
        "name": "run",
        "status": "completed",
        "outcome": "rebound",
        "contacts": 1,
        "captured_at": None,
        "cor": 0.9,
        "cor_reference": 0.9,
        "cor_log_error": ratio,
        "energy_generated": 0.0,
        "peak_force": 1.0,
        "contact_duration": 0.1,
        "delay_ledger": [],
        "identification": {},
        "timing": {"real_time_factor": None, "wall": 1.0, "ticks": 10},
    }
    print_run(summary, Path("runs/run"))
    assert shown in capsys.readouterr().out
