"""Rows that are the loop's own ticks, whatever their stamps say: stamps that jitter, and a clock that runs a little fast or slow.

A log of one row a tick is written by the loop, whose ticks are its time. Stamps that miss them by a part of a tick are another clock's,
read late or rounded. Where samples really were taken between ticks, the motion is smoother on the stamps than on the ticks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hiltestbed.frames import Array
from hiltestbed.measured.clock import ON_TICK, Clock
from hiltestbed.measured.remark import Remark

OFF_RATE = 2e-3  # part by which a clock may differ from the loop's
UNEVEN = 0.45  # of an interval, that a stamp may miss its place by
APART = 0.05  # of a tick, by which all rows may lie beside the ticks
ROUGHER = 1.1  # what chance makes of two such figures at most
NEIGHBOURS = (-2, -1, 1, 2)


def as_ticks(run: int, clocks: Sequence[tuple[Clock, Mapping[str, Array]]], tick: float) -> tuple[dict[int, Clock], list[Remark]]:
    """Clocks by the id of those given, with stamps on the loop's ticks where their rows are ticks, and a remark on each that was changed.

    clocks: with the columns (file rows) that they stamp.
    """
    out, remarks = {}, []
    for clock, columns in clocks:
        found = _on_ticks(clock, columns, tick)
        out[id(clock)] = found or clock
        if found is not None:
            off = float(np.abs(found.t - clock.t).max()) / tick
            text = f"misses the loop's ticks by up to {off:.2g} of one; each row is taken for the tick that it is next to in order"
            remarks.append(Remark("note", run, "t", text, "", {"off": off}))
    return out, remarks


def _on_ticks(clock: Clock, columns: Mapping[str, Array], tick: float) -> Clock | None:
    """The clock with each row on its tick; None where the rows are no ticks, or stand on them already."""
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
    if first < 0 or np.abs(t - ticks).max() <= ON_TICK * tick or not _as_smooth(clock, columns, ticks, tick):
        return None
    return replace(clock, t=ticks, interval=tick)


def _numbers(t: Array, interval: float) -> Array | None:
    """``(n,)`` intervals from the first stamp, whole; None where stamps are not next to such places, one each.

    First as if no row were lost: two neighbours that jitter to either side may seem two intervals apart.
    """
    for number in (np.arange(len(t), dtype=float), np.r_[0.0, np.cumsum(np.round(np.diff(t) / interval))]):
        slope, start = np.polyfit(number, t, 1)
        if (np.diff(number) >= 1.0).all() and (np.abs(t - start - slope * number) <= UNEVEN * interval).all():
            return np.asarray(number)
    return None


def _as_smooth(clock: Clock, columns: Mapping[str, Array], ticks: Array, tick: float) -> bool:
    """Whether the place that moves most is about as smooth on the ticks as on the stamps."""
    places = {n: c[clock.rows] for n, c in columns.items() if n.startswith("pose") and n[-2:] in ("px", "py", "pz")}
    places = {n: c for n, c in places.items() if np.isfinite(c).all()}
    if not places:
        return True
    moving = max(places.values(), key=np.ptp)
    return _roughness(ticks, moving) <= ROUGHER * _roughness(clock.t, moving)


def _roughness(t: Array, values: Array) -> float:
    """Median distance of a sample from the cubic through its four neighbours, at the times (n,) that it is thought to be of."""
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
