"""One run of this rig on a plane: the tick, from the reading to the next command, on a grid finer
than the tick.
"""

from __future__ import annotations

import numpy as np

from hiltestbed.compiled.jit import njit
from tests.equipment.independent_rig import bodies as model
from tests.equipment.independent_rig import compensation as method
from tests.equipment.independent_rig import contact as touch
from tests.equipment.independent_rig import platform as drive
from tests.equipment.independent_rig import sensor as gauge
from tests.equipment.independent_rig import six_axes
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


@njit(cache=True)
def _physical(law, place, states, approach, t, h, timing, out, where):
    """The physical wrench at `t`, zero before the start: from the exact position, the rate of its
    tick, and interpolated states.

    out: (6,) [N, N m]. where: (3,) position of the tip then. approach: (3,) [m/s], the rate at t =
        0.
    """
    for a in range(6):
        out[a] = 0.0
    for a in range(3):
        where[a] = place[0, a]
    if t < 0.0:
        return
    substeps = timing.substeps
    at = t / h * substeps
    j = int(np.floor(at + 1e-9))
    part = max(at - j, 0.0)
    tick = int(np.ceil(at / substeps - 1e-9))  # the tick that ends at or after t
    velocity = approach.copy()
    if tick > 0:
        for a in range(3):
            velocity[a] = (place[tick * substeps, a] - place[(tick - 1) * substeps, a]) / h
        if timing.rate > 0.0:
            _sharpen(place, j + 1 if part > 1e-9 else j, timing, h, velocity)
    state = states[j].copy()
    ahead = j + 1 if part > 1e-9 else j
    for a in range(3):
        where[a] = place[j, a] + part * (place[ahead, a] - place[j, a])
    for a in range(touch.STATES):
        state[a] += part * (states[ahead, a] - states[j, a])
    touch.wrench(law, where, velocity, state, out)


@njit(cache=True)
def _sharpen(place, last, timing, h, velocity):
    """Blend the slope of a tick, `velocity` (3,), with that of the half tick that ends at sub-step
    `last`.
    """
    first = max(last - max(timing.substeps // 2, 1), 0)
    for a in range(3):
        finer = (place[last, a] - place[first, a]) / (last - first) * timing.substeps / h
        velocity[a] += timing.rate * (finer - velocity[a])


@njit(cache=True)
def _advance(platform, path, node, k, h, timing, axes, pushed):
    """Advance platform and contact from t_k to t_(k+1)."""
    law, place, states, velocity = path
    substeps = timing.substeps
    dt = h / substeps
    for i in range(1, substeps + 1):
        j = k * substeps + i
        t0, t1 = k * h + (i - 1) * dt, k * h + i * dt
        u0 = drive.command_at(node, velocity, t0 - platform.delay, h)
        u1 = drive.command_at(node, velocity, t1 - platform.delay, h)
        for a in range(3):
            place[j, a] = drive.follow(platform, axes[a], u0[a], u1[a], dt, a)
        place[j, 2] -= platform.give * (pushed[0] + i / substeps * (pushed[1] - pushed[0]))
    rate = (place[(k + 1) * substeps] - place[k * substeps]) / h
    for i in range(substeps):
        j = k * substeps + i
        states[j + 1] = states[j]
        if timing.rate > 0.0:
            rate = (place[(k + 1) * substeps] - place[k * substeps]) / h
            _sharpen(place, j + 1, timing, h, rate)
        touch.advance(law, place[j], place[j + 1], rate, states[j + 1], dt)


@njit(cache=True)
def _loop(links, begin, grid, noise, imposed, keep):
    """The records of a run.

    Args:
        links: numerical model, platform, contact, sensor, compensator. begin: state of the bodies,
            pose and velocity. grid: tick [s], ticks, and timing within one.
        imposed: poses (ticks, 7) that replace the platform's commands, and a wrench (ticks, 6) that
            drives the model; empty for none.
    """
    bodies, platform, law, sensor, comp = links
    state, start, velocity = begin
    h, ticks, timing = grid
    imposed_cmd, imposed_comp = imposed
    pose_cmd, pose_act = np.empty((ticks, 7)), np.empty((ticks, 7))
    used, logged = np.empty((ticks, 6)), np.empty((ticks, 6))
    comp_out, physical = np.empty((ticks, 6)), np.empty((ticks, 6))
    substeps = timing.substeps
    touching = np.zeros(ticks, dtype=np.bool_)
    node = np.zeros((ticks + 1, 3))
    node[0] = start[:3]
    place = np.empty((ticks * substeps + 1, 3))
    states = np.zeros((ticks * substeps + 1, touch.STATES))
    place[0] = start[:3]
    axes = drive.initial(start[:3], velocity)
    chains = np.zeros((2, gauge.STATES, 6))
    model_pose = np.empty((ticks + 1, 7))
    model_pose[0] = start
    attitude, attitude_before = start[3:].copy(), start[3:].copy()
    origin = state[model.CHASER, model.R].copy()
    raw, where, raw_log, where_log = np.empty(6), np.empty(3), np.empty(6), np.empty(3)
    driven, pushed, still = np.zeros(6), np.zeros(2), 0
    felt, motion, still_pose = start.copy(), np.zeros(6), start.copy()
    path = law, place, states, velocity
    for k in range(ticks):
        t = k * h
        pose_act[k, :3], pose_act[k, 3:] = place[k * substeps], attitude
        if timing.encoder > 0.0:
            _read_before(place, k, timing, velocity, h, pose_act[k])
        if timing.encoder + timing.move > 0.0:
            pose_act[k, 3:] = _between(
                attitude_before, attitude, 1.0 - min(timing.encoder + timing.move, 1.0)
            )
        _physical(*path, t, h, timing, physical[k], where)
        touching[k] = np.any(physical[k] != 0.0)
        pushed[0], pushed[1] = pushed[1], physical[k, 2]
        late = gauge.lateness(sensor, noise.delay[k], physical[k, 2])
        _physical(*path, t - late, h, timing, raw, where)
        if gauge.logs_apart(sensor):
            then = min(gauge.stamped(sensor, t) - late, t)
            _physical(*path, then, h, timing, raw_log, where_log)
        seen = raw, where, raw_log, where_log
        still = gauge.sense(sensor, noise, k, h, seen, chains, still, used, logged)
        noisy(pose_act[k], noise.pose[k], felt)
        slope(still_pose, felt, h, motion)
        if k == 0:
            motion[:3], motion[3:] = velocity, model.relative_twist(bodies, state)[3:]
        still_pose[:] = felt
        method.drive(comp, k, used[k], (felt, motion), h, keep, driven)
        comp_out[k] = driven
        model.step(bodies, state, imposed_comp[k] if len(imposed_comp) else driven, h, t, origin)
        model_pose[k + 1] = model.relative_pose(bodies, state)
        source = k + 1 - bodies.late
        pose_cmd[k] = model_pose[max(source, 0)]
        if source < 0:
            pose_cmd[k, :3] = start[:3] + velocity * (source * h)
        towards = imposed_cmd[k] if len(imposed_cmd) else pose_cmd[k]
        node[k + 1] = towards[:3]
        attitude_before, attitude = attitude, towards[3:].copy()
        _advance(platform, path, node, k, h, timing, axes, pushed)
    return pose_cmd, pose_act, logged, comp_out, used, physical, touching


@njit(cache=True)
def _read_before(place, k, timing, velocity, h, out):
    """The position (3,) read a fraction of a tick before t_k."""
    at = (k - timing.encoder) * timing.substeps
    if at < 0.0:
        out[:3] = place[0] + velocity * (at / timing.substeps * h)
        return
    j = int(np.floor(at))
    out[:3] = place[j] + (at - j) * (place[min(j + 1, k * timing.substeps)] - place[j])


@njit(cache=True)
def _between(first, then, part):
    """Attitude (4,) at the fraction `part` between two attitudes."""
    return product(turn(part * turn_of(product(then, inverse(first)))), first)


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
    state, pose = model.start(rig.bodies, rig.approach)
    velocity = np.array(rig.approach["velocity"], dtype=float)
    h = 1.0 / rig.rate
    cut_cmd = np.empty((0, 7)) if pose_cmd is None else pose_cmd
    cut_comp = np.empty((0, 6)) if wrench_comp is None else wrench_comp
    keep = method.memory(rig.compensator, h)
    if rig.docking is not None:
        return six_axes.simulate(rig, noise, state, pose, cut_cmd, cut_comp, keep)
    links = rig.bodies, rig.platform, rig.contact, rig.sensor, rig.compensator
    grid = h, rig.ticks, rig.timing
    found = _loop(links, (state, pose, velocity), grid, noise, (cut_cmd, cut_comp), keep)
    records = Records(*found, captured=-1 if rig.contact.latched else rig.ticks)
    return records._replace(pose_act=all_noisy(found[1], noise.pose))
