"""The delay between two records of one signal, to a fraction of a sample.

b(t) = g a(t - tau) + o with a gain g and an offset o. The peak of the cross-correlation of the
slopes gives tau to a sample; about it the squares of the residual are minimised, a interpolated by
a cubic spline. Both are smoothed alike first: interpolation averages noise, most of all between two
samples, and would pull tau there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import minimize_scalar
from scipy.signal import correlate

from hiltestbed.frames import Array

SMOOTH = 2.0  # samples, standard deviation: leaves 6 % of the variance of white noise at a sample
FEWEST = 32  # samples in common
ABOUT = 2.0  # samples about the peak of the correlation, within which tau is sought
RECENTRED = 100  # times that the search moves on, at most


@dataclass(frozen=True)
class Shift:
    """How much later b is than a.

    Attributes:
        delay: tau [s]. sd: its standard deviation [s], from the residual and its correlation from
            sample to sample. gain, offset: g and o. explained: share of b's variance that a
            explains; below a half the two are not one signal.
    """

    delay: float
    sd: float
    gain: float
    offset: float
    explained: float


def shift_between(t_a: Array, a: Array, t_b: Array, b: Array) -> Shift | None:
    """The delay of ``b`` (m,) at ``t_b`` (m,) [s] after ``a`` (n,) at ``t_a`` (n,) [s], which may
    have other rates and clocks; None if one does not move, or too little is in common.
    """
    step = float(max(np.median(np.diff(t_a)), np.median(np.diff(t_b))))
    first, second = _even(t_a, a, step), _even(t_b, b, step)
    slopes = [np.diff(part) for part in (first, second)]
    if min(map(len, slopes)) < FEWEST or any(not np.ptp(part) > 0.0 for part in (first, second)):
        return None
    slopes = [part - part.mean() for part in slopes]
    lag = int(np.argmax(np.abs(correlate(slopes[1], slopes[0])))) - (len(slopes[0]) - 1)
    spline = CubicSpline(step * np.arange(len(first)), first)
    times = step * np.arange(len(second))

    def fitted(delay: float) -> tuple[float, Array, Array, Array]:
        seen = (times >= delay) & (times <= delay + step * (len(first) - 1))
        columns = np.column_stack([spline(times[seen] - delay), np.ones(int(seen.sum()))])
        if len(columns) < FEWEST:
            return np.inf, np.zeros(2), columns, np.zeros(0)
        found: Array = np.linalg.lstsq(columns, second[seen], rcond=None)[0].astype(np.float64)
        rest = second[seen] - columns @ found
        return float(np.mean(rest**2)), found, columns, rest

    centre, delay = step * lag, np.inf
    for _ in range(RECENTRED):
        bounds = (centre - ABOUT * step, centre + ABOUT * step)
        best: Any = minimize_scalar(
            lambda d: fitted(d)[0], bounds=bounds, options={"xatol": 1e-5 * step}
        )
        delay = float(best.x)
        if abs(delay - centre) < (ABOUT - 0.5) * step:
            break
        centre = delay  # the correlation favours lags at which more of both overlaps
    square, found, columns, rest = fitted(delay)
    if not np.isfinite(square):
        return None
    total = float(np.var(rest + columns @ found))
    slope = np.gradient(columns[:, 0], step) * found[0]
    slope = slope - columns @ np.linalg.lstsq(columns, slope, rcond=None)[0]
    near = float(rest[1:] @ rest[:-1] / max(rest @ rest, 1e-300))
    wider = np.sqrt((1.0 + min(near, 0.999)) / (1.0 - min(near, 0.999)))
    sd = wider * np.sqrt(square / max(float(slope @ slope), 1e-300))
    return Shift(
        delay + float(t_b[0] - t_a[0]),
        float(sd),
        float(found[0]),
        float(found[1]),
        1.0 - square / total if total > 0.0 else 0.0,
    )


def _even(t: Array, values: Array, step: float) -> Array:
    """The values every ``step`` [s] from the first on, smoothed over :data:`SMOOTH` steps."""
    known = np.isfinite(values)
    if known.sum() < 2:
        return np.zeros(0)
    times = np.arange(t[0], t[-1] + 0.5 * step, step)
    # samples that are closer than the step are averaged, so as not to fold their noise
    own = float(np.median(np.diff(t)))
    finer = gaussian_filter1d(values[known], SMOOTH * step / own)
    within = np.clip(times, t[known][0], t[known][-1])
    return np.asarray(CubicSpline(t[known], finer)(within), dtype=np.float64)
