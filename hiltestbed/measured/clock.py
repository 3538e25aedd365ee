"""Time stamps of a file and the loop's ticks: faults of the clock, and the assignment of samples to
ticks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from hiltestbed.frames import Array
from hiltestbed.measured.remark import Remark
from hiltestbed.measured.units import UNITS

ON_TICK = 1e-6  # of a tick: a sample this close to a tick is used for it without interpolation
AT_END = 0.02  # of a tick: the same for a tick just before the first or just after the last sample
# part of the rows that repeat a time stamp, above which the clock is too coarse
REPEATED_LIMIT = 0.1
# a log's rate over the loop's, at most, for the unit of its stamps to be told: less than the square
# root of 60000, from ms to min
OTHER_RATE = 3.0
GAP = 1.75  # sample intervals: a longer one is a gap
LENGTH_LIMIT = 20.0  # longest record, in durations of the scenario
# part of the ticks without a sample of their own, above which the rows follow another clock
OFF_TICKS = 0.2
FEWEST = 4  # samples that determine a cubic
JITTER_LIMIT = 0.02  # of the interval; a larger spread of the sampling gives a note


@dataclass(frozen=True)
class Clock:
    """The usable rows of a file, in time order.

    Attributes:
        t: ``(kept,)`` [s], strictly increasing.
        rows: ``(kept,)`` their rows in the file.
        interval: [s] median sample interval.
    """

    t: Array
    rows: NDArray[np.intp]
    interval: float


def check_clock(
    run: int, t: Array, tick: float, duration: float
) -> tuple[Clock | None, list[Remark]]:
    """The usable rows of time stamps ``(rows,)`` [s] (None if there are none), and the remarks on
    them.

    Args:
        run: its number.
        tick: [s] of the loop.
        duration: [s] of the run by its scenario.
    """
    if len(t) < 2:
        text = f"holds {len(t)} row{'' if len(t) == 1 else 's'}; a run needs at least 2"
        return None, [
            Remark(
                "error",
                run,
                "t",
                text,
                "record the run again or take it out of the dataset",
                {"rows": len(t)},
            )
        ]
    remarks: list[Remark] = []
    finite = np.isfinite(t)
    if finite.sum() < 0.5 * len(t):
        text = f"is not a number in {len(t) - finite.sum()} of {len(t)} rows"
        return None, [
            Remark(
                "error", run, "t", text, "name the right column under channels: {t: {column: ...}}"
            )
        ]
    if not finite.all():
        lost = int(len(t) - finite.sum())
        remarks.append(
            Remark(
                "loss",
                run,
                "t",
                f"is not a number in {lost} of {len(t)} rows, which are left out",
                "",
                {"rows": lost},
            )
        )
    rows = np.flatnonzero(finite)
    steps = np.diff(t[rows])
    backwards = np.flatnonzero(steps < 0)
    if len(backwards):
        return None, [*remarks, _backwards(run, t, rows, backwards)]
    rows, repeated = rows[np.r_[True, steps > 0]], int((steps == 0).sum())
    if repeated:
        remark = _repeated(run, t[np.flatnonzero(finite)], steps, repeated)
        remarks.append(remark)
        if remark.severity == "error":
            return None, remarks
    stamps = t[rows]
    interval = float(np.median(np.diff(stamps)))
    scale = _wrong_length(run, stamps, interval, tick, duration)
    if scale is not None:
        return None, [*remarks, scale]
    return Clock(stamps, rows, interval), [*remarks, *_sampling(run, stamps, interval, tick)]


def _backwards(run: int, t: Array, rows: NDArray[np.intp], backwards: NDArray[np.intp]) -> Remark:
    row, after = rows[backwards[0]], rows[backwards[0] + 1]
    text = (
        f"runs backwards at {len(backwards)} place(s), first from row {row} "
        f"({t[row]:.9g} s) to row {after} ({t[after]:.9g} s)"
    )
    fix = (
        "allowed are rows in order of time; split the file where a second record begins, or sort "
        "them if single rows are out of order"
    )
    return Remark("error", run, "t", text, fix, {"places": len(backwards), "row": float(row)})


def _repeated(run: int, t: Array, steps: Array, repeated: int) -> Remark:
    first = int(np.flatnonzero(steps == 0)[0])
    evidence = {"rows": repeated, "of": len(t), "first_row": first}
    text = (
        f"has the same stamp in {repeated} of {len(t)} rows, first {t[first]:.9g} s at row {first}"
    )
    if repeated > REPEATED_LIMIT * len(t):
        return Remark(
            "error",
            run,
            "t",
            text,
            "the clock is too coarse for the sampling; export it with more digits",
            evidence,
        )
    return Remark("loss", run, "t", text + "; the first of each is kept", "", evidence)


def _wrong_length(
    run: int, t: Array, interval: float, tick: float, duration: float
) -> Remark | None:
    """A remark on a record that is much longer or shorter than its scenario, usually because its
    clock has another unit.
    """
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
    return Remark(
        "error",
        run,
        "t",
        text,
        fix,
        {"span": span, "duration": duration, "interval": interval, "tick": tick},
    )


def _other_unit(size: float) -> str:
    """What to write in the channel map if stamps are about ``size`` times as large as seconds would
    be: the unit whose factor is nearest, or that of a unit that was converted twice; "" if none
    fits, even with a log at another rate.
    """
    units = {name: factor for name, factor in UNITS["s"].items() if factor != 1.0}

    def nearest(factors: Mapping[str, float]) -> tuple[str, float] | None:
        name = min(factors, key=lambda n: abs(math.log(factors[n] * size)))
        off = abs(math.log(factors[name] * size))
        return (name, factors[name]) if off < math.log(OTHER_RATE) else None

    unit = nearest(units)
    twice = nearest({name: 1.0 / factor for name, factor in units.items()})
    if unit is not None:
        name, factor = unit
        return (
            f"if its unit is {name} ({factor:g} s), channels: {{t: {{unit: {name}}}}}; on top of "
            f"a scale there, channels: {{t: {{scale: {factor:g}}}}}"
        )
    if twice is not None:
        name, _ = twice
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
        return 0.0, [Remark("loss", run, "t", text, "", {"first": first})] if late else []
    text = (
        f"reads {first:.9g} s at the first row, which is outside the run; time is "
        f"counted from that row"
    )
    fix = "if the run began at another time, give channels: {t: {offset: ...}} for it"
    return first, [Remark("note", run, "t", text, fix, {"first": first})]


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
        remarks.append(
            Remark("note", run, "t", text, fix, {"sample_rate": 1 / interval, "rate": 1 / tick})
        )
    gaps = np.flatnonzero(steps > GAP * interval)
    if len(gaps):
        longest, missing = float(steps.max()), float((steps[gaps] / interval - 1).sum())
        text = (
            f"has {len(gaps)} gap(s), about {missing:.0f} samples; the longest "
            f"{longest:.4g} s from {t[steps.argmax()]:.6g} s"
        )
        remarks.append(
            Remark(
                "loss",
                run,
                "t",
                text,
                "",
                {"gaps": len(gaps), "longest": longest, "missing": missing},
            )
        )
    spread = float(np.std(steps[steps <= GAP * interval])) / interval
    if spread > JITTER_LIMIT:
        text = (
            f"is sampled unevenly: the interval of {interval:.4g} s spreads by "
            f"{100 * spread:.1f} % (1 sigma)"
        )
        remarks.append(Remark("note", run, "t", text, "", {"spread": spread}))
    return remarks


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
    """For each time ``at``: the samples before and after it, the nearer one, and the distance to
    that one [s].
    """
    after = (
        np.clip(np.searchsorted(t, at), 1, len(t) - 1)
        if len(t) > 1
        else np.zeros(len(at), dtype=np.intp)
    )
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
    out[off] = CubicSpline(t, values)(at[off]) - np.interp(
        at[off], at[measured], straight[measured]
    )
    return out
