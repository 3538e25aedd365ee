"""Rows that are the loop's ticks although their stamps deviate: stamps with jitter, or a clock that
runs slightly fast or slow.

A log with one row per tick was written by the loop, so the ticks are its true time. Stamps that
deviate by a fraction of a tick come from another clock, read late or rounded. If samples were
really taken between ticks, the motion is smoother over the stamps than over the ticks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hiltestbed.frames import Array
from hiltestbed.measured.clock import ON_TICK, Clock
from hiltestbed.measured.remark import Remark

OFF_RATE = 2e-3  # relative rate difference that a clock may have from the loop's
UNEVEN = 0.45  # of an interval: largest deviation of a stamp
APART = 0.05  # of a tick: largest common offset of all rows from the ticks
ROUGHER = 1.1  # largest ratio of two roughnesses by chance
NEIGHBOURS = (-2, -1, 1, 2)


def as_ticks(
    run: int, clocks: Sequence[tuple[Clock, Mapping[str, Array]]], tick: float
) -> tuple[dict[int, Clock], list[Remark]]:
    """Clocks by the id of those given, with stamps on the loop's ticks if their rows are ticks, and
    a remark on each changed clock.

    clocks: each with the columns (file rows) that it stamps.
    """
    out, remarks = {}, []
    for clock, columns in clocks:
        found = _on_ticks(clock, columns, tick)
        out[id(clock)] = found or clock
        if found is not None:
            off = float(np.abs(found.t - clock.t).max()) / tick
            text = (
                f"deviates from the loop's ticks by up to {off:.2g} of a tick; the rows "
                f"are assigned to the ticks in order"
            )
            remarks.append(Remark("note", run, "t", text, "", {"off": off}))
    return out, remarks


def _on_ticks(clock: Clock, columns: Mapping[str, Array], tick: float) -> Clock | None:
    """The clock with each row on its tick; None if the rows are not ticks, or are on them
    already.
    """
    t = clock.t
    if len(t) < 30 or abs(clock.interval / tick - 1.0) > UNEVEN:
        return None
    number = _numbers(t, clock.interval)
    if number is None:
        return None
    slope, start = np.polyfit(number, t, 1)
    first = round(start / tick)
    if abs(start / tick - first) > APART or abs(slope / tick - 1.0) > OFF_RATE:
        return None
    ticks = (first + number) * tick
    if (
        first < 0
        or np.abs(t - ticks).max() <= ON_TICK * tick
        or not _as_smooth(clock, columns, ticks, tick)
    ):
        return None
    return replace(clock, t=ticks, interval=tick)


def _numbers(t: Array, interval: float) -> Array | None:
    """``(n,)`` whole intervals from the first stamp; None unless each stamp is near a different
    multiple of the interval.

    It is first assumed that no row was lost: two neighbours with opposite jitter may appear to be
        two intervals apart.
    """
    for number in (
        np.arange(len(t), dtype=float),
        np.r_[0.0, np.cumsum(np.round(np.diff(t) / interval))],
    ):
        slope, start = np.polyfit(number, t, 1)
        if (np.diff(number) >= 1.0).all() and (
            np.abs(t - start - slope * number) <= UNEVEN * interval
        ).all():
            return np.asarray(number)
    return None


def _as_smooth(clock: Clock, columns: Mapping[str, Array], ticks: Array, tick: float) -> bool:
    """Whether the position that moves most is about as smooth over the ticks as over the stamps."""
    places = {
        n: c[clock.rows]
        for n, c in columns.items()
        if n.startswith("pose") and n[-2:] in ("px", "py", "pz")
    }
    places = {n: c for n, c in places.items() if np.isfinite(c).all()}
    if not places:
        return True
    moving = max(places.values(), key=np.ptp)
    return _roughness(ticks, moving) <= ROUGHER * _roughness(clock.t, moving)


def _roughness(t: Array, values: Array) -> float:
    """Median distance of a sample from the cubic through its four neighbours, for the assumed
    sample times (n,).
    """
    total = np.zeros(len(t) - 4)
    for j in NEIGHBOURS:
        weight = np.ones(len(t) - 4)
        for i in NEIGHBOURS:
            if i != j:
                weight *= (t[2:-2] - _moved(t, i)) / (_moved(t, j) - _moved(t, i))
        total += weight * _moved(values, j)
    return float(np.median(np.abs(values[2:-2] - total)))


def _moved(values: Array, by: int) -> Array:
    return values[2 + by : len(values) - 2 + by]
