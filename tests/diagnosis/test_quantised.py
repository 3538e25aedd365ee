"""Quantisation errors of a uniform motion repeat; however they do, they count as no more than one
independent error.
"""

from __future__ import annotations

import numpy as np
import pytest

from hiltestbed.diagnosis.floors import alike_rows
from hiltestbed.frames import Array

ROWS, PHASES = 120, 400


def offset_chi2(slope: float, seed: int) -> Array:
    """(PHASES,) chi-square of the offset that a motion of ``slope`` steps a row shows by its
    quantisation, starting at random phases.
    """
    start = np.random.default_rng(seed).random((PHASES, 1))
    true = start + slope * np.arange(ROWS)
    written = np.rint(true)
    sigma = np.sqrt([alike_rows(row, np.ones(ROWS)) / 12.0 for row in written])
    return np.sum((written - true) / sigma, axis=1) ** 2 / ROWS


@pytest.mark.parametrize(
    "slope", [0.0, 1.0, 3.0, -7.0, 1 / 2, 5 / 2, 1 / 3, 5 / 3, 1 / 4, 13 / 4, 1 / 6, 0.1, 2.03]
)
def test_errors_that_repeat_show_no_offset_beyond_one_error(slope: float) -> None:
    """One error has unit chi-square on average, and 3 at most: half a step over its standard
    deviation.
    """
    chi2 = offset_chi2(slope, 1)
    assert chi2.mean() < 1.25
    assert chi2.max() < 3.5


def test_where_they_are_alike_in_part_of_the_rows_the_rest_counts_little() -> None:
    """From one start in eight the error jumps by a step somewhere in the rows; fewer than 32 to one
    side of it count one by one.
    """
    assert offset_chi2(1.001, 1).mean() < 1.25


def test_errors_of_an_irregular_motion_are_nearly_independent() -> None:
    rng = np.random.default_rng(3)
    alike = alike_rows(np.rint(np.cumsum(rng.normal(0.0, 30.0, 2000))), np.ones(2000))
    assert np.mean(alike) < 1.1


def test_equal_readings_count_as_one_and_a_lost_row_parts_them() -> None:
    values = np.array([4.0, 4.0, 4.0, np.nan, 4.0, 4.0, 9.0])
    assert alike_rows(values, np.ones(7)).tolist() == [3.0, 3.0, 3.0, 1.0, 2.0, 2.0, 1.0]
