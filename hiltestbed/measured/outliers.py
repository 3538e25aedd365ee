"""Values that stand for a missing sample (-9999, 1e30, 0 ...) and single readings far from all
others, by the statistics of their own column.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal

import numpy as np
from numpy.typing import NDArray

from hiltestbed.frames import Array

# Steps to both neighbours of a value, in steps of the rows around it: a curve that crosses a dead
# zone in n rows jumps by n/2 of its steps at either end, and no more than AROUND rows are taken for
# missing ones within the range of a column.
FAR = 5.0
AROUND = 5  # rows
# steps in median steps of the column: 10 sigma of white noise, as the median step is 0.95 sigma
ABOVE_NOISE = 10.0
# decimal places of a column from which a value with half of them or fewer is no reading: by chance
# in 1 of 100
PLACES = 2
SAMPLED = 500  # values of a column whose decimal places are counted
SPIKE_ROWS = 2  # rows of a spike, at most


@dataclass(frozen=True)
class Outliers:
    """What a column holds of a value that is far from the rest.

    Attributes:
        value: as in the file. rows: ``(rows,)`` bool, where it is.
        code: whether it stands for a missing sample: it is repeated exactly, or has half the
            decimal places of the rest or fewer. Otherwise it may have been measured.
        low, high: range of all other values.
    """

    value: float
    rows: NDArray[np.bool_]
    code: bool
    low: float
    high: float


def outliers(values: Array) -> Iterator[Outliers]:
    """The values in ``(rows,)`` that are isolated: a jump leads to them and a jump back, far beyond
    the steps of the rows around them and the noise.

    Within the range of the other values at most :data:`AROUND` successive rows count, since a dead
    zone holds zero for longer. At the ends one jump is enough.
    """
    at = np.flatnonzero(np.isfinite(values))
    x = values[at]
    if not len(x):
        return
    starts = np.flatnonzero(np.r_[True, x[1:] != x[:-1]])
    ends = np.r_[starts[1:], len(x)]
    steps = np.abs(np.diff(x[starts]))  # between stretches of equal values, as a logger may hold
    if not len(steps):
        return
    noise = ABOVE_NOISE * float(np.median(steps))
    jumps = np.minimum(np.r_[np.inf, steps], np.r_[steps, np.inf])
    found: dict[float, list[tuple[int, int]]] = {}
    for k in np.flatnonzero(jumps > noise):
        around = np.r_[steps[max(0, k - 4) : max(0, k - 1)], steps[k + 1 : k + 4]]
        if len(around) and jumps[k] > FAR * np.median(around):
            found.setdefault(float(x[starts[k]]), []).append((int(starts[k]), int(ends[k])))
    if not found:
        return
    usual = float(np.median(_places(x[:: max(1, len(x) // SAMPLED)])))
    for value, runs in found.items():
        yield from _judged(value, runs, values, at, usual)


def _judged(
    value: float, runs: list[tuple[int, int]], values: Array, at: NDArray[np.intp], usual: float
) -> Iterator[Outliers]:
    x = values[at]
    rest = x[x != value]
    low, high = float(rest.min()), float(rest.max())
    away = max(low - value, value - high)
    if away <= 0.0:  # within the range of the others
        runs = [(s, e) for s, e in runs if e - s <= AROUND]
    elif len(rest) < 0.5 * len(x):
        return
    if not runs:
        return
    repeated = len(runs) > 1 or runs[0][1] - runs[0][0] > 1
    places = float(_places(np.array([value]))[0])
    code = repeated or (usual >= PLACES and 2.0 * places <= usual)
    short = max(e - s for s, e in runs) <= SPIKE_ROWS
    if not code and not (short and away > high - low):
        return
    rows = np.zeros(len(values), dtype=bool)
    if away > 0.0:
        rows = values == value
    for start, end in runs:
        rows[at[start:end]] = True
    yield Outliers(value, rows, code, low, high)


def _places(values: Array) -> Array:
    """Decimal places of each value."""
    exponents = [Decimal(repr(float(v))).normalize().as_tuple().exponent for v in values]
    return np.array([max(0, -e) if isinstance(e, int) else 0 for e in exponents], dtype=np.float64)


def declared(values: Array, missing: tuple[float, ...]) -> NDArray[np.bool_]:
    """``(rows,)``: where a column has one of the values that stand for a missing sample; equal as
    single-precision numbers, in which a file may hold what a user writes in decimal.
    """
    with np.errstate(over="ignore"):
        single = values.astype(np.float32)
        marks = np.array(missing, dtype=np.float32)
    return np.isin(single, marks[np.isfinite(marks)]) | np.isin(values, missing)
