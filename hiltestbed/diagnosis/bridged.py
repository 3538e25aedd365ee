"""Stage "layout": uncertainty due to what a log does not hold: lost samples, and ticks between its
rows.

A lost sample is interpolated; the error follows from second differences of its neighbours: for
white noise the two have the same variance but for a factor of four. The numerical model integrates
the error twice, so that it is replayed with such errors drawn at random.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from hiltestbed.diagnosis.links import DynamicsLink, Link
from hiltestbed.diagnosis.settings import SMOOTHING_ROWS
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredRun
from hiltestbed.measured.record import Record

MAX_GAP_ROWS = 5  # chosen: consecutive rows that are interpolated; a longer gap has no known error
MONTE_CARLO_DRAWS = 12  # chosen: replays; they give a spread to a fifth
# chosen: standard deviations; the losses of a run make one departure, which does not average out
GAP_SIGMA = 3.0
KINK_ROWS = 5  # chosen: ticks over which the error of a kink spreads
# chosen: of a bend to their median; noise exceeds it in 3e-4 of the rows at most (simulated, 500 to
# 1700 of 2000 Hz)
KINK_RATIO = 7.0
NEIGHBOUR_ROWS = 21  # chosen: rows around a lost one whose second differences stand for its own


def lost(record: Record, group: str) -> np.ndarray:
    """``(ticks,)`` bool: missing samples; ticks between the rows of a log slower than the loop are
    not missing.
    """
    return record.unknown(group, 0.0)


def only_short_gaps(record: Record, group: str) -> bool:
    """Whether a group is missing samples in short gaps only."""
    edges = np.flatnonzero(np.diff(np.r_[False, lost(record, group), False]))
    return bool((edges[1::2] - edges[::2] <= MAX_GAP_ROWS).all())


def bridging_noise(
    link: DynamicsLink,
    wrenches: Sequence[Array],
    missing: Sequence[np.ndarray],
    between: Sequence[Array],
    level: Array,
) -> list[Array]:
    """``(N, 6)`` uncertainty of the computed motion of each run [m, rad].

    wrenches: (N, 6) interpolated; missing: (N,) bool. between: (N, 6) not 0 on ticks without a row
        in the log; level: (6,) noise there. An interpolated tick is off by ``sqrt(1 + 2/3)`` of the
        noise, averaged over the places between two rows.
    """
    rng, everything = np.random.default_rng(0), range(len(link.runs))
    squares = [np.zeros((run.rows, 6)) for run in link.runs]
    spread = [
        np.hypot(_gap_sigma(w, m), math.sqrt(5.0 / 3.0) * level * (b != 0.0))
        for w, m, b in zip(wrenches, missing, between, strict=True)
    ]
    if not any(s.any() for s in spread):
        return squares
    shown = link.predict([(i, ()) for i in everything])
    for _ in range(MONTE_CARLO_DRAWS):
        shaken = [
            w + s * rng.standard_normal(w.shape) for w, s in zip(wrenches, spread, strict=True)
        ]
        found = DynamicsLink(link.runs, shaken).predict([(i, ()) for i in everything])
        for total, a, b in zip(squares, found, shown, strict=True):
            total += (a - b) ** 2 / MONTE_CARLO_DRAWS
    return [GAP_SIGMA * np.sqrt(np.maximum.accumulate(s, axis=0)) for s in squares]


def interpolation_errors(
    runs: Sequence[MeasuredRun], group: str, rows: Sequence[int]
) -> list[Array]:
    """``(N, parts)`` interpolation error of each run, see `bends` of :class:`Record`; 0 where all
    rows of the group are ticks.
    """
    return [
        r.record.bends.get(group, np.zeros(r.record.data[group].shape))[:n]
        for r, n in zip(runs, rows, strict=True)
    ]


def kink_errors(record: Record, group: str) -> Array:
    """``(ticks, parts)`` error of linear interpolation where a channel bends within a row, as a
    force does at a touch; 0 elsewhere.

    The spline through the samples departs from the polygon there, by at least a sixth of the error
    of the polygon (simulated for rates of the log from a quarter to 1.3 of the loop's, samples
    interpolated by the logger or not): the error is within three standard deviations. What noise
    does to the spline everywhere is no kink.
    """
    bends = record.bends.get(group)
    if bends is None:
        return np.zeros(record.data[group].shape)
    # a tick without a row lies further from a line, up to four times
    size = np.where(record.valid[group], np.abs(bends), 0.0)
    usual = np.array([float(np.median(x[x > 0.0])) if x.any() else 0.0 for x in size.T])
    peak = maximum_filter1d(size, KINK_ROWS, axis=0)
    return np.where(peak > KINK_RATIO * usual, 2.0 * peak, 0.0)


def rms_differences(link: Link, other: Link) -> list[Array]:
    """``(N, channels)`` difference of two links in each run, rms about each row: between the rows
    of a log either may be right.
    """
    everything = [(i, ()) for i in range(len(link.runs))]
    pairs = zip(link.predict(everything), other.predict(everything), strict=True)
    return [
        np.sqrt(np.maximum(uniform_filter1d((a - b) ** 2, SMOOTHING_ROWS, axis=0), 0.0))
        for a, b in pairs
    ]


def _gap_sigma(wrench: Array, missing: np.ndarray) -> Array:
    """(N, 6) standard deviation of the interpolation error at each lost sample [N, N m]."""
    second = np.zeros_like(wrench)
    second[1:-1] = 0.25 * (wrench[2:] - 2.0 * wrench[1:-1] + wrench[:-2]) ** 2
    touched = missing | np.roll(missing, 1) | np.roll(missing, -1)
    known = np.where(touched, 0.0, 1.0)[:, None]
    weight = uniform_filter1d(known, NEIGHBOUR_ROWS, axis=0)
    mean = uniform_filter1d(second * known, NEIGHBOUR_ROWS, axis=0) / np.maximum(
        weight, 1.0 / NEIGHBOUR_ROWS
    )
    # where the interpolation meets measured samples: a touch
    kinks = np.maximum(np.roll(second, 1, axis=0), np.roll(second, -1, axis=0))
    return np.sqrt(np.maximum(mean, 4.0 * kinks)) * missing[:, None]
