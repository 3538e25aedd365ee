"""The predictor: from the delayed model's state at t - tau, over the delay, to the end of the tick
to be commanded.

Kernels of :mod:`hiltestbed.compensation.resynchronised` for run ``i`` of the copy ``m``.
"""

from __future__ import annotations

import numpy as np

from hiltestbed.compensation.resynchronised import contact_estimate as ce
from hiltestbed.compensation.resynchronised.delayed_model import DELAYED, DONE, along
from hiltestbed.compiled.jit import copied, njit
from hiltestbed.frames import rotation_vector
from hiltestbed.numerical_model.kernels import (
    carry,
    mobility,
    relative_motion,
    wrench_at_A,
    wrench_at_P,
)


@njit(cache=True, inline="always")
def predict(i, m, work, at, matrix, pose, twist, predicted):
    """Predict to t_(k+1), and the wrench at t_k; ``at`` (7,): scratch."""
    h, fixed, bodies, state = m.tick, m.fixed, m.bodies, m.state
    line, law = state.line[i], state.law[i]
    ticks = state.tick[i, DONE] + 1 - state.tick[i, DELAYED]
    q, v = np.empty((2, 7)), np.empty((2, 6))
    sums = np.zeros((3, 6))  # force now, impulse, shift
    copied(state.q[i, 0], q)
    copied(state.v[i, 0], v)
    relative_motion(q, v, bodies.port[i], work, pose, twist)
    if ticks == 0:
        for c in range(6):
            predicted[c] = state.used[i, c]
        return
    for c in range(3):
        at[c] = pose[c]
    if not fixed:
        rotation_vector(pose[3:7], at[3:6])
    if law[ce.KNOWN] == 1.0:
        mobility(q, bodies.port[i], pose[0:3], bodies.mass[i], bodies.inverse[i], work, matrix)
        if law[ce.FRICTION] > 0.0:
            _slide(ticks, h, line, law, at[2], twist, matrix, state.creep[i], sums)
        else:
            s, u = along(fixed, line, at), along(fixed, line, twist)
            # only the magnitude of the force is stepped; its direction is constant
            gain, force, impulse, shift = 0.0, 0.0, 0.0, 0.0
            for a in range(6):
                for b in range(6):
                    slope = (1.0 if a == 2 else 0.0) if fixed else line[0, a]
                    gain += slope * matrix[a, b] * line[0, b]
            for _ in range(ticks):
                force = ce.size(law, s, u)
                u -= h * gain * force
                s += h * u
                impulse += h * force
                shift += h * impulse
            for c in range(6):
                sums[0, c] = force * line[0, c]
                sums[1, c] = impulse * line[0, c]
                sums[2, c] = shift * line[0, c]
    elif state.count[i, ce.ABOVE] > 0:  # until the contact is identified, hold the last force
        wrench_at_A(state.used[i], pose, sums[0])
        for c in range(6):
            sums[1, c] = h * ticks * sums[0, c]
            sums[2, c] = h * h * ticks * (ticks + 1) / 2 * sums[0, c]
    for c in range(3):
        wrench_at_P(sums[c], pose, sums[c])
    carry(
        q, v, bodies.port[i], bodies.mass[i], bodies.inverse[i], h * ticks, sums[1], sums[2], work
    )
    for c in range(6):
        predicted[c] = sums[0, c]
    relative_motion(q, v, bodies.port[i], work, pose, twist)


@njit(cache=True)
def _slide(ticks, h, line, law, s, twist, matrix, creep, sums):
    """Step normal force and friction at the contact point r = (-D4, D3, 0) from A's origin."""
    rx, ry = -line[0, 4], line[0, 3]
    gain = np.empty((3, 3))  # velocity of the contact point per unit impulse at it
    push = np.zeros(6)
    for b in range(3):
        push[:] = 0.0
        push[b] = 1.0
        push[3], push[4], push[5] = (ry, -rx, 0.0) if b == 2 else (0.0, 0.0, -ry if b == 0 else rx)
        for a in range(3):
            across = 0.0
            for c in range(6):
                row = matrix[a, c]
                if a == 2:
                    row += ry * matrix[3, c] - rx * matrix[4, c]
                else:
                    row += (-ry if a == 0 else rx) * matrix[5, c]
                across += row * push[c]
            gain[a, b] = across
    creep[0] = min(ce.CREEP, ce.CREEP_LIMIT / (h * max(gain[0, 0], gain[1, 1])))
    u = twist[2] + ry * twist[3] - rx * twist[4]
    sx, sy = ce.slip(line, twist)
    fx, fy, normal = 0.0, 0.0, 0.0
    ix, iy, iz, jx, jy, jz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for _ in range(ticks):
        normal = ce.size(law, s, u)
        fx, fy = ce.friction(law, normal, sx, sy, creep[0])
        sx -= h * (gain[0, 0] * fx + gain[0, 1] * fy + gain[0, 2] * normal)
        sy -= h * (gain[1, 0] * fx + gain[1, 1] * fy + gain[1, 2] * normal)
        u -= h * (gain[2, 0] * fx + gain[2, 1] * fy + gain[2, 2] * normal)
        s += h * u
        ix, iy, iz = ix + h * fx, iy + h * fy, iz + h * normal
        jx, jy, jz = jx + h * ix, jy + h * iy, jz + h * iz
    _at_point(fx, fy, normal, rx, ry, sums[0])
    _at_point(ix, iy, iz, rx, ry, sums[1])
    _at_point(jx, jy, jz, rx, ry, sums[2])


@njit(cache=True, inline="always")
def _at_point(fx, fy, fz, rx, ry, out):
    """A force at (rx, ry, 0) from A's origin as a wrench at A's origin."""
    out[0], out[1], out[2] = fx, fy, fz
    out[3], out[4], out[5] = ry * fz, -rx * fz, rx * fy - ry * fx
