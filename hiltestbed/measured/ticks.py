"""Samples of a file on the loop's ticks.

A log with one row per tick was written by the loop, so the ticks are its true time: stamps that
deviate by a fraction of a tick come from another clock, read late or rounded, or from one that runs
slightly fast or slow. If samples were really taken between ticks, the motion is smoother over the
stamps than over the ticks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from hiltestbed.frames import Array
from hiltestbed.measured.clock import GAP, UsableRows
from hiltestbed.measured.remark import Remark, note

ON_TICK = 1e-6  # of a tick: a sample this close to a tick is used for it without interpolation
AT_END = 0.02  # of a tick: the same for a tick just before the first or just after the last sample
# part of the ticks without a sample of their own, above which the rows follow another clock
OFF_TICKS = 0.2
FEWEST = 4  # samples that determine a cubic
OFF_RATE = 2e-3  # relative rate difference that a clock may have from the loop's
UNEVEN = 0.45  # of an interval: largest deviation of a stamp
APART = 0.05  # of a tick: largest common offset of all rows from the ticks
ROUGHER = 1.1  # largest ratio of two roughnesses by chance
NEIGHBOURS = (-2, -1, 1, 2)


def as_ticks(
    run: int, clocks: Sequence[tuple[UsableRows, Mapping[str, Array]]], tick: float
) -> tuple[dict[int, UsableRows], list[Remark]]:
    """Clocks by the id of those given, with stamps on the loop's ticks if their rows are ticks, and
    a remark on each changed clock.

    clocks: each with the columns (file rows) that it stamps.
    """
    out, remarks = {}, []
    for clock, columns in clocks:
        found = out[id(clock)] = _on_ticks(clock, columns, tick)
        if found is not clock:
            off = float(np.abs(found.t - clock.t).max()) / tick
            text = (
                f"deviates from the loop's ticks by up to {off:.2g} of a tick; the rows "
                f"are assigned to the ticks in order"
            )
            remarks.append(note(run, "t", text, off=off))
    return out, remarks


def _on_ticks(clock: UsableRows, columns: Mapping[str, Array], tick: float) -> UsableRows:
    """The clock with each row on its tick; unchanged if rows are no ticks, or are there."""
    t = clock.t
    if len(t) < 30 or abs(clock.interval / tick - 1.0) > UNEVEN:
        return clock
    number = _numbers(t, clock.interval)
    if number is None:
        return clock
    slope, start = np.polyfit(number, t, 1)
    first = round(start / tick)
    if abs(start / tick - first) > APART or abs(slope / tick - 1.0) > OFF_RATE:
        return clock
    ticks = (first + number) * tick
    there = first < 0 or np.abs(t - ticks).max() <= ON_TICK * tick
    if there or not _as_smooth(clock, columns, ticks):
        return clock
    return replace(clock, t=ticks, interval=tick)


def _numbers(t: Array, interval: float) -> Array | None:
    """``(n,)`` whole intervals from the first stamp; None unless each stamp is near a different
    multiple of the interval.

    It is first assumed that no row was lost: two neighbours with opposite jitter may appear to be
    two intervals apart.
    """
    counted = np.r_[0.0, np.cumsum(np.round(np.diff(t) / interval))]
    for number in (np.arange(len(t), dtype=float), counted):
        slope, start = np.polyfit(number, t, 1)
        off = np.abs(t - start - slope * number)
        if (np.diff(number) >= 1.0).all() and (off <= UNEVEN * interval).all():
            return np.asarray(number)
    return None


def _as_smooth(clock: UsableRows, columns: Mapping[str, Array], ticks: Array) -> bool:
    """Whether the position that moves most is about as smooth over the ticks as over the stamps."""
    positions = ("px", "py", "pz")
    places = [
        c[clock.rows] for n, c in columns.items() if n.startswith("pose") and n[-2:] in positions
    ]
    moving = max((c for c in places if np.isfinite(c).all()), key=np.ptp, default=None)
    if moving is None:
        return True
    return _roughness(ticks, moving) <= ROUGHER * _roughness(clock.t, moving)


def _roughness(t: Array, values: Array) -> float:
    """Median distance of a sample from the cubic through its four neighbours, at times t."""

    def moved(values: Array, by: int) -> Array:
        return values[2 + by : len(values) - 2 + by]

    total = np.zeros(len(t) - 4)
    for j in NEIGHBOURS:
        weight = np.ones(len(t) - 4)
        for i in NEIGHBOURS:
            if i != j:
                weight *= (t[2:-2] - moved(t, i)) / (moved(t, j) - moved(t, i))
        total += weight * moved(values, j)
    return float(np.median(np.abs(values[2:-2] - total)))


def to_ticks(
    t: Array, values: Array, ticks: int, tick: float, interval: float
) -> tuple[Array, NDArray[np.bool_]]:
    """Values at the loop's ticks, and which of them were measured.

    A sample on a tick is used unchanged. Between two samples that are not separated by a gap, the
    value is interpolated linearly, but counts as measured only at ticks with a sample within half a
    tick: no tick is filled without data in the file.

    Args:
        t: ``(rows,)`` [s], strictly increasing.
        values: ``(rows,)``, NaN where missing.

    Returns:
        ``(ticks,)`` values, NaN where not measured, and ``(ticks,)`` mask.
    """
    known = np.isfinite(values)
    t, values = t[known], values[known]
    out, valid = np.full(ticks, np.nan), np.zeros(ticks, dtype=bool)
    if not len(t):
        return out, valid
    at = tick * np.arange(ticks, dtype=np.float64)
    before, after, nearest, distance = _about(t, at)
    outside = (at < t[0]) | (at > t[-1])
    on = distance <= np.where(outside, AT_END, ON_TICK) * tick
    out[on] = values[nearest[on]]
    width = t[after] - t[before]
    between = ~on & (distance <= 0.5 * tick) & ~outside & (width <= max(GAP * interval, GAP * tick))
    part = np.divide(at - t[before], width, out=np.zeros(ticks), where=width > 0)
    out[between] = ((1 - part) * values[before] + part * values[after])[between]
    return out, on | between


def _about(
    t: Array, at: Array
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp], Array]:
    """Of each time ``at``: samples before and after, the nearer one, distance to it [s]."""
    after = np.minimum(np.maximum(np.searchsorted(t, at), 1), len(t) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(t[after] - at) < np.abs(at - t[before]), after, before)
    return before, after, nearest, np.abs(t[nearest] - at)


def bend(
    t: Array, values: Array, straight: Array, measured: NDArray[np.bool_], tick: float
) -> Array | None:
    """``(ticks,)`` difference of a cubic spline through the samples from the values at the ticks,
    interpolated linearly where none was measured; None if the rows are the loop's ticks.

    For a curve with second derivative x'', linear interpolation is off by ``x'' h^2 / 8`` midway
    between samples at distance h; the error of the spline is a fraction of this that decreases with
    h^2 (C. de Boor, A Practical Guide to Splines, 2001, chapter V).

    Args:
        t: ``(rows,)`` [s], strictly increasing. values: ``(rows,)``, NaN where missing.
        straight, measured: ``(ticks,)`` values at the ticks and which of them were measured, of
            :func:`to_ticks`.
    """
    known = np.isfinite(values)
    t, values = t[known], values[known]
    if len(t) < FEWEST or not measured.any():
        return None
    at = tick * np.arange(len(straight), dtype=np.float64)
    inside = (at > t[0]) & (at < t[-1])
    off = inside & (_about(t, at)[3] > ON_TICK * tick)
    # rows that the logger lost are gaps, not another clock
    if off.sum() <= OFF_TICKS * inside.sum():
        return None
    out = np.zeros(len(straight))
    linear = np.interp(at[off], at[measured], straight[measured])
    out[off] = CubicSpline(t, values)(at[off]) - linear
    return out
