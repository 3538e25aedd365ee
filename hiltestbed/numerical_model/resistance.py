"""A force that resists motion along an axis: viscous and dry friction that may differ by direction,
the Stribeck effect, an offset.

The law, for the speed v along the axis, with s its sign::

    R(v) = offset + viscous_s v + (coulomb_s + rise exp(-(v/stribeck)^2)) s

At rest, dry friction balances the other forces, up to its level. Over a tick, with the other forces
held constant, the motion is integrated
exactly: an exponential until the body stops, then rest or another exponential.
"""

from __future__ import annotations

import math

import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.numerical_model import kernels as nk
from hiltestbed.numerical_model.kernels import mobility, relative_motion, wrench_at_A, wrench_at_P

# columns, and their number
BODY, AXIS, OFFSET, VISCOUS, VISCOUS_BACK, COULOMB, COULOMB_BACK, RISE, STRIBECK, RESISTANCE = (
    range(10)
)
# value of BODY, besides CHASER and TARGET: the motion of A relative to P, equal and opposite on
# both bodies
BETWEEN = 1 + nk.TARGET


@njit(cache=True)
def resisting(laws, f, v, free, gain):
    """The mean force [N] of law ``f`` of ``laws`` (F, RESISTANCE) over a tick.

    Args:
        v: speed [m/s] before the tick. free: speed at its end without this force. gain: speed
            reduction per newton [m/s per N].
    """
    rise = 0.0
    if laws[f, RISE] != 0.0:
        rise = laws[f, RISE] * math.exp(-((v / laws[f, STRIBECK]) ** 2))
    drive = (free - v) / gain - laws[f, OFFSET]
    part = 1.0  # of the tick that is left
    if v != 0.0:
        forward = v > 0.0
        slope = laws[f, VISCOUS] if forward else laws[f, VISCOUS_BACK]
        level = laws[f, COULOMB] if forward else laws[f, COULOMB_BACK]
        net = drive - (level + rise if forward else -level - rise)
        end = v + _gained(v, net, slope, gain)
        if (end >= 0.0) == forward:
            return (free - end) / gain
        # until it stands
        part -= math.log1p(-slope * v / net) / (gain * slope) if slope > 0.0 else -v / (gain * net)
    forward = drive >= 0.0
    slope = laws[f, VISCOUS] if forward else laws[f, VISCOUS_BACK]
    level = laws[f, COULOMB] if forward else laws[f, COULOMB_BACK]
    over = max(0.0, abs(drive) - level - rise)
    end = _gained(0.0, over, slope, gain * part)
    return (free - (end if forward else -end)) / gain


@njit(cache=True)
def _gained(v, net, slope, gain):
    """[m/s] gained under ``net`` [N] against ``slope`` [N s/m], for ``gain`` [m/s per N]."""
    decay = gain * slope
    return (net - slope * v) * gain * (-math.expm1(-decay) / decay if decay > 0.0 else 1.0)


@njit(cache=True)
def resist_between(laws, q, v, port, mass, inverse, h, wrench):
    """Add to ``wrench`` (n, 6), active on passive, in P at P's origin, the forces at A's origin
    that resist the motion of A relative to P.

    Args:
        laws: (n, F, RESISTANCE). mass: (n, 2). inverse: (n, 2, 3, 3) of the inertia. h: tick [s].
    """
    work = np.empty((nk.WORK, 7))
    gains = np.empty((6, 6))
    pose = np.empty(7)
    twist = np.empty(6)
    at_A = np.empty(6)
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
    """Add to ``tau`` (n, 2, 6) the forces that resist one body's motion along an inertial axis."""
    for i in range(v.shape[0]):
        for f in range(laws.shape[1]):
            law = laws[i, f]
            if law[BODY] != nk.CHASER and law[BODY] != nk.TARGET:
                continue
            b, axis = int(law[BODY]), int(law[AXIS])
            gain = h / mass[i, b]
            tau[i, b, axis] -= resisting(
                laws[i], f, v[i, b, axis], v[i, b, axis] + gain * tau[i, b, axis], gain
            )
