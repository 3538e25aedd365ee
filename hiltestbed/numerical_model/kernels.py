"""Two free-flyers in compiled code: poses, loads, relative motion, steps.

The states of one run are ``q`` (2, 7), poses of the centres of mass of chaser and target in
inertial axes, and ``v`` (2, 6), linear velocity in inertial axes and angular velocity in body axes.
:class:`hiltestbed.numerical_model.model.NumericalModel` accelerates the bodies with Pinocchio; a
predictor needs a copy that can be reset, stepped under another wrench and propagated, for which
:func:`step` and :func:`carry` use the same semi-implicit step.
"""

from __future__ import annotations

import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.frames import (
    add_moment,
    cross,
    pose_between,
    quat_exp,
    quat_mul,
    quat_normalise,
    rotate,
    rotate_back,
)

CHASER, TARGET = 0, 1
WORK = 9  # scratch rows of 7 that the kernels of one run need
SCRATCH = WORK + 3  # scratch rows of 7 that :func:`step` needs


@njit(cache=True)
def place_at_start(approach, port, q, v):
    """``q``, ``v`` at t = 0 from ``approach`` (n, 13): target at rest, P at the origin."""
    r, w, u, inverse = np.empty(3), np.empty(3), np.empty(3), np.empty(4)
    for i in range(q.shape[0]):
        start = approach[i]
        # attitude of the body in P: port attitude in P times inverse port attitude in the body
        for b in range(2):
            at = port[i, b]
            for j in range(3):
                inverse[j] = -at[3 + j]
            inverse[3] = at[6]
            if b == CHASER:
                quat_mul(start[3:7], inverse, q[i, b, 3:7])
            else:
                for j in range(4):
                    q[i, b, 3 + j] = inverse[j]
            rotate(q[i, b, 3:7], at[0:3], r)
            for j in range(3):
                q[i, b, j] = -r[j] + (start[j] if b == CHASER else 0.0)
            for j in range(6):
                v[i, b, j] = 0.0
        # velocity of the centre of mass: that of the port less w x r
        rotate(q[i, CHASER, 3:7], port[i, CHASER, 0:3], r)
        for j in range(3):
            w[j] = start[10 + j]
        cross(w, r, u)
        for j in range(3):
            v[i, CHASER, j] = start[7 + j] - u[j]
        rotate_back(q[i, CHASER, 3:7], w, v[i, CHASER, 3:6])


@njit(cache=True)
def _port_state(q, v, port, pose, arm, velocity, rate):
    """Pose of a port, its arm from the centre of mass, velocity and rate, in inertial axes."""
    rotate(q[3:7], port[0:3], arm)
    rotate(q[3:7], v[3:6], rate)
    cross(rate, arm, velocity)
    for j in range(3):
        pose[j] = q[j] + arm[j]
        velocity[j] += v[j]
    quat_mul(q[3:7], port[3:7], pose[3:7])


@njit(cache=True)
def relative_motion(q, v, port, work, pose, twist):
    """``pose`` (7,) of A in P and ``twist`` (6,) of one run; ``work`` (WORK, 7)."""
    pose_A, pose_P = work[0], work[1]
    arm, u_A, w_A, u_P, w_P, d, s = work[2], work[3], work[4], work[5], work[6], work[7], work[8]
    _port_state(q[CHASER], v[CHASER], port[CHASER], pose_A, arm, u_A, w_A)
    _port_state(q[TARGET], v[TARGET], port[TARGET], pose_P, arm, u_P, w_P)
    pose_between(pose_P, pose_A, pose)
    for j in range(3):
        d[j] = pose_A[j] - pose_P[j]
    cross(w_P, d, s)
    for j in range(3):
        u_A[j] -= u_P[j] + s[j]
        w_A[j] -= w_P[j]
    rotate_back(pose_P[3:7], u_A, twist[0:3])
    rotate_back(pose_P[3:7], w_A, twist[3:6])


@njit(cache=True)
def load_bodies(q, port, wrench, work, tau):
    """One run: generalised forces ``tau`` (2, 6), force in inertial axes and torque about the
    centre of mass in body axes, of ``wrench`` (6,), active on passive, in P at P's origin; ``work``
    (WORK, 7).
    """
    attitude, force, torque = work[0], work[1], work[2]
    arm, point, moment = work[3], work[4], work[5]
    quat_mul(q[TARGET, 3:7], port[TARGET, 3:7], attitude)
    rotate(attitude, wrench[0:3], force)
    rotate(attitude, wrench[3:6], torque)
    rotate(q[TARGET, 3:7], port[TARGET, 0:3], arm)
    for j in range(3):
        point[j] = q[TARGET, j] + arm[j]
    for b in range(2):
        sign = 1.0 if b == TARGET else -1.0
        for j in range(3):
            arm[j] = point[j] - q[b, j]
        cross(arm, force, moment)
        for j in range(3):
            tau[b, j] = sign * force[j]
            moment[j] = sign * (moment[j] + torque[j])
        rotate_back(q[b, 3:7], moment, tau[b, 3:6])


@njit(cache=True)
def relative_states(q, v, port, pose, twist):
    work = np.empty((WORK, 7))
    for i in range(q.shape[0]):
        relative_motion(q[i], v[i], port[i], work, pose[i], twist[i])


@njit(cache=True)
def load_wrench(q, port, wrench, tau):
    work = np.empty((WORK, 7))
    for i in range(q.shape[0]):
        load_bodies(q[i], port[i], wrench[i], work, tau[i])


@njit(cache=True)
def move(q, v, tick):
    """Move the poses ``q`` (n, 2, 7) with the velocities ``v`` (n, 2, 6) for a tick [s]."""
    turn, dq, before = np.empty(3), np.empty(4), np.empty(4)
    for i in range(q.shape[0]):
        for b in range(2):
            for j in range(3):
                q[i, b, j] += tick * v[i, b, j]
                turn[j] = tick * v[i, b, 3 + j]
            quat_exp(turn, dq)
            for j in range(4):
                before[j] = q[i, b, 3 + j]
            quat_mul(before, dq, q[i, b, 3:7])
            quat_normalise(q[i, b, 3:7])


@njit(cache=True)
def _times(matrix, x, out):
    """``out`` (3,): a ``matrix`` (3, 3) times ``x`` (3,)."""
    for j in range(3):
        out[j] = matrix[j, 0] * x[0] + matrix[j, 1] * x[1] + matrix[j, 2] * x[2]


@njit(cache=True)
def _accelerate(mass, inertia, inverse, tau, h, v, work):
    """Add the velocity change of one body to ``v`` (6,); ``work`` (2, >= 3): scratch."""
    spin, gyro = work[0, 0:3], work[1, 0:3]
    _times(inertia, v[3:6], spin)
    cross(v[3:6], spin, gyro)
    for j in range(3):
        gyro[j] = tau[3 + j] - gyro[j]
        v[j] += h * tau[j] / mass
    _times(inverse, gyro, spin)
    for j in range(3):
        v[3 + j] += h * spin[j]


@njit(cache=True)
def newton_euler(mass, inertia, inverse, tau, h, v):
    """Add to ``v`` the change under ``tau`` (n, 2, 6), force inertial, torque in body axes."""
    work = np.empty((2, 3))
    for i in range(v.shape[0]):
        for b in range(2):
            _accelerate(mass[i, b], inertia[i, b], inverse[i, b], tau[i, b], h, v[i, b], work)


@njit(cache=True)
def step(q, v, port, mass, inertia, inverse, wrench, h, work):
    """One semi-implicit Euler step under ``wrench`` (6,), active on passive, in P at P's origin."""
    load_bodies(q, port, wrench, work, work[6:8])
    for b in range(2):
        turn = work[8]
        _accelerate(mass[b], inertia[b], inverse[b], work[6 + b], h, v[b], work[8:10])
        for j in range(3):
            q[b, j] += h * v[b, j]
            turn[j] = h * v[b, 3 + j]
        _turn(q[b, 3:7], turn, work[10], work[11])


@njit(cache=True)
def carry(q, v, port, mass, inverse, time, impulse, shift, work):
    """Propagate both bodies by ``time`` [s] under a wrench given by two integrals, in P at P's
    origin, with axes held fixed.

    Args:
        impulse: (6,) its integral, ``sum of h w_j``.
        shift: (6,) its second integral, ``sum of h^2 w_j`` times the number of ticks from j to the
            end, j included.

    Angular rates change only by the impulse: the gyroscopic torque is neglected.
    """
    load_bodies(q, port, impulse, work, work[6:8])
    load_bodies(q, port, shift, work, work[8:10])
    for b in range(2):
        gain, turn = work[0], work[1]
        _times(inverse[b], work[8 + b, 3:6], gain)
        for j in range(3):
            q[b, j] += time * v[b, j] + work[8 + b, j] / mass[b]
            v[b, j] += work[6 + b, j] / mass[b]
            turn[j] = time * v[b, 3 + j] + gain[j]
        _times(inverse[b], work[6 + b, 3:6], gain)
        for j in range(3):
            v[b, 3 + j] += gain[j]
        _turn(q[b, 3:7], turn, work[2], work[3])


@njit(cache=True)
def _turn(attitude, turn, by, out):
    quat_exp(turn, by)
    quat_mul(attitude, by, out)
    quat_normalise(out)
    for j in range(4):
        attitude[j] = out[j]


@njit(cache=True)
def mobility(q, port, position, mass, inverse, work, out):
    """``out`` (6, 6): change of the twist of A relative to P, in P, per unit impulse of a reversed
    wrench at A's origin, in P.

    ``W = sum over the bodies of J^T M^-1 J`` with J from the velocity of A's origin: symmetric and
    positive definite. A wrench ``w`` that the active side exerts for a time h changes the relative
    twist by ``-h W w``. ``position`` (3,) of A in P.
    """
    attitude, arm, axis, r, gain, moment = work[0], work[1], work[2], work[3], work[4], work[5]
    quat_mul(q[TARGET, 3:7], port[TARGET, 3:7], attitude)
    rotate(q[TARGET, 3:7], port[TARGET, 0:3], arm)
    rotate(attitude, position, axis)
    for j in range(3):
        arm[j] += axis[j] + q[TARGET, j]  # A's origin in inertial axes
    for i in range(6):
        for j in range(6):
            out[i, j] = 1.0 / mass[0] + 1.0 / mass[1] if i == j and i < 3 else 0.0
    for b in range(2):
        for j in range(3):
            r[j] = arm[j] - q[b, j]
        rotate_back(attitude, r, r)
        for i in range(6):
            for j in range(3):
                axis[j] = 1.0 if j == i % 3 else 0.0
            if i < 3:
                cross(r, axis, moment)
            else:
                for j in range(3):
                    moment[j] = axis[j]
            rotate(attitude, moment, moment)
            rotate_back(q[b, 3:7], moment, moment)
            _times(inverse[b], moment, gain)
            rotate(q[b, 3:7], gain, gain)
            rotate_back(attitude, gain, gain)
            cross(gain, r, moment)
            for j in range(3):
                out[j, i] += moment[j]
                out[3 + j, i] += gain[j]


@njit(cache=True)
def solve(matrix, x, factor):
    """``x`` (n,) becomes the solution for the right side that it is; ``matrix`` (n, n) positive
    definite, its lower half, or ``x`` is NaN; ``factor`` (n, n): becomes the lower Cholesky
    factor, may be ``matrix``.
    """
    n = x.shape[0]
    for i in range(n):
        for j in range(i + 1):
            s = matrix[i, j]
            for k in range(j):
                s -= factor[i, k] * factor[j, k]
            factor[i, j] = s / factor[j, j] if i != j else s**0.5 if s > 0.0 else np.nan
        s = x[i]
        for k in range(i):
            s -= factor[i, k] * x[k]
        x[i] = s / factor[i, i]
    for i in range(n - 1, -1, -1):
        s = x[i]
        for k in range(i + 1, n):
            s -= factor[k, i] * x[k]
        x[i] = s / factor[i, i]


@njit(cache=True)
def wrench_at_A(wrench, position, out):
    """``out``, may be ``wrench``: given at P's origin, referred to A's, at ``position`` in P."""
    for j in range(6):
        out[j] = wrench[j]
    add_moment(-1.0, position, out)


@njit(cache=True)
def wrench_at_P(wrench, position, out):
    """The inverse of :func:`wrench_at_A`."""
    for j in range(6):
        out[j] = wrench[j]
    add_moment(1.0, position, out)
