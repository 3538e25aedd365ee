"""The numerical model of this rig: two free bodies, semi-implicit Euler, with vectors in the world
frame.

State of a body, (19,): position of the centre of mass (world), quaternion, velocity (world),
angular velocity (body axes), displacement and relative velocity of its appendage (world).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hiltestbed.compiled.jit import njit
from tests.equipment.independent_rig.rotation import (
    cross,
    from_attitude,
    inverse,
    matrix,
    product,
    times,
    turn,
)

CHASER, TARGET = 0, 1
R, Q, V = slice(0, 3), slice(3, 7), slice(7, 10)
W, AQ, AV = slice(10, 13), slice(13, 16), slice(16, 19)


class Bodies(NamedTuple):
    """The parameters of both bodies, chaser and target along the first axis. SI, body axes."""

    mass: np.ndarray  # (2,)
    inertia: np.ndarray  # (2, 3, 3)
    compliance: np.ndarray  # (2, 3, 3), its inverse
    port_position: np.ndarray  # (2, 3)
    port_attitude: np.ndarray  # (2, 4)
    explicit: bool = False  # explicit Euler: pose with the old twist
    late: int = 0  # rows by which pose_cmd lags
    appendage_body: int = -1
    appendage_ratio: float = 0.0
    appendage_w: float = 0.0  # rad/s
    appendage_zeta: float = 0.0
    drag: float = 0.0  # N s/m, foreign: on the chaser's velocity
    thrust: float = 0.0  # N, foreign: on the chaser along z
    tether: float = 0.0  # N/m, foreign: pulls the chaser back to its start
    mass_rate: float = 0.0  # 1/s, foreign: relative rate of change of the chaser's mass
    # weight of the old twist in the new pose: 0 semi-implicit, 1 explicit Euler
    old_part: float = 0.0


@njit(cache=True)
def _accelerate(bodies, state, force, torque, b, h, t, origin):
    """The twist of body `b` after a tick under a force and a torque about its centre (world)."""
    mass = bodies.mass[b]
    if b == CHASER:
        mass = mass * (1.0 + bodies.mass_rate * t)
        force = force - bodies.drag * state[b, V] - bodies.tether * (state[b, R] - origin)
        force[2] += bodies.thrust
    if b == bodies.appendage_body:
        ratio, w, zeta = bodies.appendage_ratio, bodies.appendage_w, bodies.appendage_zeta
        pull = w * w * state[b, AQ] + 2.0 * zeta * w * state[b, AV]
        a = (force / mass + ratio * pull) / (1.0 - ratio)
        state[b, AV] += h * (-pull - a)
    else:
        a = force / mass
    state[b, V] += h * a
    momentum = times(bodies.inertia[b], state[b, W])
    inside = times(matrix(inverse(state[b, Q])), torque)
    state[b, W] += h * times(bodies.compliance[b], inside - cross(state[b, W], momentum))


@njit(cache=True)
def step(bodies, state, wrench, h, t, origin):
    """Advance `state` (2, 19) by one tick with the wrench (6,) of active on passive side, in P at
    P's origin.
    """
    turned = matrix(state[TARGET, Q])
    place = state[TARGET, R] + times(turned, bodies.port_position[TARGET])
    into_world = matrix(product(state[TARGET, Q], bodies.port_attitude[TARGET]))
    force, torque = times(into_world, wrench[:3]), times(into_world, wrench[3:])
    old = state.copy()
    new = state.copy()
    arm_t, arm_c = place - old[TARGET, R], place - old[CHASER, R]
    _accelerate(bodies, new, force, torque + cross(arm_t, force), TARGET, h, t, origin)
    _accelerate(bodies, new, -force, -torque - cross(arm_c, force), CHASER, h, t, origin)
    state[:, V], state[:, W], state[:, AV] = new[:, V], new[:, W], new[:, AV]
    if bodies.old_part > 0.0 and not bodies.explicit:
        for b in range(2):
            new[b, 7:] += bodies.old_part * (old[b, 7:] - new[b, 7:])
    twist = old if bodies.explicit else new
    for b in range(2):
        state[b, R] += h * twist[b, V]
        state[b, AQ] += h * twist[b, AV]
        q = product(state[b, Q], turn(h * twist[b, W]))
        state[b, Q] = q / np.sqrt(np.sum(q * q))


@njit(cache=True)
def relative_pose(bodies, state):
    """Pose (7,) of A in P."""
    place = state[TARGET, R] + times(matrix(state[TARGET, Q]), bodies.port_position[TARGET])
    q_p = product(state[TARGET, Q], bodies.port_attitude[TARGET])
    active = state[CHASER, R] + times(matrix(state[CHASER, Q]), bodies.port_position[CHASER])
    q = product(inverse(q_p), product(state[CHASER, Q], bodies.port_attitude[CHASER]))
    pose = np.empty(7)
    pose[:3] = times(matrix(inverse(q_p)), active - place)
    pose[3:] = q if q[3] >= 0.0 else -q
    return pose


def start(bodies: Bodies, approach: dict) -> tuple[np.ndarray, np.ndarray]:
    """State (2, 19) and relative pose (7,) at t = 0, as `approach` says; the target is at rest."""
    position = np.array([*approach["offset"], -approach["gap"]], dtype=float)
    attitude = from_attitude(approach["attitude_deg"])
    rate = np.radians(np.array(approach["rate_deg"], dtype=float))
    state = np.zeros((2, 19))
    state[:, 6] = 1.0
    q_p = bodies.port_attitude[TARGET]
    into_world = matrix(q_p)
    active = bodies.port_position[TARGET] + into_world @ position
    q = product(product(q_p, attitude), inverse(bodies.port_attitude[CHASER]))
    arm = matrix(q) @ bodies.port_position[CHASER]
    omega = into_world @ rate
    state[CHASER, Q] = q
    state[CHASER, R] = active - arm
    velocity = into_world @ np.array(approach["velocity"], dtype=float)
    state[CHASER, V] = velocity - np.cross(omega, arm)
    state[CHASER, W] = matrix(q).T @ omega
    return state, np.concatenate([position, attitude])


def from_scenario(spacecraft: dict) -> Bodies:
    """The bodies of a scenario's `spacecraft`."""
    sides = [spacecraft["chaser"], spacecraft["target"]]
    inertia = np.empty((2, 3, 3))
    for body, side in zip(inertia, sides, strict=True):  # the diagonal, or xx, yy, zz, xy, xz, yz
        xx, yy, zz, xy, xz, yz = [*map(float, side["inertia"]), 0.0, 0.0, 0.0][:6]
        body[:] = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
    return Bodies(
        np.array([float(s["mass"]) for s in sides]),
        inertia,
        np.linalg.inv(inertia),
        np.array([s["port"]["position"] for s in sides], dtype=float),
        np.array([from_attitude(s["port"]["attitude_deg"]) for s in sides]),
    )
