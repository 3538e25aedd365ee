"""Values that stand for a missing sample (-9999, 1e30, 0 ...) and single readings far from all
others, by the statistics of their own column.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal

import numpy as np
from numpy.typing import NDArray

from hiltestbed.frames import Array

# Steps to both neighbours of a value, in steps of the rows around it: a curve that turns in a dead
# zone of n rows jumps by n/2 of its steps at either end, and no more than AROUND rows are taken for
# missing ones within the range of a column.
FAR = 5.0
AROUND = 5  # rows
# steps in median steps of the column: 10 sigma of white noise, as the median step is 0.95 sigma
ABOVE_NOISE = 10.0
CHANCE = 0.01  # that a reading looks like a mark: by its repetitions and digits
SAMPLED = 500  # values of a column whose digits are counted
# chosen: share of the steps of a column above which a value within its range stands out
STEPPED = 0.995
SPIKE_ROWS = 2  # rows of a spike, at most


@dataclass(frozen=True)
class Outliers:
    """What a column holds of a value that is far from the rest.

    Attributes:
        value: as in the file. rows: ``(rows,)`` bool, where it is.
        code: whether it stands for a missing sample: a reading would be repeated as exactly, or
            have as few digits, with a probability of at most :data:`CHANCE`.
        low, high: range of all other values.
    """

    value: float
    rows: NDArray[np.bool_]
    code: bool
    low: float
    high: float


def outliers(values: Array) -> Iterator[Outliers]:
    """The values in ``(rows,)`` that are isolated: a jump leads to them and a jump leads back, far
    beyond the steps of the rows around them and the noise.

    Within the range of the other values at most :data:`AROUND` successive rows count, since a dead
    zone holds zero for longer. At the ends one jump is enough.
    """
    at = np.flatnonzero(np.isfinite(values))
    x = values[at]
    if not len(x):
        return
    starts = np.flatnonzero(np.r_[True, x[1:] != x[:-1]])
    ends = np.r_[starts[1:], len(x)]
    changes = np.diff(x[starts])  # between stretches of equal values, as a logger may hold
    if not len(changes):
        return
    steps = np.abs(changes)
    jumps = np.minimum(np.r_[np.inf, steps], np.r_[steps, np.inf])
    back = np.r_[True, changes[1:] * changes[:-1] < 0.0, True]
    back &= jumps > np.r_[0.0, np.abs(changes[1:] + changes[:-1]), 0.0]
    found: dict[float, list[tuple[int, int]]] = {}
    for k in np.flatnonzero(back & (jumps > ABOVE_NOISE * np.median(steps))):
        around = np.r_[steps[max(0, k - 4) : max(0, k - 1)], steps[k + 1 : k + 4]]
        if len(around) and jumps[k] > FAR * np.median(around):
            found.setdefault(float(x[starts[k]]), []).append((int(starts[k]), int(ends[k])))
    count = sum(map(len, found.values()))
    for value, runs in found.items():
        yield from _judged(value, runs, count, values, at)


def _judged(
    value: float, runs: list[tuple[int, int]], count: int, values: Array, at: NDArray[np.intp]
) -> Iterator[Outliers]:
    """What is said of one of ``count`` isolated stretches, if anything."""
    x = values[at]
    rest = x[x != value]
    low, high = float(rest.min()), float(rest.max())
    away = max(low - value, value - high)
    if away <= 0.0:  # within the range of the others
        # jumps as large are part of a column that a converter or a controller moves in steps
        usual = float(np.quantile(np.abs(np.diff(rest)), STEPPED)) if len(rest) > 1 else 0.0
        runs = [(a, b) for a, b in runs if b - a <= AROUND and _least_jump(x, a, b) > usual]
    elif len(rest) < 0.5 * len(x):
        return
    if not runs:
        return
    lengths = [end - start for start, end in runs]
    code = _chance(value, lengths, count, rest) <= CHANCE
    if not code and not (max(lengths) <= SPIKE_ROWS and away > high - low):
        return
    rows = values == value if away > 0.0 else np.zeros(len(values), dtype=bool)
    for start, end in runs:
        rows[at[start:end]] = True
    yield Outliers(value, rows, code, low, high)


def _least_jump(x: Array, start: int, end: int) -> float:
    """The smaller of the jumps to and from rows ``start`` to ``end``; at the ends there is one."""
    jumps = [abs(x[k] - x[k - 1]) for k in (start, end) if 0 < k < len(x)]
    return float(min(jumps, default=math.inf))


def _chance(value: float, lengths: list[int], count: int, rest: Array) -> float:
    """Probability that some of ``count`` isolated readings agree in ``value`` in as many stretches,
    repeat it from row to row for their ``lengths``, and have as few digits, in a column that is
    otherwise ``rest``.
    """
    many = len(lengths)
    agree = math.comb(count, many) * float(len(np.unique(rest))) ** (1 - many)
    held = float(np.mean(rest[1:] == rest[:-1])) ** (sum(lengths) - many) if len(rest) > 1 else 1.0
    zeros = _shorter(value, rest[:: max(1, len(rest) // SAMPLED)])
    return agree * held * 10.0**-zeros


def _shorter(value: float, rest: Array) -> float:
    """By how many digits a value is shorter than the ``rest`` is written: decimal places if most
    have as many, as of a fixed format, otherwise significant digits.
    """
    places, digits = _written(rest)
    own_places, own_digits = _written(np.array([value]))
    low, high = np.quantile(places, (0.25, 0.75))
    if high - low < 1.0:
        return max(0.0, float(np.median(places) - own_places[0]))
    return max(0.0, float(np.median(digits) - own_digits[0]))


def _written(values: Array) -> tuple[Array, Array]:
    """Decimal places and significant digits of each value, of single precision if it is."""
    with np.errstate(over="ignore"):
        single = values.astype(np.float32)
    texts = [repr(float(v)) if float(f) != float(v) else str(f)
             for v, f in zip(values, single, strict=True)]  # fmt: skip
    parts = [Decimal(text).normalize().as_tuple() for text in texts]
    places = [max(0, -p.exponent) if isinstance(p.exponent, int) else 0 for p in parts]
    digits = [len(p.digits) if any(p.digits) else 0 for p in parts]
    return np.array(places, dtype=np.float64), np.array(digits, dtype=np.float64)


def declared(values: Array, missing: tuple[float, ...]) -> NDArray[np.bool_]:
    """``(rows,)``: where a column has one of the values that stand for a missing sample; equal as
    single-precision numbers, in which a file may hold what a user writes in decimal.
    """
    with np.errstate(over="ignore"):
        single = values.astype(np.float32)
        marks = np.array(missing, dtype=np.float32)
    return np.isin(single, marks[np.isfinite(marks)]) | np.isin(values, missing)
