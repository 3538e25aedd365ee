"""The time left is that of the work: neither what came before the first part nor one slow part counts."""

from __future__ import annotations

import pytest

from hiltestbed.progress import Pace


def pace_of(times: list[float], done: list[float]) -> Pace:
    clock = iter(times)
    pace = Pace(lambda: next(clock))
    for units in done:
        pace.update(units)
    return pace


def test_nothing_is_told_before_enough_is_known() -> None:
    assert pace_of([40.0, 40.1], [1, 500]).left(1000) is None


def test_compiling_before_the_first_part_does_not_count() -> None:
    """40 s until the first tick, then 0.1 s for 500 ticks each: 1000 more take 0.2 s."""
    pace = pace_of([40.0, 40.1, 40.2, 40.3, 40.4], [0, 500, 1000, 1500, 2000])
    assert pace.left(1000) == pytest.approx(0.2)


def test_one_slow_part_does_not_set_the_pace() -> None:
    times = [0.0, 0.1, 0.2, 20.2, 20.3, 20.4]  # 20 s at the first touch
    assert pace_of(times, [0, 500, 1000, 1500, 2000, 2500]).left(500) == pytest.approx(0.1)


def test_parts_of_unequal_work_count_by_their_work() -> None:
    """10 units a second throughout, in parts of 1, 10, 40 and 9."""
    assert pace_of([0.0, 0.1, 1.1, 5.1, 6.0], [0, 1, 11, 51, 60]).left(30) == pytest.approx(3.0)
