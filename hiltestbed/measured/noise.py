"""Noise floor of a measured column: what is left when the motion is taken out."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hiltestbed.frames import Array

FREE_MINIMUM = 20  # samples before the first touch from which a noise floor is read
THIRD_DIFFERENCE = math.sqrt(20.0)  # of white noise: 1 + 9 + 9 + 1 times its variance
MAD_TO_SIGMA = 1.4826
UNIFORM = 2.0  # rms over white, above which a pose does not move uniformly and a straight line says nothing of its noise
ROUND_OFF = 1e-12  # of the largest value: such steps are those of the number format
SPARSE = 0.7  # part of the ticks that hold a sample, below which they are the samples of a slower log
FEW_DIGITS = 6  # of a text file, up to which its rounding may show
SMALLEST = 1e-290  # below which a last digit is none of the number format's
SAME = 1e-9  # of the range: values this close are one value


@dataclass(frozen=True)
class Noise:
    """Noise of one column.

    Attributes:
        rms: 1 sigma about a straight line in the free segment; hum and drift of a force count. For a pose that does not move
            uniformly there, the same as ``white``.
        white: 1 sigma of the part that differs from sample to sample (third differences): hum and motion do not count.
        samples: it was read from; 0 when the free segment is too short and the whole record was taken, with ``rms`` = ``white``.

    Neither is less than step/sqrt(12) of a channel that comes in steps.
    """

    rms: float
    white: float
    samples: int


def noise_of(values: Array, free: int, step: float, pose: bool) -> Noise:
    """Noise of ``values`` ``(ticks,)`` whose first ``free`` samples lie before the first touch and which come in ``step`` (0: none)."""
    segment, least = values[:free], step / math.sqrt(12.0)
    known = np.flatnonzero(np.isfinite(segment))
    if len(known) < FREE_MINIMUM:
        white = max(white_noise(values), least)
        return Noise(white, white, 0)
    line = np.polynomial.Polynomial.fit(known, segment[known], 1)
    residual = segment[known] - line(known)
    rms, white = float(np.sqrt(np.sum(residual**2) / (len(known) - 2))), max(white_noise(segment), least)
    return Noise(white if pose and rms > UNIFORM * white else max(rms, least), white, len(known))


def white_noise(values: Array) -> float:
    """1 sigma of the part of ``values`` that differs from sample to sample; 0 when there are too few."""
    third = np.diff(_samples(values), 3)
    third = third[np.isfinite(third)]
    if len(third) < 8:
        return 0.0
    sigma = MAD_TO_SIGMA * float(np.median(np.abs(third))) / THIRD_DIFFERENCE
    return sigma if sigma > 0 else float(np.std(third)) / THIRD_DIFFERENCE


def _samples(values: Array) -> Array:
    """``values``; those that are there alone where most are not, as on the ticks of a loop that is faster than its log."""
    known = np.isfinite(values)
    return values[known] if len(values) and known.mean() < SPARSE else values


def finest_noise(values: Array) -> float:
    """1 sigma of white noise in a column that moves: the least of differences of orders 3, 5 and 7, in which motion counts ever less."""
    found = [white_noise(values)]
    for order in (5, 7):
        differences = np.diff(_samples(values), order)
        differences = differences[np.isfinite(differences)]
        if len(differences) >= 8:
            found.append(MAD_TO_SIGMA * float(np.median(np.abs(differences))) / math.sqrt(math.comb(2 * order, order)))
    return min(found)


def step_of(values: Array) -> float | None:
    """The step that all of ``values`` are multiples of, or None when they come in no steps; a uniform motion makes one a sample."""
    distinct = np.unique(values)
    if len(distinct) < 3:
        return None
    gaps = np.diff(distinct)
    gaps = gaps[gaps > SAME * (distinct[-1] - distinct[0])]
    step = float(gaps.min())
    if step < ROUND_OFF * np.abs(distinct[[0, -1]]).max():
        return None
    multiples = gaps / step
    if len(distinct) == len(values) and multiples.max() < 1.5:
        return None
    return step if np.abs(multiples - np.round(multiples)).max() < 0.05 else None


def last_digit(size: Array, count: int) -> Array:
    """What the last of ``count`` significant digits is worth in numbers of a ``size`` above 0."""
    return 10.0 ** (np.floor(np.log10(size)) - count + 1)


def digits_of(values: Array) -> int | None:
    """How many significant digits ``values`` have where they are few, :data:`FEW_DIGITS` at most; None where they have more."""
    size = np.abs(values[np.isfinite(values)])
    size = size[size > SMALLEST]
    if len(np.unique(size)) < 10:
        return None
    for count in range(2, FEW_DIGITS + 1):
        places = size / last_digit(size, count)
        if np.abs(places - np.round(places)).max() < 1e-6:
            return count
    return None
