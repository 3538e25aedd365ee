"""A second copy of the numerical model, run by run in compiled code: stepped, or carried over many ticks at once.

:class:`hiltestbed.spacecraft.Spacecraft` computes the motion that is commanded. A prediction needs a copy that can be set back,
stepped under another wrench and carried ahead; these kernels do that for one run, with the same states and the same semi-implicit
step: ``q`` (2, 7) and ``v`` (2, 6), linear velocity in inertial axes and angular velocity in body axes.
"""

from __future__ import annotations

from numba import njit

from hiltestbed.frames import cross, quat_exp, quat_mul, quat_normalise, rotate, rotate_back
from hiltestbed.spacecraft import TARGET, load_bodies

SCRATCH = 12  # rows of 7 that the kernels of this module need


@njit(cache=True)
def step(q, v, port, mass, inertia, inverse, wrench, h, work):
    """One semi-implicit Euler step of both bodies under ``wrench`` (6,), active on passive, in P at P's origin."""
    load_bodies(q, port, wrench, work, work[6:8])
    for b in range(2):
        tau, spin, gyro = work[6 + b], work[8], work[9]
        for j in range(3):
            spin[j] = inertia[b, j, 0] * v[b, 3] + inertia[b, j, 1] * v[b, 4] + inertia[b, j, 2] * v[b, 5]
        cross(v[b, 3:6], spin, gyro)
        for j in range(3):
            gyro[j] = tau[3 + j] - gyro[j]
            v[b, j] += h * tau[j] / mass[b]
        for j in range(3):
            v[b, 3 + j] += h * (inverse[b, j, 0] * gyro[0] + inverse[b, j, 1] * gyro[1] + inverse[b, j, 2] * gyro[2])
        for j in range(3):
            q[b, j] += h * v[b, j]
            spin[j] = h * v[b, 3 + j]
        _turn(q[b, 3:7], spin, work[10], work[11])


@njit(cache=True)
def carry(q, v, port, mass, inverse, time, impulse, shift, work):
    """Both bodies ``time`` [s] later under a wrench of which only two integrals are needed, in P at P's origin, axes held fixed.

    Args:
        impulse: (6,) its integral, ``sum of h w_j``.
        shift: (6,) its second integral, ``sum of h^2 w_j`` times the ticks that are left after j, its own included.

    Rates are taken as constant but for the impulse: the gyroscopic torque over the time is left out.
    """
    load_bodies(q, port, impulse, work, work[6:8])
    load_bodies(q, port, shift, work, work[8:10])
    for b in range(2):
        gain, turn = work[0], work[1]
        for j in range(3):
            gain[j] = inverse[b, j, 0] * work[8 + b, 3] + inverse[b, j, 1] * work[8 + b, 4] + inverse[b, j, 2] * work[8 + b, 5]
        for j in range(3):
            q[b, j] += time * v[b, j] + work[8 + b, j] / mass[b]
            v[b, j] += work[6 + b, j] / mass[b]
            turn[j] = time * v[b, 3 + j] + gain[j]
        for j in range(3):
            v[b, 3 + j] += inverse[b, j, 0] * work[6 + b, 3] + inverse[b, j, 1] * work[6 + b, 4] + inverse[b, j, 2] * work[6 + b, 5]
        _turn(q[b, 3:7], turn, work[2], work[3])


@njit(cache=True, inline="always")
def _turn(attitude, turn, by, out):
    quat_exp(turn, by)
    quat_mul(attitude, by, out)
    quat_normalise(out)
    for j in range(4):
        attitude[j] = out[j]


@njit(cache=True)
def mobility(q, port, position, mass, inverse, work, out):
    """``out`` (6, 6): change of the twist of A relative to P, in P, for a unit impulse of a wrench at A's origin, in P, reversed.

    ``W = sum over the bodies of J^T M^-1 J`` with J from the velocity of A's origin: symmetric and positive definite. A wrench
    ``w`` that the active side exerts for a time h changes the relative twist by ``-h W w``. ``position`` (3,) of A in P.
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
            for j in range(3):
                gain[j] = inverse[b, j, 0] * moment[0] + inverse[b, j, 1] * moment[1] + inverse[b, j, 2] * moment[2]
            rotate(q[b, 3:7], gain, gain)
            rotate_back(attitude, gain, gain)
            cross(gain, r, moment)
            for j in range(3):
                out[j, i] += moment[j]
                out[3 + j, i] += gain[j]


@njit(cache=True)
def solve(matrix, x, factor):
    """``x`` (6,) overwritten by the solution of the positive definite ``matrix`` (6, 6); ``factor`` (6, 6) is scratch (Cholesky)."""
    for i in range(6):
        for j in range(i + 1):
            s = matrix[i, j]
            for k in range(j):
                s -= factor[i, k] * factor[j, k]
            factor[i, j] = s**0.5 if i == j else s / factor[j, j]
        s = x[i]
        for k in range(i):
            s -= factor[i, k] * x[k]
        x[i] = s / factor[i, i]
    for i in range(5, -1, -1):
        s = x[i]
        for k in range(i + 1, 6):
            s -= factor[k, i] * x[k]
        x[i] = s / factor[i, i]


@njit(cache=True, inline="always")
def wrench_at_A(wrench, position, out):
    """``out``: a wrench given at P's origin, taken at A's origin; ``position`` (3,) of A in P. ``out`` may be ``wrench``."""
    fx, fy, fz = wrench[0], wrench[1], wrench[2]
    x, y, z = position[0], position[1], position[2]
    out[3] = wrench[3] - (y * fz - z * fy)
    out[4] = wrench[4] - (z * fx - x * fz)
    out[5] = wrench[5] - (x * fy - y * fx)
    out[0], out[1], out[2] = fx, fy, fz


@njit(cache=True, inline="always")
def wrench_at_P(wrench, position, out):
    """The inverse of :func:`wrench_at_A`."""
    fx, fy, fz = wrench[0], wrench[1], wrench[2]
    x, y, z = position[0], position[1], position[2]
    out[3] = wrench[3] + (y * fz - z * fy)
    out[4] = wrench[4] + (z * fx - x * fz)
    out[5] = wrench[5] + (x * fy - y * fx)
    out[0], out[1], out[2] = fx, fy, fz
