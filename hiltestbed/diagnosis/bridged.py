"""Stage "layout": uncertainty due to what a log does not hold: lost samples, and ticks between its
rows.

A lost sample is interpolated; the error follows from the noise and from how the force bends across
the gap. What a link makes of such errors is correlated over its rows, above all where it integrates
them, and is found by replays.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from hiltestbed.diagnosis.links import LinkRun, ModelLink
from hiltestbed.diagnosis.nuisances import Aside
from hiltestbed.diagnosis.settings import CORRELATED_ROWS, SMOOTHING_ROWS
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredRun
from hiltestbed.measured.record import Record

# replays that give the covariance of the output: whitened by that of n draws, errors with p modes
# have a mean square of n/(n - p - 1) per mode (H. Hotelling, Ann. Math. Stat. 2, 1931): 1.2 for the
# six that matter of an error that is integrated twice
MODELLED_DRAWS = 40
LEFT_DRAWS = 12  # further ones, which give what whitening leaves to a fifth
# chosen: standard deviations; the losses of a run make one departure, which does not average out
GAP_SIGMA = 3.0
# on errors of a computed channel, whose rows are correlated
CORRELATION_FACTOR = math.sqrt(CORRELATED_ROWS)
KINK_ROWS = 5  # chosen: ticks over which the error of a kink spreads
# chosen: of a bend to their median; noise exceeds it in 3e-4 of the rows at most (simulated, 500 to
# 1700 of 2000 Hz)
KINK_RATIO = 7.0


def bridged(
    runs: Sequence[LinkRun],
    fed: Callable[[Sequence[Array]], ModelLink],
    wrenches: Sequence[Array],
    missing: Sequence[np.ndarray],
    between: Sequence[Array],
    level: Array,
) -> list[LinkRun]:
    """The ``runs`` of a link that is computed from a wrench with gaps, with the uncertainty of its
    output, from replays on inputs with errors drawn at random.

    The covariance of the output is that of the draws: most of them are nuisance terms, and what
    whitening by these leaves of the others is noise.

    fed: the link on other wrenches (N, 6). wrenches: (N, 6) interpolated; missing: (N,) bool.
        between: (N, 6) not 0 on ticks without a row in the log. level: (6,) noise of the wrench.
    """
    unread = [m | (b != 0.0).any(axis=1) for m, b in zip(missing, between, strict=True)]
    if not any(u.any() for u in unread):
        return list(runs)
    bent = [_bent(w, m) for w, m in zip(wrenches, missing, strict=True)]
    rng = np.random.default_rng(0)
    shown = fed(wrenches).shown_in_all()
    errors: list[list[Array]] = [[] for _ in runs]
    for _ in range(MODELLED_DRAWS + LEFT_DRAWS):
        shaken = [
            w + _interpolated(rng, u, level) + b * _of_each_gap(rng, u)
            for w, u, b in zip(wrenches, unread, bent, strict=True)
        ]
        for found, a, b in zip(errors, fed(shaken).shown_in_all(), shown, strict=True):
            found.append(a - b)
    out = []
    for run, found in zip(runs, errors, strict=True):
        terms = GAP_SIGMA * np.stack(found[:MODELLED_DRAWS], axis=2) / math.sqrt(MODELLED_DRAWS)
        aside = Aside(run.weight, None, terms)
        left = [GAP_SIGMA * (e - aside.of(e)) for e in found[MODELLED_DRAWS:]]
        noise = np.sqrt(np.mean(np.square(left), axis=0))
        sigma = np.hypot(run.sigma, CORRELATION_FACTOR * noise)
        out.append(replace(run, sigma=sigma, shared=terms))
    return out


def _interpolated(rng: np.random.Generator, unread: np.ndarray, level: Array) -> Array:
    """(N, 6) error of interpolated samples by noise: that of the line between the samples on both
    sides, which all samples of a gap share, less their own.
    """
    noise = level * rng.standard_normal((len(unread), 6))
    rows, known = np.arange(len(unread)), np.flatnonzero(~unread)
    line = np.column_stack([np.interp(rows, known, column[known]) for column in noise.T])
    return np.where(unread[:, None], line - noise, 0.0)


def _of_each_gap(rng: np.random.Generator, unread: np.ndarray) -> Array:
    """(N, 1) a standard normal number for each gap, the same in all of its rows."""
    gap = np.cumsum(np.diff(unread, prepend=False) & unread)
    return np.asarray(rng.standard_normal(gap[-1] + 1)[gap][:, None])


def interpolation_errors(
    runs: Sequence[MeasuredRun], group: str, rows: Sequence[int]
) -> list[Array]:
    """``(N, parts)`` of each run, see `bends` of :class:`Record`; 0 where all rows are ticks."""
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


def rms_differences(link: ModelLink, other: ModelLink) -> list[Array]:
    """``(N, channels)`` difference of two links in each run, rms about each row."""
    pairs = zip(link.shown_in_all(), other.shown_in_all(), strict=True)
    return [
        np.sqrt(np.maximum(uniform_filter1d((a - b) ** 2, SMOOTHING_ROWS, axis=0), 0.0))
        for a, b in pairs
    ]


def _bent(wrench: Array, missing: np.ndarray) -> Array:
    """(N, 6) error of linear interpolation across each gap [N, N m]; 0 elsewhere.

    At j of n intervals a line is off by f'' j (n - j)/2 where the force is smooth, and by at most s
    j (n - j)/n where its slope changes by s within the gap, as at a touch. Both are at most d j (n
    - j)/n^2, d the change from the rise over n rows before the gap to that over n rows after it.
    """
    out = np.zeros_like(wrench)
    edges = np.flatnonzero(np.diff(np.r_[False, missing, False]))
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        a, b = start - 1, end  # the samples on both sides
        n = b - a
        if a < n or b + n >= len(wrench):
            continue
        change = np.abs((wrench[b + n] - wrench[b]) - (wrench[a] - wrench[a - n]))
        j = np.arange(1, n)[:, None]
        out[start:end] = change * j * (n - j) / n**2
    return out
