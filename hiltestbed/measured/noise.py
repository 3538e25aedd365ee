"""Noise floor of a measured column: what remains once the motion is removed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hiltestbed.frames import Array

FREE_MINIMUM = 20  # samples before the first touch, at least, to estimate a noise floor
# its sigma for white noise of unit sigma: the variance is 1 + 9 + 9 + 1
THIRD_DIFFERENCE = math.sqrt(20.0)
MAD_TO_SIGMA = 1.4826
OUTLIER_SIGMA = 4.0  # derived: standard deviations, beyond which 6e-5 of normal samples lie
# Derived: level in steps with a noise of 0.2 steps. An eighth of the variance of rounding is then
# alike from row to row: the first harmonic of its sawtooth, 12/(2 pi^2) of that variance, times
# exp(-(2 pi 0.2)^2).
DITHERED = math.hypot(0.2, 1.0 / math.sqrt(12.0))
MOVED = 10.0  # sigma of its noise by which what changes more was moved
# ratio of rms to white; above it a pose does not move uniformly, and a straight line does not give
# its noise
UNIFORM = 2.0
ROUND_OFF = 1e-12  # of the largest value: smaller steps are those of the number format
SPARSE = 0.7  # part of the ticks with a sample; below it the log is slower than the loop
FEW_DIGITS = 6  # significant digits of a text file, up to which its rounding may matter
SAME = 1e-9  # of the range: values this close count as equal


@dataclass(frozen=True)
class Noise:
    """Noise of one column.

    Attributes:
        rms: 1 sigma about a straight line in the free segment; includes hum and drift of a force.
            For a pose that does not move uniformly there, the same as ``white``.
        white: 1 sigma of the part that differs from sample to sample (third differences), without
            hum and motion.
        samples: used for the estimate; 0 if the free segment is too short and the whole record was
            used, with ``rms`` = ``white``.

    For a quantised channel neither is less than step/sqrt(12).
    """

    rms: float
    white: float
    samples: int


def noise_of(values: Array, free: int, step: float, pose: bool) -> Noise:
    """Noise of ``values`` ``(ticks,)`` with ``free`` samples before the first touch and the
    quantisation step ``step`` (0: none).
    """
    segment, least = values[:free], step / math.sqrt(12.0)
    known = np.flatnonzero(np.isfinite(segment))
    if len(known) < FREE_MINIMUM:
        white = max(white_noise(values, step), least)
        return Noise(white, white, 0)
    residual = segment[known] - np.polynomial.Polynomial.fit(known, segment[known], 1)(known)
    rms = float(np.sqrt(np.sum(residual**2) / (len(known) - 2)))
    white = max(white_noise(segment, step), least)
    return Noise(white if pose and rms > UNIFORM * white else max(rms, least), white, len(known))


def white_noise(values: Array, step: float = 0.0) -> float:
    """1 sigma of the part of ``values`` that differs from sample to sample; 0 if there are too few
    samples.

    ``step``: their quantisation, 0: none. Differences of quantised values are multiples of it, and
    so is their median, which then tells no level: their mean square does, of those that are not far
    out. Where noise does not dither the steps, rounding errors are alike from row to row, which
    differences show in part: the larger of the two counts.
    """
    third = _differences(values, 3)
    if len(third) < 8:
        return 0.0
    usual = MAD_TO_SIGMA * float(np.median(third))
    if step > 0.0 or usual == 0.0:
        far = OUTLIER_SIGMA * max(usual, step) if step > 0.0 else math.inf
        rms = float(np.sqrt(np.mean(np.minimum(third, far) ** 2)))
        usual = rms if rms > THIRD_DIFFERENCE * DITHERED * step else max(rms, usual)
    return usual / THIRD_DIFFERENCE


def _differences(values: Array, order: int) -> Array:
    """Sizes of the known differences; where many samples are missing, of those that are there."""
    known = np.isfinite(values)
    samples = values[known] if len(values) and known.mean() < SPARSE else values
    found = np.abs(np.diff(samples, order))
    return found[np.isfinite(found)]


def finest_noise(values: Array) -> float:
    """1 sigma of white noise in a moving column: least from differences of orders 3, 5, 7."""
    found = [white_noise(values)]
    for order in (5, 7):
        differences = _differences(values, order)
        if len(differences) >= 8:
            usual = MAD_TO_SIGMA * float(np.median(differences))
            found.append(usual / math.sqrt(math.comb(2 * order, order)))
    return min(found)


def step_of(values: Array) -> float | None:
    """The step of which all ``values`` are multiples; None if not quantised, or just uniform."""
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
    """Value of the last of ``count`` significant digits of numbers as large as ``size`` > 0."""
    return 10.0 ** (np.floor(np.log10(size)) - count + 1)


def digits_of(values: Array) -> int | None:
    """Number of significant digits of ``values`` if at most :data:`FEW_DIGITS`, else None."""
    size = np.abs(values[np.isfinite(values)])
    size = size[size > 10.0**FEW_DIGITS * np.finfo(float).tiny]  # whose last digit is a number
    if len(np.unique(size)) < 10:
        return None
    for count in range(2, FEW_DIGITS + 1):
        places = size / last_digit(size, count)
        if np.abs(places - np.round(places)).max() < 1e-6:
            return count
    return None
