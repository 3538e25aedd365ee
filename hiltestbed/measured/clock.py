"""Time stamps of a file: faults of the clock, its start, and clocks that start again from zero when
they are full (a time of day at midnight, a counter of 32 bits).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
            return out, [note(run, "t", text, period=period)]
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
        return None, [error("", run, "t", text, fix, rows=len(t))]
    remarks: list[Remark] = []
    rows = np.flatnonzero(np.isfinite(t))
    lost = len(t) - len(rows)
    if len(rows) < 0.5 * len(t):
        text = f"is not a number in {lost} of {len(t)} rows"
        fix = "name the right column under channels: {t: {column: ...}}"
        return None, [error("", run, "t", text, fix)]
    if lost:
        text = f"is not a number in {lost} of {len(t)} rows, which are left out"
        remarks.append(loss(run, "t", text, rows=lost))
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
        places = len(backwards)
        return None, [*remarks, error("", run, "t", text, fix, places=places, row=float(row))]
    if (steps == 0).any():
        remarks.append(_repeated(run, t[rows], steps))
        if remarks[-1].severity == "error":
            return None, remarks
    rows = rows[np.r_[True, steps > 0]]
    stamps = t[rows]
    interval = float(np.median(np.diff(stamps)))
    scale = _wrong_length(run, stamps, interval, tick, duration)
    if scale is not None:
        return None, [*remarks, scale]
    return UsableRows(stamps, rows, interval), [*remarks, *_sampling(run, stamps, interval, tick)]


def _repeated(run: int, t: Array, steps: Array) -> Remark:
    repeated, first = int((steps == 0).sum()), int(np.flatnonzero(steps == 0)[0])
    evidence = {"rows": repeated, "of": len(t), "first_row": first}
    text = (
        f"has the same stamp in {repeated} of {len(t)} rows, first {t[first]:.9g} s at row {first}"
    )
    if repeated > REPEATED_LIMIT * len(t):
        fix = "the clock is too coarse for the sampling; export it with more digits"
        return error("", run, "t", text, fix, **evidence)
    return loss(run, "t", text + "; the first of each is kept", **evidence)


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
    lengths = {"span": span, "duration": duration, "interval": interval, "tick": tick}
    return error("", run, "t", text, fix, **lengths)


def _other_unit(size: float) -> str:
    """What to write in the channel map if stamps are about ``size`` times as large as seconds would
    be: the unit whose factor is nearest, or that of a unit that was converted twice; "" if none
    fits, even with a log at another rate.
    """
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
        return 0.0, [loss(run, "t", text, first=first)] if late else []
    text = (
        f"reads {first:.9g} s at the first row, which is outside the run; time is "
        f"counted from that row"
    )
    fix = "if the run began at another time, give channels: {t: {offset: ...}} for it"
    return first, [note(run, "t", text, fix, first=first)]


def _sampling(run: int, t: Array, interval: float, tick: float) -> list[Remark]:
    """Notes on sampling rate, jitter and gaps."""
    remarks, steps = [], np.diff(t)
    rates = {"sample_rate": 1 / interval, "rate": 1 / tick}
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
        remarks.append(note(run, "t", text, fix, **rates))
    gap = steps > GAP * interval
    if gap.any():
        longest, missing = float(steps.max()), float((steps[gap] / interval - 1).sum())
        text = (
            f"has {gap.sum()} gap(s), about {missing:.0f} samples; the longest "
            f"{longest:.4g} s from {t[steps.argmax()]:.6g} s"
        )
        remarks.append(loss(run, "t", text, gaps=int(gap.sum()), longest=longest, missing=missing))
    spread = float(np.std(steps[~gap])) / interval
    if spread > JITTER_LIMIT:
        text = (
            f"is sampled unevenly: the interval of {interval:.4g} s spreads by "
            f"{100 * spread:.1f} % (1 sigma)"
        )
        remarks.append(note(run, "t", text, spread=spread))
    return remarks
