"""Speed and acceleration of a recorded position, the noise of a record, and whether its two signals
have to do with each other.

Slow signals resemble each other by chance: a random walk has a trend, and follows a part of any
sine (C. W. J. Granger, P. Newbold, J. Econometrics 2, 1974). A force or a position is therefore
explained by the recorded motion and by motions that did not happen, which are as slow: the recorded
one at other paces.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_coeffs, savgol_filter

from hiltestbed.frames import Array
from hiltestbed.measured.noise import step_of, white_noise

ORDER = 3  # of the local polynomials
WINDOWS = (5, 7, 9, 13, 17, 25, 35, 49, 69, 97, 137)  # rows of a window, each 1.4 times the last
# of the noise: what a window may leave of a position. White noise leaves 1 - 9/(4 w) of itself, so
# that a tenth above it is motion that the window cut off
CUT_OFF = 1.1
UNEVEN = 0.02  # of the median interval: largest departure of an even clock

# of the recorded pace, and as much faster: by chance, one of 21 motions is the best
PACES = np.geomspace(0.4, 0.8, 10)
LESS = 0.8  # of what the best of them leaves: the recorded motion explains more than chance does
ROWS = 4000  # of a record that are compared


class Motion(NamedTuple):
    """A smooth motion through a recorded position: (N,) each, at even times.

    Attributes:
        way: sign of the speed, less than 1 where its noise leaves it open, or the mean over what a
            row stands for. window: rows over which it was smoothed. resolved, shaken: [m/s],
            [m/s^2] standard deviations of speed and acceleration.
    """

    t: Array
    x: Array
    v: Array
    a: Array
    way: Array
    window: int
    resolved: float
    shaken: float

    def turns(self, sigma: float) -> NDArray[np.intp]:
        """The rows just before and just after each change of direction on whose both sides, half a
        window away, the speed is more than ``sigma`` standard deviations.
        """
        before = np.flatnonzero(np.diff(np.signbit(self.v)))
        moves, last = np.abs(self.v) > sigma * self.resolved, len(self.v) - 1
        half = self.window // 2
        both = moves[np.maximum(before - half, 0)] & moves[np.minimum(before + 1 + half, last)]
        return np.union1d(before[both], before[both] + 1)

    def thinned(self, rows: slice | NDArray[np.intp]) -> Motion:
        """Some of its rows."""
        t, x, v, a, way = (np.ascontiguousarray(part[rows]) for part in self[:5])
        return Motion(t, x, v, a, way, self.window, self.resolved, self.shaken)


class States(NamedTuple):
    """Where an axis is at each value of a residual: (N,) each.

    Attributes:
        force: that drives it or is measured; None of a servo. scale: of the residual, to its SI
            unit. place: the joint of an arm. turns: whether positions are angles.
    """

    t: Array
    x: Array
    v: Array
    a: Array
    force: Array | None = None
    scale: float = 1.0
    place: str = ""
    turns: bool = False


def even(t: Array, *signals: Array) -> tuple[Array, ...]:
    """The times and signals at even intervals: as they are where the clock is even."""
    steps = np.diff(t)
    tick = float(np.median(steps))
    if np.abs(steps - tick).max() <= UNEVEN * tick:
        return (t, *signals)
    at = np.arange(t[0], t[-1] + 0.5 * tick, tick)
    return (at, *(np.interp(at, t, s) for s in signals))


def noise_of(y: Array) -> float:
    """1 sigma of the noise of a signal: what differs from row to row, and not less than that of its
    quantisation.
    """
    step = step_of(y) or 0.0
    return max(white_noise(y, step), step / math.sqrt(12.0))


def window_of(x: Array) -> int:
    """Rows of the longest window that leaves no more of positions (N,) than their noise."""
    window, noise = WINDOWS[0], noise_of(x)
    for longer in WINDOWS[1:]:
        left = x - smoothed(x, longer) if longer <= len(x) // 4 else np.array([np.inf])
        if float(np.sqrt(np.mean(left * left))) > CUT_OFF * noise:
            break
        window = longer
    return window


def motion_of(t: Array, x: Array, window: int | None = None) -> Motion:
    """The motion through positions (N,) at even times, by local cubics (A. Savitzky, M. J. E.
    Golay, Anal. Chem. 36, 1964) over a ``window`` of rows, by default that of :func:`window_of`.
    """
    tick, noise = float(np.median(np.diff(t))), noise_of(x)
    window = window or window_of(x)
    smooth, v, a = (
        np.asarray(savgol_filter(x, window, ORDER, deriv=d, delta=tick)) for d in range(3)
    )
    # variance of a derivative of a local cubic at its middle: the sum of its squared coefficients
    gains = [
        float(np.linalg.norm(savgol_coeffs(window, ORDER, deriv=d, delta=tick))) for d in (1, 2)
    ]
    resolved = gains[0] * noise
    way = np.tanh(v / max(resolved, 1e-12))
    return Motion(t, smooth, v, a, way, window, resolved, gains[1] * noise)


def weights_of(window: int) -> Array:
    """Weights (window - 2,) with which an acceleration of :func:`motion_of` averages the second
    difference over its window: the second sum of the coefficients of the second derivative. What is
    averaged by the same can be compared with it, also where it jumps.
    """
    return np.cumsum(np.cumsum(savgol_coeffs(window, ORDER, deriv=2)))[:-2]


def averaged(y: Array, window: int) -> Array:
    """(N,) a signal averaged as the acceleration of a motion is; as it is over the half window at
    each end.
    """
    out, half = np.array(y, dtype=float), window // 2
    inner = slice(half, len(out) - half)
    out[inner] = np.convolve(y, weights_of(window), mode="same")[inner]
    return out


def smoothed(y: Array, window: int) -> Array:
    """A signal after the smoothing of a motion."""
    return np.asarray(savgol_filter(y, window, ORDER))


def related(t: Array, x: Array, other: Array) -> bool:
    """Whether the motion (N,) through positions ``x`` explains the signal ``other`` better than
    the same motion at other paces does.
    """
    t, x, other = even(t, x, other)
    m = motion_of(t, x)
    rows = np.arange(0.0, len(t), -(-len(t) // ROWS))
    columns = np.column_stack([m.x, m.v, m.a, m.way, m.x * np.abs(m.x), m.v * np.abs(m.v)])
    at = [_folded(pace * rows, len(t)) for pace in (1.0, *PACES, *1.0 / PACES)]
    left = [_left(columns[some], other[at[0]]) for some in at]
    return left[0] < LESS * min(left[1:])


def _folded(at: Array, count: int) -> np.ndarray:
    """Rows (N,) of a record that runs back where it ends."""
    back = np.rint(at).astype(int) % (2 * count - 2)
    return np.minimum(back, 2 * count - 2 - back)


def _left(columns: Array, y: Array) -> float:
    """Mean square of ``y`` (N,) that no sum of columns, a constant and a trend explains."""
    full = np.column_stack([columns, np.ones(len(y)), np.arange(len(y))])
    scaled = full / np.maximum(np.abs(full).max(axis=0), 1e-300)
    found = np.linalg.lstsq(scaled, y, rcond=None)[0]
    return float(np.mean((y - scaled @ found) ** 2))
