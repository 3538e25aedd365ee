"""Stage "layout": quantisation errors that are alike in many rows: where nothing dithers a
converter, they are no independent samples.
"""

from __future__ import annotations

import math

import numpy as np

from hiltestbed.diagnosis.noise import undithered
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredRun
from hiltestbed.signals import GROUPS

# derived: [rows] of repeating quantisation errors; longer ones average out to less than an eighth
# of a step
LONGEST_PERIOD = 4
# chosen: equal changes in a row; errors that repeat less often pass through a whole step within a
# contact
MIN_REPETITIONS = 32


def repetition_factor(run: MeasuredRun, group: str, rows: int) -> Array:
    """(rows, parts) root of the number of successive rows with like quantisation errors, in a
    channel without dither; they count as one.

    They are alike while a reading stays the same, and while it grows by equal amounts, such as
    three steps a row, or five in two rows.
    """
    out = np.ones((rows, len(GROUPS[group].columns)))
    rounding = run.record.rounding(group)
    for j, name in enumerate(GROUPS[group].columns):
        if run.record.has(name) and (undithered(run, name) or name in run.record.digits):
            step = np.maximum(run.record.steps.get(name, 0.0), math.sqrt(12.0) * rounding[:rows, j])
            out[:, j] = np.sqrt(alike_rows(run.record.column(name)[:rows], step))
    return out


def alike_rows(values: Array, step: Array) -> Array:
    """(N,) number of rows around each of values (N,) whose quantisation errors, in a converter of
    ``step`` (N,), count as one error.

    Errors that repeat after n rows average out to 1/n of a single error: L rows of them have the
    mean of L/n^2 rows with equal errors.
    """
    out = np.ones(len(values))
    for period in range(1, min(LONGEST_PERIOD, len(values) - 1) + 1):
        changes = values[period:] - values[:-period]
        starts = np.flatnonzero(np.r_[True, ~(np.abs(np.diff(changes)) < 0.5 * step[period:-1])])
        lengths = np.diff(np.r_[starts, len(changes)])
        alike = np.where(lengths >= MIN_REPETITIONS, lengths / period**2, 1.0)
        if period == 1:
            # two equal values have one change
            alike = np.where(np.abs(changes[starts]) < 0.5 * step[starts + 1], lengths + 1.0, alike)
        alike = np.repeat(alike, lengths)
        for first in range(period + 1):  # each change bears on all rows that it spans
            rows = slice(first, first + len(changes))
            out[rows] = np.maximum(out[rows], alike)
    return out
