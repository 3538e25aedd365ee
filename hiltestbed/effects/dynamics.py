"""What a numerical model may have wrong: mass, inertia, port, a part that hangs on a spring, late steps, the integrator.

`replay_dynamics` is the numerical model driven by a recorded wrench: semi-implicit Euler at the tick, each body's twist first, then
its pose with the new twist, with the kernels of :mod:`hiltestbed.spacecraft` for loads and relative motion.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from hiltestbed.effects.vocabulary import BODIES
from hiltestbed.frames import Array, quat_exp, quat_mul, quat_normalise
from hiltestbed.spacecraft import WORK, load_bodies, place_bodies, relative_motion

RATIO, STIFFNESS, DAMPING, APPENDAGE = 0, 1, 2, 3  # columns of an appendage: mass ratio, k/m_a [1/s^2], d/m_a [1/s]


@dataclass
class DynamicsEffects:
    """Parameters of one numerical model's effects.

    Attributes:
        mass, inertia: (2,) factors on chaser and target. port: (2, 3) offset of the port in body axes [m].
        appendage: (2, APPENDAGE) mass ratio, k/m_a [1/s^2], d/m_a [1/s]; ratio 0 for none.
        late: whole ticks. explicit: pose with the old twist.
    """

    mass: Array
    inertia: Array
    port: Array
    appendage: Array
    late: int = 0
    explicit: bool = False


def dynamics_effects(effects: Sequence[tuple[str, dict]]) -> DynamicsEffects:
    """The effects of the numerical model among `effects`."""
    out = DynamicsEffects(np.ones(2), np.ones(2), np.zeros((2, 3)), np.zeros((2, APPENDAGE)))
    for kind, given in effects:
        if not kind.startswith("dynamics."):
            continue
        body = BODIES.index(given["body"]) if "body" in given else 0
        match kind:
            case "dynamics.mass":
                out.mass[body] *= given["factor"]
            case "dynamics.inertia":
                out.inertia[body] *= given["factor"]
            case "dynamics.port_offset":
                out.port[body] += given["offset"]
            case "dynamics.appendage":
                w = 2.0 * math.pi * given["frequency"]
                out.appendage[body] = given["mass_ratio"], w * w, 2.0 * given["damping_ratio"] * w
            case "dynamics.step_delay":
                out.late += int(given["ticks"])
            case "dynamics.integrator":
                out.explicit = True
    return out


@njit(cache=True)
def appendage_force(ratio, mass, appendage, swing, out):
    """out: (3,) [N] what the appendage of a body of `mass` [kg] does to it; swing: (2, 3) its displacement and velocity relative to it."""
    for j in range(3):
        out[j] = ratio * mass * (appendage[STIFFNESS] * swing[0, j] + appendage[DAMPING] * swing[1, j])


@njit(cache=True)
def swing_on(appendage, acceleration, h, swing):
    """Advance an appendage by h on a body that accelerates by `acceleration` (3,) [m/s^2]: velocity first, then displacement."""
    for j in range(3):
        swing[1, j] -= h * (appendage[STIFFNESS] * swing[0, j] + appendage[DAMPING] * swing[1, j] + acceleration[j])
        swing[0, j] += h * swing[1, j]


@njit(cache=True)
def _solve(inertia, torque, out):
    a, b, c = inertia[0, 0], inertia[0, 1], inertia[0, 2]
    d, e, f = inertia[1, 1], inertia[1, 2], inertia[2, 2]
    m0, m1, m2 = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * m0 + b * m1 + c * m2
    out[0] = (m0 * torque[0] + m1 * torque[1] + m2 * torque[2]) / det
    out[1] = (m1 * torque[0] + (a * f - c * c) * torque[1] + (b * c - a * e) * torque[2]) / det
    out[2] = (m2 * torque[0] + (b * c - a * e) * torque[1] + (a * d - b * b) * torque[2]) / det


@njit(cache=True)
def replay_dynamics(wrench, approach, mass, inertia, port, h, appendage, explicit, pose):
    """The pose commanded by a numerical model on a recorded wrench.

    Args:
        wrench: (N, 6) that drove it over each tick. approach: (13,) pose and twist of A in P at t = 0.
        mass: (2,), inertia: (2, 3, 3), port: (2, 7) pose in the body, of chaser and target. h: tick [s].
        appendage: (2, APPENDAGE). explicit: pose with the old twist.
        pose: (N, 7) out; row k is commanded at t_k, for t_(k+1).
    """
    q, v, tau = np.zeros((2, 7)), np.zeros((2, 6)), np.zeros((2, 6))
    old, swing = np.zeros((2, 6)), np.zeros((2, 2, 3))
    work, twist = np.empty((WORK, 7)), np.empty(6)
    spin, turn, dq, moment, rate, acceleration, pull = (
        np.empty(3), np.empty(4), np.empty(4), np.empty(3), np.empty(3), np.empty(3), np.empty(3),
    )  # fmt: skip
    place_bodies(approach, port, q, v)
    for k in range(wrench.shape[0]):
        load_bodies(q, port, wrench[k], work, tau)
        for b in range(2):
            old[b] = v[b]
            rigid = mass[b] * (1.0 - appendage[b, RATIO])
            appendage_force(appendage[b, RATIO], mass[b], appendage[b], swing[b], pull)
            for j in range(3):
                acceleration[j] = (tau[b, j] + pull[j]) / rigid
                v[b, j] += h * acceleration[j]
            if appendage[b, RATIO] > 0.0:
                swing_on(appendage[b], acceleration, h, swing[b])
            for j in range(3):
                spin[j] = inertia[b, j, 0] * v[b, 3] + inertia[b, j, 1] * v[b, 4] + inertia[b, j, 2] * v[b, 5]
            moment[0] = tau[b, 3] - (v[b, 4] * spin[2] - v[b, 5] * spin[1])
            moment[1] = tau[b, 4] - (v[b, 5] * spin[0] - v[b, 3] * spin[2])
            moment[2] = tau[b, 5] - (v[b, 3] * spin[1] - v[b, 4] * spin[0])
            _solve(inertia[b], moment, rate)
            for j in range(3):
                v[b, 3 + j] += h * rate[j]
            moving = old[b] if explicit else v[b]
            for j in range(3):
                q[b, j] += h * moving[j]
                rate[j] = h * moving[3 + j]
            quat_exp(rate, dq)
            turn[:] = q[b, 3:7]
            quat_mul(turn, dq, q[b, 3:7])
            quat_normalise(q[b, 3:7])
        relative_motion(q, v, port, work, pose[k], twist)
