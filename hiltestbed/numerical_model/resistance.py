"""A force that resists motion along an axis: viscous and dry friction that may differ by direction, the Stribeck effect, an offset.

The law, for the speed v along the axis, with s its sign and ``sgn(v) = tanh(v/SMOOTH)``::

    R(v) = offset + viscous_s v + (coulomb_s + rise exp(-(v/stribeck)^2)) sgn(v)

The step is implicit in the speed at its end, ``v' = v_free - g R(v')`` with ``g`` the speed change per newton in a tick, so that dry
friction brings a body to rest whatever its mass and does not chatter; only the Stribeck factor is evaluated at the speed before. All other
terms increase with v', so that there is one solution.
"""

from __future__ import annotations

import math

import numpy as np

from hiltestbed.jit import njit
from hiltestbed.numerical_model.kernels import CHASER, TARGET, WORK, mobility, relative_motion, wrench_at_A, wrench_at_P

BODY, AXIS, OFFSET, VISCOUS, VISCOUS_BACK, COULOMB, COULOMB_BACK, RISE, STRIBECK, RESISTANCE = range(10)  # columns, and their number
BETWEEN = 2  # value of BODY, besides CHASER and TARGET: the motion of A relative to P, equal and opposite on both bodies
SMOOTH = 2e-4  # [m/s]
ONE = 20.0  # argument above which tanh is 1 to the last bit
SETTLED = 1e-13  # [m/s] tolerance of the speed in Newton's method
STEPS = 60  # largest number of steps of Newton's method


@njit(cache=True)
def resisting(laws, f, v, free, gain):
    """The force [N] of law ``f`` of ``laws`` (F, RESISTANCE) over a tick.

    Args:
        v: speed [m/s] before the tick. free: speed at its end without this force. gain: speed reduction per newton [m/s per N].
    """
    drive = free - gain * laws[f, OFFSET]
    forward = drive >= 0.0
    level = laws[f, COULOMB] if forward else laws[f, COULOMB_BACK]
    if laws[f, RISE] != 0.0:
        level += laws[f, RISE] * math.exp(-((v / laws[f, STRIBECK]) ** 2))
    slope = laws[f, VISCOUS] if forward else laws[f, VISCOUS_BACK]
    left = abs(drive)
    u = max(0.0, (left - gain * level) / (1.0 + gain * slope))  # a lower bound; the function is concave, so Newton's steps only increase u
    part = 1.0
    if u < ONE * SMOOTH:
        for _ in range(STEPS):
            part = math.tanh(u / SMOOTH)
            over = u + gain * (slope * u + level * part) - left
            change = over / (1.0 + gain * (slope + level * (1.0 - part * part) / SMOOTH))
            u -= change
            if abs(change) < SETTLED:
                break
        part = math.tanh(u / SMOOTH)
    force = slope * u + level * part
    return laws[f, OFFSET] + (force if forward else -force)


@njit(cache=True)
def resist_between(laws, q, v, port, mass, inverse, h, wrench):
    """Add to ``wrench`` (n, 6), active on passive, in P at P's origin, the forces at A's origin that resist the motion of A relative to P.

    Args:
        laws: (n, F, RESISTANCE). mass: (n, 2). inverse: (n, 2, 3, 3) of the inertia. h: tick [s].
    """
    work, gains, pose, twist, at_A = np.empty((WORK, 7)), np.empty((6, 6)), np.empty(7), np.empty(6), np.empty(6)
    for i in range(q.shape[0]):
        known = False
        for f in range(laws.shape[1]):
            law = laws[i, f]
            if law[BODY] != BETWEEN:
                continue
            if not known:
                relative_motion(q[i], v[i], port[i], work, pose, twist)
                mobility(q[i], port[i], pose[0:3], mass[i], inverse[i], work, gains)
                wrench_at_A(wrench[i], pose[0:3], at_A)
                known = True
            axis = int(law[AXIS])
            free = twist[axis]
            for j in range(6):
                free -= h * gains[axis, j] * at_A[j]
            at_A[axis] += resisting(laws[i], f, twist[axis], free, h * gains[axis, axis])
        if known:
            wrench_at_P(at_A, pose[0:3], wrench[i])


@njit(cache=True)
def resist_bodies(laws, v, mass, h, tau):
    """Add to the forces ``tau`` (n, 2, 6), in inertial axes, those that resist the motion of one body along an inertial axis."""
    for i in range(v.shape[0]):
        for f in range(laws.shape[1]):
            law = laws[i, f]
            if law[BODY] != CHASER and law[BODY] != TARGET:
                continue
            b, axis = int(law[BODY]), int(law[AXIS])
            gain = h / mass[i, b]
            tau[i, b, axis] -= resisting(laws[i], f, v[i, b, axis], v[i, b, axis] + gain * tau[i, b, axis], gain)
