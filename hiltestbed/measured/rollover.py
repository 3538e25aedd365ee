"""Clocks that start again from zero when they are full: a time of day at midnight, a counter of 32
bits.
"""

from __future__ import annotations

import numpy as np

from hiltestbed.frames import Array
from hiltestbed.measured.remark import Remark

# [s] name to where a clock starts again
PERIODS = {
    "a minute": 60.0,
    "an hour": 3600.0,
    "half a day": 43200.0,
    "a day, at midnight": 86400.0,
    "a week, as of GPS": 604800.0,
} | {
    f"a counter of {bits} bits in {unit}": 2.0**bits * size
    for bits in (16, 24, 31, 32)
    for unit, size in (("ns", 1e-9), ("us", 1e-6), ("ms", 1e-3))
}  # fmt: skip
WITHIN = 2.0  # median intervals by which the step across it may differ from one interval


def unrolled(run: int, t: Array) -> tuple[Array, list[Remark]]:
    """The time stamps ``(rows,)`` [s] without the jumps of a clock that starts again, and a remark.

    A jump is one if the stamps before it end at a known period and those after it begin at zero,
    to :data:`WITHIN` intervals, and the record did not itself begin at zero: a second record would.
    """
    rows = np.flatnonzero(np.isfinite(t))
    stamps = t[rows]
    steps = np.diff(stamps)
    back = np.flatnonzero(steps < 0)
    if not len(back) or not (steps > 0).any():
        return t, []
    interval = float(np.median(steps[steps > 0]))
    near = WITHIN * interval
    for name, period in PERIODS.items():
        ends = np.abs(stamps[back] - period) <= near
        begins = np.abs(stamps[back + 1]) <= near
        if ends.all() and begins.all() and stamps[0] > near:
            out = t.copy()
            turns = np.zeros(len(rows))
            turns[back + 1] = 1.0
            out[rows] = stamps + period * np.cumsum(turns)
            text = (
                f"starts again from zero at {period:.9g} s ({name}), first in row "
                f"{rows[back[0] + 1] + 1}: {period:.9g} s added from there"
            )
            return out, [Remark("note", run, "t", text, "", {"period": period})]
    return t, []
