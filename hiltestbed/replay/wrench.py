"""Contact and sensor on recorded poses: the predicted readings of the sensor."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numba import get_num_threads

from hiltestbed.compiled.jit import njit
from hiltestbed.contact.geometry import arm
from hiltestbed.contact.latch import closes
from hiltestbed.contact.law import STATES
from hiltestbed.contact.mount import mount_place
from hiltestbed.contact.mount_dynamics import BODY, mount_reading
from hiltestbed.contact.parameters import (
    BLUNT,
    BRANCH_STIFFNESS,
    DRAG,
    LEVER,
    MODE,
    OFFSET,
    OVER_STRETCH,
    TILT_X,
    TILT_Y,
)
from hiltestbed.contact.wrench import (
    contact_wrench,
    held_at,
    meet_all,
    relate_one,
    surface_wrench,
    tilts,
)
from hiltestbed.effects.base import Effect
from hiltestbed.effects.log import LogParameters
from hiltestbed.frames import Array, quat_exp, quat_mul
from hiltestbed.replay.felt import NEAR, ContactKey, Felt, way_between
from hiltestbed.replay.mounted import (
    LAST,
    STEP_SIGMA,
    advance,
    pieces,
    struck,
    swing_freely,
    touched,
)
from hiltestbed.replay.nearness import (
    away_from,
    meet_near,
    meet_next,
    move_lever,
    on_passive,
    outside,
    reach_of_swing,
)
from hiltestbed.replay.simulated import Simulated
from hiltestbed.sensor.chain import MEMORY, condition, filters, passes
from hiltestbed.sensor.parameters import SensorParameters, stack

WHOLE = 1e-6  # ticks within which a delay counts as a whole number


class Lane(NamedTuple):
    """One lane: the run that drives it, and the parameters of contact, sensor and record; later:
    [s] additional delay of the reading.

    ``contact``: (C + 1, PARAMETERS) of each candidate and of the latch. ``effects``: those on the
        contact, which ``contact`` includes.
    """

    run: int
    contact: Array
    sensor: SensorParameters
    log: LogParameters
    later: float = 0.0
    effects: Sequence[Effect] = ()


def replay_wrench(felt: Felt | Simulated, lanes: Sequence[Lane], grid: int | None = None) -> Array:
    """``(L, N, 6)`` noiseless readings of the sensor, as they should be in the record.

    Args:
        grid: number of instants per tick between which a delayed reading is interpolated linearly,
            as in a facility that computes its contact in steps; None: a delayed reading is the
            wrench at exactly the delayed time, and linear between these for the sensor's filters. A
            compliant mount and a
            :class:`Simulated` contact are always integrated at the physics instants.
    """
    h = felt.tick
    delay = np.array(
        [
            max(lane.sensor.delay + lane.later + lane.log.skew * lane.log.reread, 0.0)
            for lane in lanes
        ]
    )
    ticks = delay / h
    whole = np.abs(ticks - np.round(ticks)) < WHOLE
    ticks[whole] = np.round(ticks[whole])
    instants = felt.instants(grid)
    if instants:
        parts = np.tile(np.arange(1, instants + 1) / instants, (len(lanes), 1))
    else:
        parts = np.ones((len(lanes), 2))
        parts[:, 0] = np.where(whole, 1.0, 1.0 - (ticks - np.floor(ticks)))
    rows = np.array([lane.contact for lane in lanes])
    chain = stack([lane.sensor for lane in lanes], h / max(instants, 1))
    if chain.tone.shape[1]:
        again = np.array([lane.log.skew * lane.log.reread for lane in lanes])
        # a tone continues until it is read again
        chain.tone[:, :, 4] -= 2.0 * math.pi * chain.tone[:, :, 3] * again[:, None]
    out = np.empty((len(lanes), felt.poses.shape[1], 6))
    tilt, elements = tilts(rows[:, -1]), chain.elements()
    together = _together(lanes, rows, parts, bool(instants))
    known = {key: felt.kept.get(key) for key in together}
    new = [members[0] for key, members in together.items() if known[key] is None]
    if isinstance(felt, Simulated):
        exerted = iter(felt.exerted([(lanes[i].run, lanes[i].effects) for i in new]))
    else:
        exerted = _exerted(
            felt, [(lanes[i].run, rows[i], parts[i], tilt[i], bool(instants)) for i in new]
        )
    for key, members in together.items():
        sub = known[key]
        sub = next(exerted) if sub is None else sub
        felt.kept.keep(key, sub)
        _sense(np.array(members), sub, bool(instants), ticks, h, elements, out)
    for i, lane in enumerate(lanes):
        if lane.log.skew and not lane.log.reread:
            out[i] = shifted(out[i], -lane.log.skew / h)
    return out


def _together(
    lanes: Sequence[Lane], rows: Array, parts: Array, between: bool
) -> dict[ContactKey, list[int]]:
    """Lanes grouped by run, contact and instants: lanes that differ only in their sensor share the
    contact wrench.
    """
    found: dict[ContactKey, list[int]] = {}
    for i, lane in enumerate(lanes):
        found.setdefault((lane.run, between, parts[i].tobytes(), rows[i].tobytes()), []).append(i)
    return found


def _exerted(felt: Felt, wanted: Sequence[tuple]) -> Iterator[Array]:
    """The wrenches of several contacts, each with the arguments of :func:`_one_contact`; those on a
    mount, which take long, in parallel.
    """
    workers = min(get_num_threads(), len(wanted))
    if felt.mount is None or workers < 2:
        yield from (_one_contact(felt, *one) for one in wanted)
        return
    with ThreadPoolExecutor(workers) as pool:
        yield from pool.map(lambda one: _one_contact(felt, *one), wanted)


def _one_contact(
    felt: Felt, r: int, rows: Array, parts: Array, tilt: Array, between: bool
) -> Array:
    """``(N, m, 6)`` contact wrench of run r at the instants ``parts`` (m,) of the tick that ends at
    each row.
    """
    sub = np.empty((felt.poses.shape[1], len(parts), 6))
    mount = (
        _RIGID
        if felt.mount is None
        else (
            felt.mount.stiffness[r],
            felt.mount.damping[r],
            felt.mount.body,
            felt.leapfrog,
            felt.mount.mobility,
            felt.hastened,
        )
    )
    _contact(
        felt.poses[r],
        felt.twists[r],
        felt.ends[r],
        felt.rates is not None,
        felt.before[r],
        felt.clear[r],
        felt.met,
        felt.lever,
        felt.least_creep,
        felt.tick,
        felt.geometry,
        felt.captured[r],
        felt.latch[r],
        r,
        felt.mount is not None,
        mount,
        parts,
        between,
        rows,
        tilt,
        sub,
    )
    return sub


_RIGID = (np.zeros(6), np.zeros(6), np.zeros(BODY), False, (0.0, 0.0), 0)


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
    calibration, curve, lag, leak, offset, drift, tone, deadzone, limit, step = elements
    stages = max(lag.shape[1], leak.shape[1])
    memory = np.zeros((stages, MEMORY, 6))
    m = sub.shape[1] if between else 1
    quiet, late, rows = np.zeros(6), np.zeros((m, 6)), out.shape[1]
    for i in lanes:
        memory[:] = 0.0
        first = 0 if filters(lag[i], leak[i]) else m - 1
        back = int(math.floor(ticks[i]))
        if not between and passes(
            calibration[i],
            curve[i],
            lag[i],
            leak[i],
            offset[i],
            drift[i],
            tone[i],
            deadzone[i],
            limit[i],
        ):
            out[i, :back] = 0.0
            out[i, back:] = sub[: rows - min(back, rows), 0]
            continue
        for k in range(rows):
            if between:
                for s in range(first, m):
                    _interpolated(sub, k * m - (m - 1 - s) - ticks[i] * m, late[s])
            else:
                for j in range(6):
                    late[0, j] = sub[k - back, 0, j] if k >= back else 0.0
            condition(
                late,
                k * h,
                quiet,
                calibration[i],
                curve[i],
                lag[i],
                leak[i],
                offset[i],
                drift[i],
                tone[i],
                deadzone[i],
                limit[i],
                step[i] * 0.0,
                memory,
                out[i, k],
            )


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


@njit(cache=True, nogil=True)
def _contact(
    poses,
    twists,
    ends,
    bent,
    before,
    clear,
    met,
    lever,
    least_creep,
    h,
    geometry,
    captured,
    latch,
    r,
    mounted,
    mount,
    parts,
    between,
    p,
    tilt,
    sub,
):
    """The wrench at the sensor along one path: ``sub`` (N, m, 6) at the instants ``parts`` (m,) of
    the tick that ends at each row.
    """
    index, values = geometry
    stiffness, damping, _, leapfrog, _, hastened = mount
    count = p.shape[0] - 1
    state, hold = np.zeros((count + 1, STATES)), np.zeros(7)
    hold[6] = 1.0
    depth, closing = np.zeros(count), np.zeros(count)
    point, normal, slip = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros((count, 3))
    frames, motions, turn = np.zeros((2, 7)), np.zeros((2, 6)), np.empty(7)
    wrench, work, local_pose, local_twist = np.zeros(6), np.empty((9, 7)), np.empty(7), np.empty(6)
    frames[1] = tilt
    seen, apart_by = np.zeros((2, 7)), np.zeros(count)
    q, qd, rate, last_rate = np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(LAST)
    meets, earlier, slipped = np.zeros(count, dtype=np.bool_), np.zeros(6), np.zeros((count, 3))
    latched, near, touches = captured, False, 0
    sub[:] = 0.0
    m, last_row = parts.shape[0], p[count]
    depths, rates, points, normals, slips = met
    lean = abs(last_row[TILT_X]) + abs(last_row[TILT_Y])
    reach, longest = (
        max(0.0, -last_row[OFFSET] if count == 0 else -p[0, OFFSET]),
        arm(values, count),
    )
    remembers = (
        last_row[BRANCH_STIFFNESS] > 0.0 or last_row[DRAG] > 0.0 or last_row[OVER_STRETCH] > 0.0
    )
    remembers = remembers or last_row[MODE] > 0.0 or latch[1] < 1.5
    moved = last_row[LEVER] - lever
    plain = (
        lean == 0.0 and not mounted and reach <= NEAR and (moved == 0.0 or on_passive(index, count))
    )
    sharp = not mounted and last_row[MODE] == 0.0
    for c in range(count):
        sharp &= p[c, BLUNT] == 1.0
    for k in range(poses.shape[0]):
        last = before if k == 0 else poses[k - 1]
        if not latched and last_row[MODE] == 0.0:
            if mounted:
                away = away_from(poses[k]) + longest
                swing = reach_of_swing(q, qd, h, away)
                apart = k > 0 and clear[k] > reach + lean * away + swing
                if not apart and lean > 0.0 and k > 0:
                    frames[0], motions[0] = poses[k], ends[k]
                    mount_place(q, rate, tilt, frames[1], motions[1])
                    meet_all(
                        index, values, p, frames, motions, work, depth, closing, point, normal, slip
                    )
                    apart = -depth.max() > reach + swing + way_between(last, poses[k], longest)
            elif lean == 0.0 and reach <= NEAR:
                apart = clear[k] > NEAR or (k > 0 and outside(depths[r, k], depths[r, k - 1], p))
            else:
                apart = clear[k] > reach + lean * (away_from(poses[k]) + longest)
            if apart:
                if near:
                    state[:], wrench[:], meets[:] = 0.0, 0.0, False
                    near = False
                if mounted:
                    swing_freely(mount, h, parts, wrench, q, qd, rate, last_rate, sub[k])
                if latch[1] < 1.5:  # latches may close on a probe that is not in contact
                    frames[0], motions[0] = poses[k], ends[k]
                    if mounted:
                        mount_place(q, rate, tilt, frames[1], motions[1])
                    latched = _caught(
                        frames,
                        motions,
                        latch,
                        last_row,
                        wrench,
                        hold,
                        local_pose,
                        local_twist,
                        work,
                    )
                    if latched and leapfrog:
                        _take_over(
                            index,
                            values,
                            least_creep,
                            p,
                            frames,
                            motions,
                            local_pose,
                            hold,
                            state,
                            depth,
                            closing,
                            point,
                            normal,
                            slip,
                            work,
                            wrench,
                        )
                continue
            near = True
        twist = twists[k]
        passed = 0.0
        for s in range(m):
            if k == 0 and parts[s] < 1.0:  # forces start from zero at t = 0
                passed = parts[s]
                continue
            if s > 0 and (parts[s] == parts[s - 1] or not (between or remembers)):
                sub[k, s] = sub[k, s - 1]
                continue
            dt = h * (parts[s] - passed)
            passed = parts[s]
            if parts[s] == 1.0 and plain and not latched:
                frames[0], motions[0] = poses[k], ends[k]
                point[:], slip[:] = points[r, k], slips[r, k]
                if moved != 0.0:
                    move_lever(moved, depths[r, k], normals[r, k], ends[k], point, slip)
                surface_wrench(
                    index,
                    dt,
                    least_creep,
                    p,
                    frames,
                    state,
                    depths[r, k],
                    rates[r, k],
                    point,
                    normals[r, k],
                    slip,
                    work[7],
                    sub[k, s],
                )
                wrench[:] = sub[k, s]
                continue
            split = 1
            if leapfrog and not latched and k > 0:
                split = pieces(mount, dt, least_creep, wrench, meets, slip, slipped, last_rate, p)
            dt /= split
            for piece in range(split):
                at = parts[s] - (split - 1 - piece) * dt / h
                if at < 1.0:
                    _within(
                        last,
                        twist,
                        ends[k - 1] if bent and k > 0 else ends[k],
                        ends[k],
                        h,
                        at,
                        turn,
                        frames[0],
                        motions[0],
                    )
                else:
                    frames[0], motions[0] = poses[k], ends[k]
                    # where the twist jumps: this force is of either tick
                    if leapfrog and not bent and k + 1 < poses.shape[0]:
                        for j in range(6):
                            motions[0, j] += 0.5 * (ends[k + 1, j] - ends[k, j])
                if mounted and k > 0:  # at t = 0 the mount is at rest and unloaded
                    advance(mount, dt, wrench, q, qd, rate, last_rate)
                    mount_place(q, rate, tilt, frames[1], motions[1])
                if (mounted or (sharp and at == 1.0)) and not latched:
                    if mounted:
                        earlier[:], slipped[:] = wrench, slip
                        meet_next(
                            index,
                            values,
                            p,
                            frames,
                            motions,
                            seen,
                            apart_by,
                            longest,
                            work,
                            depth,
                            closing,
                            point,
                            normal,
                            slip,
                        )
                    else:
                        meet_near(
                            index,
                            values,
                            p,
                            frames,
                            motions,
                            depths[r, k],
                            lean,
                            work,
                            depth,
                            closing,
                            point,
                            normal,
                            slip,
                        )
                    wrench[:] = 0.0
                    surface_wrench(
                        index,
                        dt,
                        least_creep,
                        p,
                        frames,
                        state,
                        depth,
                        closing,
                        point,
                        normal,
                        slip,
                        work[7],
                        wrench,
                    )
                    if leapfrog:
                        part = touched(depth, closing, p, dt, meets, slip, slipped)
                        if part >= 0.0 and k > 0:
                            touches += 1
                            part += STEP_SIGMA * split if touches == hastened else 0.0
                            struck(mount, dt, part, wrench, earlier, q, qd, rate)
                else:
                    contact_wrench(
                        index,
                        values,
                        dt,
                        least_creep,
                        p,
                        frames,
                        motions,
                        latched,
                        hold,
                        state,
                        depth,
                        closing,
                        point,
                        normal,
                        slip,
                        work,
                        wrench,
                    )
            if mounted:
                mount_reading(stiffness, damping, q, rate, sub[k, s])
            else:
                sub[k, s] = wrench
        if not latched and latch[1] < 1.5:
            motions[0] = ends[k]
            latched = _caught(
                frames, motions, latch, last_row, wrench, hold, local_pose, local_twist, work
            )
            if latched and leapfrog:
                _take_over(
                    index,
                    values,
                    least_creep,
                    p,
                    frames,
                    motions,
                    local_pose,
                    hold,
                    state,
                    depth,
                    closing,
                    point,
                    normal,
                    slip,
                    work,
                    wrench,
                )


@njit(cache=True)
def _take_over(
    index,
    values,
    least_creep,
    p,
    frames,
    motions,
    caught,
    hold,
    state,
    depth,
    closing,
    point,
    normal,
    slip,
    work,
    wrench,
):
    """Let a latch hold the pose ``caught`` (7,) from now on. A leapfrog's ``wrench`` (6,), which
    acts over half a step before and after, is the mean of those of the contacts and of the latch,
    both with the twist of the tick that ends; the latch carries the contacts' force.
    """
    before = np.zeros(6)
    contact_wrench(
        index,
        values,
        0.0,
        least_creep,
        p,
        frames,
        motions,
        False,
        hold,
        state,
        depth,
        closing,
        point,
        normal,
        slip,
        work,
        before,
    )
    held_at(caught, before, frames[1], p[-1], hold)
    contact_wrench(
        index,
        values,
        0.0,
        least_creep,
        p,
        frames,
        motions,
        True,
        hold,
        state,
        depth,
        closing,
        point,
        normal,
        slip,
        work,
        wrench,
    )
    for j in range(6):
        wrench[j] = 0.5 * (wrench[j] + before[j])


@njit(cache=True)
def _caught(frames, motions, latch, row, wrench, hold, pose, twist, work):
    """Whether the latch closes; if so, ``hold`` (7,) becomes the held pose at which its springs
    carry the contact's force.
    """
    relate_one(frames[0], motions[0], frames[1], motions[1], pose, twist, work[:5, :3])
    if not closes(pose, twist, latch):
        return False
    held_at(pose, wrench, frames[1], row, hold)
    return True


@njit(cache=True)
def _within(pose, slope, start, end, h, part, turn, out, rate):
    """Pose ``out`` (7,) and twist ``rate`` (6,) at a fraction ``part`` of a tick that starts at
    ``pose`` with twist ``start`` and ends with
    twist ``end``: a parabola about the uniform motion with the mean twist ``slope``. ``turn`` (7,)
        is scratch.
    """
    for j in range(6):
        bend = end[j] - start[j]
        way = h * part * (slope[j] + 0.5 * (part - 1.0) * bend)
        rate[j] = end[j] + (part - 1.0) * bend
        if j < 3:
            out[j] = pose[j] + way
        else:
            turn[j - 3] = way
    quat_exp(turn[0:3], turn[3:7])
    quat_mul(turn[3:7], pose[3:7], out[3:7])
