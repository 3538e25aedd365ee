"""Time stamps of a file, and its samples on the loop's ticks: faults of the clock, its start, and
clocks that start again from zero when they are full (a time of day at midnight, a counter of 32
bits).

A log with one row per tick was written by the loop, so the ticks are its true time: stamps that
deviate by a fraction of a tick come from another clock, read late or rounded, or from one that runs
slightly fast or slow. If samples were really taken between ticks, the motion is smoother over the
stamps than over the ticks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from hiltestbed.frames import Array
from hiltestbed.measured.remark import Remark, error, loss, note
from hiltestbed.measured.units import UNITS

# part of the rows that repeat a time stamp, above which the clock is too coarse
REPEATED_LIMIT = 0.1
# a log's rate over the loop's, at most, for the unit of its stamps to be told: less than the square
# root of 60000, from ms to min
OTHER_RATE = 3.0
GAP = 1.75  # sample intervals: a longer one is a gap
LENGTH_LIMIT = 20.0  # longest record, in durations of the scenario
JITTER_LIMIT = 0.02  # of the interval; a larger spread of the sampling gives a note
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
ON_TICK = 1e-6  # of a tick: a sample this close to a tick is used for it without interpolation
AT_END = 0.02  # of a tick: the same for a tick just before the first or just after the last sample
OFF_RATE = 2e-3  # relative rate difference that a clock may have from the loop's
UNEVEN = 0.45  # of an interval: largest deviation of a stamp
APART = 0.05  # of a tick: largest common offset of all rows from the ticks
ROUGHER = 1.1  # largest ratio of two roughnesses by chance
NEIGHBOURS = (-2, -1, 1, 2)  # samples that determine a cubic


@dataclass(frozen=True)
class UsableRows:
    """The usable rows of a file, in time order.

    Attributes:
        t: ``(kept,)`` [s], strictly increasing.
        rows: ``(kept,)`` their rows in the file.
        interval: [s] median sample interval.
    """

    t: Array
    rows: NDArray[np.intp]
    interval: float


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
    near = WITHIN * float(np.median(steps[steps > 0]))
    if stamps[0] <= near or (np.abs(stamps[back + 1]) > near).any():
        return t, []
    for name, period in PERIODS.items():
        if (np.abs(stamps[back] - period) <= near).all():
            out = t.copy()
            out[rows] = stamps + period * np.cumsum(np.r_[False, steps < 0])
            text = (
                f"starts again from zero at {period:.9g} s ({name}), first in row "
                f"{rows[back[0] + 1] + 1}: {period:.9g} s added from there"
            )
            return out, [note(run, "t", text)]
    return t, []


def check_clock(
    run: int, t: Array, tick: float, duration: float
) -> tuple[UsableRows | None, list[Remark]]:
    """The usable rows of time stamps ``(rows,)`` [s] (None if there are none), and the remarks on
    them.

    Args:
        run: its number.
        tick: [s] of the loop.
        duration: [s] of the run by its scenario.
    """
    if len(t) < 2:
        text = f"holds {len(t)} row{'' if len(t) == 1 else 's'}; a run needs at least 2"
        fix = "record the run again or take it out of the dataset"
        return None, [error("", run, "t", text, fix)]
    remarks: list[Remark] = []
    rows = np.flatnonzero(np.isfinite(t))
    lost = len(t) - len(rows)
    if len(rows) < 0.5 * len(t):
        text = f"is not a number in {lost} of {len(t)} rows"
        fix = "name the right column under channels: {t: {column: ...}}"
        return None, [error("", run, "t", text, fix)]
    if lost:
        text = f"is not a number in {lost} of {len(t)} rows, which are left out"
        remarks.append(loss(run, "t", text))
    steps = np.diff(t[rows])
    backwards = np.flatnonzero(steps < 0)
    if len(backwards):
        row, after = rows[backwards[0]], rows[backwards[0] + 1]
        text = (
            f"runs backwards at {len(backwards)} place(s), first from row {row} "
            f"({t[row]:.9g} s) to row {after} ({t[after]:.9g} s)"
        )
        fix = (
            "allowed are rows in order of time; split the file where a second record begins, or "
            "sort them if single rows are out of order"
        )
        return None, [*remarks, error("", run, "t", text, fix)]
    if repeated := int((steps == 0).sum()):
        first = int(np.flatnonzero(steps == 0)[0])
        text = (
            f"has the same stamp in {repeated} of {len(rows)} rows, first {t[rows][first]:.9g} s "
            f"at row {first}"
        )
        if repeated > REPEATED_LIMIT * len(rows):
            fix = "the clock is too coarse for the sampling; export it with more digits"
            return None, [*remarks, error("", run, "t", text, fix)]
        remarks.append(loss(run, "t", text + "; the first of each is kept"))
    rows = rows[np.r_[True, steps > 0]]
    stamps = t[rows]
    interval = float(np.median(np.diff(stamps)))
    scale = _wrong_length(run, stamps, interval, tick, duration)
    if scale is not None:
        return None, [*remarks, scale]
    return UsableRows(stamps, rows, interval), [*remarks, *_sampling(run, stamps, interval, tick)]


def _wrong_length(
    run: int, t: Array, interval: float, tick: float, duration: float
) -> Remark | None:
    """A remark on a record much longer or shorter than its scenario, as in another unit."""
    span, ratio = float(t[-1] - t[0]), interval / tick
    longer = span > LENGTH_LIMIT * max(duration, tick)
    shorter = span < duration / LENGTH_LIMIT and ratio < 1 / LENGTH_LIMIT
    if not (longer or shorter):
        return None
    text = (
        f"lasts {span:.4g} s at {interval:.3g} s a sample; the scenario lasts "
        f"{duration:.4g} s at {tick:.3g} s a tick"
    )
    fix = (
        f"cut the file to the run, or give the scenario a duration of at least "
        f"{span / LENGTH_LIMIT:.3g} s"
    )
    if shorter or ratio > LENGTH_LIMIT:
        fix = _other_unit(ratio if longer else span / duration) or fix
    return error("", run, "t", text, fix)


def _other_unit(size: float) -> str:
    """The likely unit of stamps ``size`` times as large as seconds, for the channel map; or ""."""
    units = {name: factor for name, factor in UNITS["s"].items() if factor != 1.0}

    def nearest(factors: Mapping[str, float]) -> str | None:
        off = {name: abs(math.log(factor * size)) for name, factor in factors.items()}
        name = min(off, key=off.__getitem__)
        return name if off[name] < math.log(OTHER_RATE) else None

    if name := nearest(units):
        return (
            f"if its unit is {name} ({units[name]:g} s), channels: {{t: {{unit: {name}}}}}; on top "
            f"of a scale there, channels: {{t: {{scale: {units[name]:g}}}}}"
        )
    if name := nearest({name: 1.0 / factor for name, factor in units.items()}):
        return (
            f"if it is in s, and was converted from {name} on top, channels: {{t: {{unit: s}}}} "
            f"without a scale there"
        )
    return ""


def start_of_run(
    run: int, first: float, tick: float, duration: float
) -> tuple[float, list[Remark]]:
    """The offset to subtract from the stamps so that they count from the start of the run, and the
    remarks on it.

    If the first stamp is below 0 or beyond the duration of the run (a wall clock), time is counted
    from the first row.
    """
    if -0.5 * tick <= first <= max(duration, tick):
        late = first > 1.5 * tick
        text = f"begins {first:.6g} s after the start of the run; the ticks before are not measured"
        return 0.0, [loss(run, "t", text)] if late else []
    text = (
        f"reads {first:.9g} s at the first row, which is outside the run; time is "
        f"counted from that row"
    )
    fix = "if the run began at another time, give channels: {t: {offset: ...}} for it"
    return first, [note(run, "t", text, fix)]


def _sampling(run: int, t: Array, interval: float, tick: float) -> list[Remark]:
    """Notes on sampling rate, jitter and gaps."""
    remarks, steps = [], np.diff(t)
    if abs(interval - tick) > 0.01 * tick:
        text = (
            f"is sampled at {1 / interval:.6g} Hz, the loop runs at {1 / tick:.6g} Hz; "
            f"resampled to the ticks"
        )
        text += ", of which most hold no sample" if interval > 1.5 * tick else ""
        fix = (
            f"if the facility's loop runs at that rate, give rate: {1 / interval:.6g} in "
            f"its scenario: else its delays are misread"
        )
        remarks.append(note(run, "t", text, fix))
    gap = steps > GAP * interval
    if gap.any():
        longest, missing = float(steps.max()), float((steps[gap] / interval - 1).sum())
        text = (
            f"has {gap.sum()} gap(s), about {missing:.0f} samples; the longest "
            f"{longest:.4g} s from {t[steps.argmax()]:.6g} s"
        )
        remarks.append(loss(run, "t", text))
    spread = float(np.std(steps[~gap])) / interval
    if spread > JITTER_LIMIT:
        text = (
            f"is sampled unevenly: the interval of {interval:.4g} s spreads by "
            f"{100 * spread:.1f} % (1 sigma)"
        )
        remarks.append(note(run, "t", text))
    return remarks


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
            remarks.append(note(run, "t", text))
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
    interpolated linearly where none was measured; None if most rows are ticks of the loop, one
    after the other.

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
    if len(t) < len(NEIGHBOURS) or not measured.any():
        return None
    # rows of the loop, some of which the logger lost, are no other clock
    off = np.abs(t / tick - np.round(t / tick)) > ON_TICK
    if not np.median(off) and np.median(np.diff(t)) < GAP * tick:
        return None
    at = tick * np.arange(len(straight), dtype=np.float64)
    off = (at > t[0]) & (at < t[-1]) & (_about(t, at)[3] > ON_TICK * tick)
    out = np.zeros(len(straight))
    linear = np.interp(at[off], at[measured], straight[measured])
    out[off] = CubicSpline(t, values)(at[off]) - linear
    return out
