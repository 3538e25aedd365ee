"""One run of this rig: the tick, from the reading to the next command, on a grid finer than the
tick.

Between two sub-steps the position is linear, over a tick the attitude has a constant rate; the
contact is evaluated at any instant from the poses of both sides then, so that no force is
interpolated across a touch. The latch closes at the end of a tick.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hiltestbed.compiled.jit import njit
from tests.equipment.independent_rig import bodies as model
from tests.equipment.independent_rig import compensation as method
from tests.equipment.independent_rig import contact as law_of
from tests.equipment.independent_rig import docking as meeting
from tests.equipment.independent_rig import mount as mounting
from tests.equipment.independent_rig import platform as drive
from tests.equipment.independent_rig import sensor as gauge
from tests.equipment.independent_rig.links import Noise, Records, Rig
from tests.equipment.independent_rig.rotation import (
    all_noisy,
    inverse,
    noisy,
    product,
    slope,
    turn,
    turn_of,
)

STOPPED = 5e4  # N, at which a facility stops its run: the records are NaN from then on
# s of the trail kept in addition to the delays, for the look-back of a stretched or skewed record
KEPT = 0.2


class Trail(NamedTuple):
    """History of the rig: the last sub-steps in a ring, and every tick."""

    place: np.ndarray  # (length, 3) of A in P
    states: np.ndarray  # (length, 2, STATES) of the law, tip and rod
    mounted: np.ndarray  # (length, 13) of S
    attitude: np.ndarray  # (ticks + 1, 4)
    slope: np.ndarray  # (ticks + 1, 6) twist over the tick that ends there
    hold: np.ndarray  # (7,) pose that the latch holds
    closed: np.ndarray  # (1,) the row at whose instant it closed
    seen: np.ndarray  # (2, 2) penetration and rate at the last sub-step


@njit(cache=True)
def pose_at(trail, t, h, timing, pose, twist):
    """Pose (7,) and twist (6,) of A at `t` >= 0, as used by the contact."""
    m, length = timing.substeps, len(trail.place)
    at = t / h * m
    j = int(math.floor(at + 1e-9))
    part = max(at - j, 0.0)
    ahead = j + 1 if part > 1e-9 else j
    tick = int(math.ceil(at / m - 1e-9))  # the tick that ends at or after t
    first, then = trail.place[j % length], trail.place[ahead % length]
    for i in range(3):
        pose[i] = first[i] + part * (then[i] - first[i])
    twist[:] = trail.slope[tick]
    if tick == 0:
        pose[3:] = trail.attitude[0]
        return
    pose[3:] = product(turn((t - (tick - 1) * h) * twist[3:6]), trail.attitude[tick - 1])
    if timing.rate > 0.0:
        first = max(ahead - max(m // 2, 1), 0)  # towards the slope of the half tick that ends there
        for i in range(3):
            moved = trail.place[ahead % length, i] - trail.place[first % length, i]
            finer = moved / (ahead - first) * m / h
            twist[i] += timing.rate * (finer - twist[i])


@njit(cache=True)
def wrench_at(sides, trail, t, h, timing, out, where):
    """The wrench (6,) on the sensor at `t`, zero before the start; `where` (3,) is the position of
    A then. ``sides``: law and docking.
    """
    docking = sides[1]
    out[:] = 0.0
    where[:] = trail.place[0]
    if t < 0.0:
        return
    pose, twist = np.empty(7), np.empty(6)
    pose_at(trail, t, h, timing, pose, twist)
    where[:] = pose[:3]
    m, length = timing.substeps, len(trail.place)
    j = int(math.floor(t / h * m + 1e-9))
    part = max(t / h * m - j, 0.0)
    ahead = (j + 1 if part > 1e-9 else j) % length
    j = j % length
    y = trail.mounted[j] + part * (trail.mounted[ahead] - trail.mounted[j])
    if docking.mount.there:
        y[3:7] /= math.sqrt(np.sum(y[3:7] ** 2))
        mounting.carried(docking.mount, y, out)
        return
    states = trail.states[j] + part * (trail.states[ahead] - trail.states[j])
    latched = t > trail.closed[0] * h * (1.0 + 1e-12) or docking.from_start
    seen = np.empty((2, 2))
    meeting.wrench_in_place(sides, pose, twist, y, latched, trail.hold, states, out, seen)


@njit(cache=True)
def _shake(sides, trail, latched, pose, twist, states, dt, scheme, y, out):
    """The mounted body over dt from y (13,) to `out`, with A at a pose (7,) with a twist (6,)."""
    law, docking = sides
    wrench, seen, a, b = np.empty(6), np.empty((2, 2)), np.empty(6), np.empty(6)
    at, half = np.empty(7), np.empty(13)
    hold = latched, trail.hold, states
    meeting.wrench_in_place(sides, pose, twist, y, *hold, wrench, seen)
    rub = (
        law.friction * math.sqrt(wrench[0] ** 2 + wrench[1] ** 2 + wrench[2] ** 2) / law_of.SLIDING
    )
    stiff = law.stiffness + law.stop_stiffness + law.branch_stiffness + docking.held.stiffness
    inner = mounting.inner_steps(docking.mount, stiff, law.damping, rub, dt)
    step = dt / inner
    out[:] = y
    for s in range(inner):
        if s > 0:
            _along(pose, twist, s * step, at)
            meeting.wrench_in_place(sides, at, twist, out, *hold, wrench, seen)
        mounting.derivative(docking.mount, out, wrench, a)
        if scheme == drive.SEMI_IMPLICIT:
            for i in range(6):
                b[i] = out[7 + i] + step * a[i]
            mounting.moved(out, b, a, step, out)
            continue
        mounting.moved(out, out[7:], a, 0.5 * step, half)
        _along(pose, twist, (s + 0.5) * step, at)
        meeting.wrench_in_place(sides, at, twist, half, *hold, wrench, seen)
        mounting.derivative(docking.mount, half, wrench, b)
        mounting.moved(out, half[7:], b, step, out)


@njit(cache=True)
def _along(pose, twist, time, out):
    for i in range(3):
        out[i] = pose[i] + time * twist[i]
    out[3:] = product(turn(time * twist[3:6]), pose[3:7])


@njit(cache=True)
def _settle(sides, trail, latched, k, h, timing, stateful, scheme):
    """The mounted body and the states of the law over the tick from t_k."""
    law, docking = sides
    m, length = timing.substeps, len(trail.place)
    dt = h / m
    pose, twist, wrench, seen = np.empty(7), np.empty(6), np.empty(6), np.empty((2, 2))
    for i in range(m):
        here, there = (k * m + i) % length, (k * m + i + 1) % length
        trail.mounted[there], trail.states[there] = trail.mounted[here], trail.states[here]
        if not docking.mount.there and not stateful:
            continue
        pose_at(trail, (k * m + i + 1) * dt, h, timing, pose, twist)
        y, states = trail.mounted[there], trail.states[there]
        if docking.mount.there:
            pace = twist.copy()  # the path's own twist, independent of the rate used by the contact
            from_pose = pose.copy()
            pace[:3] = (trail.place[there] - trail.place[here]) / dt
            _along(pose, pace, -dt, from_pose)
            before = trail.states[here], dt, scheme, trail.mounted[here]
            _shake(sides, trail, latched, from_pose, pace, *before, y)
        if not stateful:
            continue
        meeting.wrench_in_place(sides, pose, twist, y, latched, trail.hold, states, wrench, seen)
        for which in range(2):
            own = docking.held if latched else law
            x, rate = seen[which, 0], seen[which, 1]
            law_of.advance_along(own, trail.seen[which, 0], x, rate, states[which], dt)
        trail.seen[:] = seen


@njit(cache=True)
def _follow(platform, commands, aim, velocity, k, h, timing, trail, moving):
    """The platform from t_k to t_(k+1).

    commands: positions, and rotation vectors from the start. moving: states of the axes, and pushes
        at the last two ticks.
    """
    node, turned = commands
    axes, pushed = moving
    m, length = timing.substeps, len(trail.place)
    dt = h / m
    for i in range(1, m + 1):
        t0, t1 = k * h + (i - 1) * dt, k * h + i * dt
        u0 = drive.command_at(node, velocity[:3], t0 - platform.delay, h)
        u1 = drive.command_at(node, velocity[:3], t1 - platform.delay, h)
        j = (k * m + i) % length
        for a in range(3):
            trail.place[j, a] = drive.follow(platform, axes[a], u0[a], u1[a], dt, a)
        trail.place[j, 2] -= platform.give * (pushed[0] + i / m * (pushed[1] - pushed[0]))
    trail.attitude[k + 1] = aim
    if timing.move > 0.0:
        late = drive.command_at(turned, velocity[3:], (k + 1.0 - timing.move) * h, h)
        trail.attitude[k + 1] = product(turn(late), trail.attitude[0])
    first, last = trail.place[(k * m) % length], trail.place[((k + 1) * m) % length]
    trail.slope[k + 1, :3] = (last - first) / h
    trail.slope[k + 1, 3:] = turn_of(product(trail.attitude[k + 1], inverse(trail.attitude[k]))) / h


@njit(cache=True)
def _read_pose(trail, k, h, timing, velocity, out):
    """The encoder's pose (7,) at t_k."""
    back = timing.encoder * h
    if k == 0:
        out[:3] = trail.place[0] - back * velocity[:3]
        out[3:] = product(turn(-back * velocity[3:]), trail.attitude[0])
        return
    twist = np.empty(6)
    pose_at(trail, k * h - back, h, timing, out, twist)
    if back == 0.0:
        out[3:] = trail.attitude[k]


@njit(cache=True)
def _loop(links, begin, grid, noise, cuts, keep, trail, stateful):
    """The records of a run.

    Args:
        links: numerical model, platform, contact law, docking, sensor, compensator. begin: state of
            the bodies, pose (7,) and velocity (6,). grid: tick [s], ticks, and timing within one.
        cuts: poses (ticks, 7) that replace the platform's commands, and a wrench (ticks, 6) that
            drives the model; empty for none.
    """
    bodies, platform, law, docking, sensor, comp = links
    state, start, velocity = begin
    h, ticks, timing = grid
    cut_cmd, cut_comp = cuts
    sides = law, docking
    pose_cmd, pose_act = np.empty((ticks, 7)), np.empty((ticks, 7))
    used, logged = np.empty((ticks, 6)), np.empty((ticks, 6))
    comp_out, physical = np.empty((ticks, 6)), np.empty((ticks, 6))
    touching = np.zeros(ticks, dtype=np.bool_)
    node, turned = np.zeros((ticks + 1, 3)), np.zeros((ticks + 1, 3))
    node[0] = start[:3]
    axes, pushed = drive.initial(start[:3], velocity[:3]), np.zeros(2)
    chains = np.zeros((2, gauge.STATES, 6))
    model_pose = np.empty((ticks + 1, 7))
    model_pose[0] = start
    origin = state[model.CHASER, model.R].copy()
    raw, where, raw_log, where_log = np.empty(6), np.empty(3), np.empty(6), np.empty(3)
    driven, local, still = np.zeros(6), np.empty(6), 0
    felt, motion, felt_before = start.copy(), np.zeros(6), start.copy()
    length, m = len(trail.place), timing.substeps
    latched = docking.from_start
    for k in range(ticks):
        t = k * h
        _read_pose(trail, k, h, timing, velocity, pose_act[k])
        wrench_at(sides, trail, t, h, timing, physical[k], where)
        if not np.max(np.abs(physical[k, :3])) < STOPPED:
            for rows in (pose_cmd, pose_act, physical, used, logged, comp_out):
                rows[k:] = np.nan
            break
        here = (k * m) % length
        pose_at(trail, t, h, timing, felt, motion)
        hold = trail.mounted[here], latched, trail.hold, trail.states[here]
        meeting.wrench_in_place(sides, felt, motion, *hold, local, trail.seen)
        touching[k] = latched or trail.seen[0, 0] > 0.0 or trail.seen[1, 0] > 0.0
        pushed[0], pushed[1] = pushed[1], physical[k, 2]
        late = gauge.lateness(sensor, noise.delay[k], physical[k, 2])
        wrench_at(sides, trail, t - late, h, timing, raw, where)
        if gauge.logs_apart(sensor):
            then = min(gauge.stamped(sensor, t) - late, t)
            wrench_at(sides, trail, then, h, timing, raw_log, where_log)
        seen = raw, where, raw_log, where_log
        still = gauge.sense(sensor, noise, k, h, seen, chains, still, used, logged)
        noisy(pose_act[k], noise.pose[k], felt)
        slope(felt_before, felt, h, motion)
        if k == 0:
            motion[:] = velocity
        felt_before[:] = felt
        method.drive(comp, k, used[k], (felt, motion), h, keep, driven)
        comp_out[k] = driven
        model.step(bodies, state, cut_comp[k] if len(cut_comp) else driven, h, t, origin)
        model_pose[k + 1] = model.relative_pose(bodies, state)
        source = k + 1 - bodies.late
        pose_cmd[k] = model_pose[max(source, 0)]
        if source < 0:
            pose_cmd[k, :3] = start[:3] + velocity[:3] * (source * h)
            pose_cmd[k, 3:] = product(turn(velocity[3:] * (source * h)), start[3:])
        towards = cut_cmd[k] if len(cut_cmd) else pose_cmd[k]
        node[k + 1] = towards[:3]
        turned[k + 1] = turn_of(product(towards[3:7], inverse(start[3:])))
        moving = axes, pushed
        _follow(platform, (node, turned), towards[3:7], velocity, k, h, timing, trail, moving)
        _settle(sides, trail, latched, k, h, timing, stateful, platform.scheme)
        if docking.captures and not latched:
            there = ((k + 1) * m) % length
            y, states = trail.mounted[there], trail.states[there]
            pose_at(trail, (k + 1) * h, h, timing, felt, motion)
            latched = meeting.close(sides, felt, motion, y, states, trail.hold)
            if latched:
                trail.closed[0] = k + 1
                meeting.wrench_in_place(
                    sides, felt, motion, y, True, trail.hold, states, local, trail.seen
                )
                states[0, law_of.BRANCH] = states[0, law_of.AGE] = 0.0
                states[0, law_of.SLIDER] = trail.seen[0, 0]
    return pose_cmd, pose_act, logged, comp_out, used, physical, touching


def _trail(rig: Rig, start: np.ndarray, velocity: np.ndarray) -> Trail:
    """A trail that begins at the start pose (7,) with the twist (6,) of the approach."""
    sensor, m = rig.sensor, rig.timing.substeps
    longest = KEPT + sensor.delay + sensor.skew + 8.0 * sensor.jitter
    length = (math.ceil(longest * rig.rate) + 3) * m + 2
    trail = Trail(
        np.zeros((length, 3)),
        np.zeros((length, 2, law_of.STATES)),
        np.tile(mounting.RIGID, (length, 1)),
        np.zeros((rig.ticks + 1, 4)),
        np.zeros((rig.ticks + 1, 6)),
        np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
        np.array([rig.ticks + 1], dtype=np.int64),
        np.full((2, 2), -1.0),
    )
    trail.place[0], trail.attitude[0], trail.slope[0] = start[:3], start[3:], velocity
    return trail


def simulate(
    rig: Rig,
    noise: Noise,
    pose_cmd: np.ndarray | None = None,
    wrench_comp: np.ndarray | None = None,
) -> Records:
    """Run the rig.

    Args:
        pose_cmd: (ticks, 7) commands to the platform instead of the model's: opens the loop there.
        wrench_comp: (ticks, 6) drives the model instead of the compensated force: opens the loop
            there.
    """
    state, start = model.start(rig.bodies, rig.approach)
    velocity = np.array(
        [*rig.approach["velocity"], *np.radians(np.array(rig.approach["rate_deg"], dtype=float))],
        dtype=float,
    )
    h = 1.0 / rig.rate
    cuts = (
        np.empty((0, 7)) if pose_cmd is None else pose_cmd,
        np.empty((0, 6)) if wrench_comp is None else wrench_comp,
    )
    trail, keep = _trail(rig, start, velocity), method.memory(rig.compensator, h)
    links = rig.bodies, rig.platform, rig.contact, rig.docking, rig.sensor, rig.compensator
    begin, grid = (state, start, velocity), (h, rig.ticks, rig.timing)
    law = rig.contact
    stateful = any((law.branch_stiffness, law.mode_w, law.dry_stiffness, law.line, law.ageing))
    found = _loop(links, begin, grid, noise, cuts, keep, trail, stateful)
    captured = -1 if rig.docking.from_start else min(int(trail.closed[0]), rig.ticks)
    return Records(*found, captured=captured)._replace(pose_act=all_noisy(found[1], noise.pose))
