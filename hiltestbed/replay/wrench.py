"""Contact and sensor on recorded poses: the predicted readings of the sensor."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numba import get_num_threads

from hiltestbed.compiled.jit import copied, njit
from hiltestbed.contact.wrench import tilts
from hiltestbed.effects.log import LogParameters
from hiltestbed.frames import Array
from hiltestbed.replay.contact_path import Trajectory, contact_along
from hiltestbed.replay.felt import ContactKey, Felt
from hiltestbed.replay.mounted import RIGID, PathMount
from hiltestbed.replay.simulated import Simulated
from hiltestbed.sensor.chain import MEMORY, condition, filters, passes
from hiltestbed.sensor.parameters import SensorParameters, stack
from hiltestbed.sensor.sensor import WHOLE


class Lane(NamedTuple):
    """One lane: the run that drives it, and the parameters of contact, sensor and record; later:
    [s] additional delay of the reading.

    ``contact``: (C + 1, PARAMETERS) of each candidate and of the latch.
    """

    run: int
    contact: Array
    sensor: SensorParameters
    log: LogParameters
    later: float = 0.0


def replay_wrench(felt: Felt | Simulated, lanes: Sequence[Lane], grid: int | None = None) -> Array:
    """``(L, N, 6)`` noiseless readings of the sensor, as they should be in the record.

    Args:
        grid: number of instants per tick between which a delayed reading is interpolated linearly,
            as in a facility that computes its contact in steps; None: a delayed reading is the
            wrench at exactly the delayed time, and linear between these for the sensor's filters. A
            compliant mount and a
            :class:`Simulated` contact are always integrated at the physics instants.
    """
    h, again = felt.tick, np.array([lane.log.skew * lane.log.reread for lane in lanes])
    delay = np.array([lane.sensor.delay + lane.later for lane in lanes]) + again
    ticks = np.maximum(delay, 0.0) / h
    whole = np.abs(ticks - np.round(ticks)) < WHOLE
    ticks[whole] = np.round(ticks[whole])
    instants = felt.instants(grid)
    if instants:
        parts = np.tile(np.arange(1, instants + 1) / instants, (len(lanes), 1))
    else:
        parts = np.ones((len(lanes), 2))
        parts[:, 0] = np.where(whole, 1.0, 1.0 - (ticks - np.floor(ticks)))
    elements = stack([lane.sensor for lane in lanes], h / max(instants, 1))
    elements.step[:] = 0.0
    if elements.tone.shape[1]:
        # a tone continues until it is read again
        elements.tone[:, :, 4] -= 2.0 * math.pi * elements.tone[:, :, 3] * again[:, None]
    out = np.empty((len(lanes), felt.poses.shape[1], 6))
    between = bool(instants)
    # lanes that differ only in their sensor share the contact wrench
    sharing: dict[ContactKey, list[int]] = {}
    for i, lane in enumerate(lanes):
        key = lane.run, between, parts[i].tobytes(), lane.contact.tobytes()
        sharing.setdefault(key, []).append(i)
    known = {key: felt.kept.get(key) for key in sharing}
    new = [members[0] for key, members in sharing.items() if known[key] is None]
    if isinstance(felt, Simulated):
        exerted = iter(felt.exerted([(lanes[i].run, lanes[i].contact) for i in new]))
    else:
        exerted = _exerted(felt, [lanes[i] for i in new], parts[new], between)
    for key, members in sharing.items():
        sub = known[key]
        sub = next(exerted) if sub is None else sub
        felt.kept.keep(key, sub)
        _sense(np.array(members), sub, between, ticks, h, elements, out)
    for i, lane in enumerate(lanes):
        if lane.log.skew and not lane.log.reread:
            out[i] = shifted(out[i], -lane.log.skew / h)
    return out


def _exerted(felt: Felt, lanes: Sequence[Lane], parts: Array, between: bool) -> Iterator[Array]:
    """``(N, m, 6)`` contact wrench of each lane at the instants ``parts`` (L, m) of the tick that
    ends at each row; those on a mount, which take long, in parallel.
    """

    def one(i: int) -> Array:
        r, p, mount = lanes[i].run, lanes[i].contact, RIGID
        if (m := felt.mount) is not None:
            moves = felt.leapfrog, m.mobility, felt.hastened
            mount = PathMount(m.stiffness[r], m.damping[r], m.body, *moves)
        path = Trajectory(
            felt.poses[r],
            felt.twists[r],
            felt.ends[r],
            felt.rates is not None,
            felt.before[r],
            felt.clear[r],
            bool(felt.captured[r]),
            felt.latch[r],
            felt.tick,
            felt.geometry,
            felt.least_creep,
        )
        sub = np.empty((felt.poses.shape[1], parts.shape[1], 6))
        contact_along(path, mount, p, tilts(p[-1:])[0], parts[i], between, sub)
        return sub

    workers = min(get_num_threads(), len(lanes))
    if felt.mount is None or workers < 2:
        yield from map(one, range(len(lanes)))
        return
    with ThreadPoolExecutor(workers) as pool:
        yield from pool.map(one, range(len(lanes)))


def shifted(values: Array, ticks: float, held: bool = True) -> Array:
    """``values`` (N, C) read ``ticks`` rows later (or earlier), interpolated linearly; beyond the
    ends held, or extrapolated linearly.
    """
    out = np.empty(values.shape)
    _shift(np.ascontiguousarray(values, dtype=float), float(ticks), held, out)
    return out


@njit(cache=True)
def _shift(values, ticks, held, out):
    last = len(values) - 1
    for k in range(len(values)):
        row = min(max(k + ticks, 0.0), last) if held else k + ticks
        low = int(min(max(math.floor(row), 0), last if held else max(last - 1, 0)))
        high, part = min(low + 1, last), row - low
        for j in range(values.shape[1]):
            out[k, j] = values[low, j] + part * (values[high, j] - values[low, j])


@njit(cache=True)
def _sense(lanes, sub, between, ticks, h, elements, out):
    """Readings of the sensors of the ``lanes`` for one contact wrench ``sub`` (N, m, 6), written to
    ``out`` (L, N, 6).
    """
    lag, leak = elements.lag, elements.leak
    memory = np.zeros((max(lag.shape[1], leak.shape[1]), MEMORY, 6))
    m = sub.shape[1] if between else 1
    quiet, late, rows = np.zeros(6), np.zeros((m, 6)), out.shape[1]
    for i in lanes:
        memory[:] = 0.0
        first = 0 if filters(lag[i], leak[i]) else m - 1
        back = int(math.floor(ticks[i]))
        if not between and passes(i, elements):
            out[i, :back] = 0.0
            copied(sub[: rows - min(back, rows), 0], out[i, back:])
            continue
        for k in range(rows):
            if between:
                for s in range(first, m):
                    _interpolated(sub, k * m - (m - 1 - s) - ticks[i] * m, late[s])
            else:
                for j in range(6):
                    late[0, j] = sub[k - back, 0, j] if k >= back else 0.0
            condition(i, elements, late, k * h, quiet, memory, out[i, k])


@njit(cache=True)
def _interpolated(sub, at, late):
    """``late`` (6,): the wrench at instant ``at`` of ``sub`` (N, m, 6), whose last instant in row k
    is k m; zero before the start.
    """
    m = sub.shape[1]
    if abs(at - round(at)) < WHOLE:
        at = round(at)
    first = math.floor(at)
    part = at - first
    for j in range(6):
        a = sub[(first + m - 1) // m, (first + m - 1) % m, j] if first >= 0 else 0.0
        if part > 0.0:
            b = sub[(first + m) // m, (first + m) % m, j] if first + 1 >= 0 else 0.0
            a += part * (b - a)
        late[j] = a
