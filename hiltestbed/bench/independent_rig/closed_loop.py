"""One run of this rig: the tick, from the reading to the next command, on a grid finer than the tick."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from hiltestbed.bench.independent_rig import bodies as model
from hiltestbed.bench.independent_rig import contact as touch
from hiltestbed.bench.independent_rig import platform as drive
from hiltestbed.bench.independent_rig import sensor as gauge
from hiltestbed.bench.independent_rig.bodies import Bodies
from hiltestbed.bench.independent_rig.contact import Contact
from hiltestbed.bench.independent_rig.platform import Platform
from hiltestbed.bench.independent_rig.sensor import Compensator, Sensor

SUBSTEPS = 20  # a tick


class Rig(NamedTuple):
    """The five links, with their departures in them, and how the run starts."""

    bodies: Bodies
    platform: Platform
    contact: Contact
    sensor: Sensor
    compensator: Compensator
    approach: dict
    rate: float
    ticks: int


class Noise(NamedTuple):
    """What is drawn for a run, (ticks, ...): of the reading [N, N m], of the pose [m, -], of the delay and of repeats [-]."""

    reading: np.ndarray  # (ticks, 6)
    pose: np.ndarray  # (ticks, 6)
    delay: np.ndarray  # (ticks,)
    repeat: np.ndarray  # (ticks,), uniform


class Records(NamedTuple):
    """What a run leaves: (ticks, 7) and (ticks, 6). `used` is the reading inside the loop, which the log may not hold."""

    pose_cmd: np.ndarray
    pose_act: np.ndarray
    wrench_meas: np.ndarray
    wrench_comp: np.ndarray
    used: np.ndarray
    physical: np.ndarray


@njit(cache=True)
def _physical(law, place, states, approach, t, h, substeps, out, where):
    """The physical wrench at `t`, nothing before the start: exact position, the rate of its tick, states in between.

    out: (6,) [N, N m]. where: (3,) the tip's place then. approach: (3,) [m/s], the rate at t = 0.
    """
    for a in range(6):
        out[a] = 0.0
    for a in range(3):
        where[a] = place[0, a]
    if t < 0.0:
        return
    at = t / h * substeps
    j = int(np.floor(at + 1e-9))
    part = max(at - j, 0.0)
    tick = int(np.ceil(at / substeps - 1e-9))  # the tick that ends at or after t
    velocity = approach.copy()
    if tick > 0:
        for a in range(3):
            velocity[a] = (place[tick * substeps, a] - place[(tick - 1) * substeps, a]) / h
    state = states[j].copy()
    ahead = j + 1 if part > 1e-9 else j
    for a in range(3):
        where[a] = place[j, a] + part * (place[ahead, a] - place[j, a])
    for a in range(touch.STATES):
        state[a] += part * (states[ahead, a] - states[j, a])
    touch.wrench(law, where, velocity, state, out)


@njit(cache=True)
def _advance(platform, law, node, velocity, k, h, substeps, axes, place, states, pushed):
    """Platform and contact from t_k to t_(k+1)."""
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
        touch.advance(law, place[j], place[j + 1], rate, states[j + 1], dt)


@njit(cache=True)
def _loop(bodies, platform, law, sensor, comp, state, start, velocity, h, ticks, noise, imposed_cmd, imposed_comp, substeps):
    """The records of a run. Imposed poses (ticks, 7) replace the model's towards the platform; an imposed wrench drives the model."""
    pose_cmd, pose_act = np.empty((ticks, 7)), np.empty((ticks, 7))
    used, logged, comp_out, physical = np.empty((ticks, 6)), np.empty((ticks, 6)), np.empty((ticks, 6)), np.empty((ticks, 6))
    node = np.zeros((ticks + 1, 3))
    node[0] = start[:3]
    place, states = np.empty((ticks * substeps + 1, 3)), np.zeros((ticks * substeps + 1, touch.STATES))
    place[0] = start[:3]
    axes = drive.initial(start[:3], velocity)
    chain, record, last = np.zeros((4, 6)), np.zeros((4, 6)), np.zeros((2, 6))
    model_pose = np.empty((ticks + 1, 7))
    model_pose[0] = start
    attitude = start[3:].copy()
    origin = state[model.CHASER, model.R].copy()
    raw, where, driven = np.empty(6), np.empty(3), np.zeros(6)
    pushed, still, zero = np.zeros(2), 0, np.zeros(6)
    for k in range(ticks):
        t = k * h
        pose_act[k, :3], pose_act[k, 3:] = place[k * substeps], attitude
        _physical(law, place, states, velocity, t, h, substeps, physical[k], where)
        pushed[0], pushed[1] = pushed[1], physical[k, 2]
        late = max(sensor.delay + sensor.jitter * noise.delay[k] + sensor.heavy * abs(physical[k, 2]), 0.0)
        _physical(law, place, states, velocity, t - late, h, substeps, raw, where)
        gauge.read(sensor, raw, where, noise.reading[k], t, h, chain, used[k])
        if sensor.repeat > 0.0:
            if still > 0:
                used[k], still = used[k - 1], still - 1
            elif k > 0 and noise.repeat[k] < 0.01:
                still = int(sensor.repeat / h)
        logged[k] = used[k]
        if sensor.skew > 0.0 or sensor.stretch != 0.0:
            stamp = t * (1.0 - sensor.stretch) - sensor.skew
            back = k - int((t - stamp) / h + 0.5)
            _physical(law, place, states, velocity, min(stamp - late, t), h, substeps, raw, where)
            gauge.read(sensor, raw, where, noise.reading[back] if 0 <= back < ticks else zero, stamp, h, record, logged[k])
        if sensor.freeze > 0.0 and k > 0 and (t % 0.1) < sensor.freeze:
            logged[k] = logged[k - 1]
        gauge.compensate(comp, used[k], h, last, driven)
        comp_out[k] = driven
        model.step(bodies, state, imposed_comp[k] if len(imposed_comp) else driven, h, t, origin)
        model_pose[k + 1] = model.relative_pose(bodies, state)
        source = k + 1 - bodies.late
        pose_cmd[k] = model_pose[max(source, 0)]
        if source < 0:
            pose_cmd[k, :3] = start[:3] + velocity * (source * h)
        towards = imposed_cmd[k] if len(imposed_cmd) else pose_cmd[k]
        node[k + 1] = towards[:3]
        attitude = towards[3:].copy()
        _advance(platform, law, node, velocity, k, h, substeps, axes, place, states, pushed)
    return pose_cmd, pose_act, logged, comp_out, used, physical


def simulate(rig: Rig, noise: Noise, pose_cmd: np.ndarray | None = None, wrench_comp: np.ndarray | None = None) -> Records:
    """Run the rig.

    Args:
        pose_cmd: (ticks, 7) commands to the platform in place of the model's: cuts the loop there.
        wrench_comp: (ticks, 6) what drives the model in place of the compensated force: cuts the loop there.
    """
    state, pose = model.start(rig.bodies, rig.approach)
    velocity = np.array(rig.approach["velocity"], dtype=float)
    h = 1.0 / rig.rate
    cut_cmd = np.empty((0, 7)) if pose_cmd is None else pose_cmd
    cut_comp = np.empty((0, 6)) if wrench_comp is None else wrench_comp
    found = _loop(
        rig.bodies, rig.platform, rig.contact, rig.sensor, rig.compensator, state, pose, velocity, h, rig.ticks, noise,
        cut_cmd, cut_comp, SUBSTEPS,
    )  # fmt: skip
    return Records(*found)._replace(pose_act=_noisy(found[1], noise.pose))


def silence(ticks: int) -> Noise:
    """No noise at all."""
    return Noise(np.zeros((ticks, 6)), np.zeros((ticks, 6)), np.zeros(ticks), np.ones(ticks))


def _noisy(pose: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Poses (n, 7) with noise (n, 6) on the position and on the quaternion's vector part."""
    out = pose.copy()
    out[:, :6] += noise
    out[:, 6] = np.sqrt(np.maximum(1.0 - np.sum(out[:, 3:6] ** 2, axis=1), 0.0))
    return out
