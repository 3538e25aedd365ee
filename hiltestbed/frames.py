"""All conventions of position, attitude and wrench, and all conversions between them.

Two port frames: ``A`` on the active mechanism (carried by the motion platform) and ``P`` on the
passive one (on the force sensor). Both have +z along the direction of insertion. A pose is ``(...,
7)``: position [m] and unit quaternion ``x, y, z, w``; a twist ``(..., 6)``: linear [m/s] and
angular [rad/s] velocity; a wrench ``(..., 6)``: force [N] and torque [N m]. MuJoCo writes
quaternions w-first: only :func:`quat_to_mujoco` and :func:`quat_from_mujoco` depend on this.

The scalar kernels work on one-dimensional slices and write into ``out``; they are compiled once and
called from the loops over the runs of a batch, so that a single run and a run in a batch use the
same arithmetic.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltestbed.compiled.jit import njit

Array = NDArray[np.float64]

TINY = 1e-300  # a quaternion after a numerical overflow may have length zero
# [rad] below it sin(a)/a is computed by its series, whose next term is a^4/120 < 1e-18
SMALL_ANGLE = 1e-4
# [rad] largest angle of the series of sine and cosine: its first term left out, of degree 13, is
# 2e-23
SERIES_ANGLE = 0.1
SERIES = tuple(1.0 / math.factorial(n) for n in range(13))


@njit(cache=True)
def sin_cos(angle):
    """Sine and cosine; by Taylor series, exact to rounding, up to :data:`SERIES_ANGLE`: faster."""
    if abs(angle) > SERIES_ANGLE:
        return math.sin(angle), math.cos(angle)
    s = angle * angle
    sine = angle - angle * s * (
        SERIES[3] - s * (SERIES[5] - s * (SERIES[7] - s * (SERIES[9] - s * SERIES[11])))
    )
    cosine = 1.0 - s * (
        SERIES[2]
        - s * (SERIES[4] - s * (SERIES[6] - s * (SERIES[8] - s * (SERIES[10] - s * SERIES[12]))))
    )
    return sine, cosine


@njit(cache=True)
def quat_mul(a, b, out):
    """``out = a * b`` (Hamilton product, x y z w); ``out`` may be neither ``a`` nor ``b``."""
    out[0] = a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1]
    out[1] = a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0]
    out[2] = a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3]
    out[3] = a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2]


@njit(cache=True)
def quat_conj_mul(a, b, out):
    """``out = conj(a) * b``: the attitude of ``b`` seen from ``a``."""
    out[0] = a[3] * b[0] - a[0] * b[3] - a[1] * b[2] + a[2] * b[1]
    out[1] = a[3] * b[1] + a[0] * b[2] - a[1] * b[3] - a[2] * b[0]
    out[2] = a[3] * b[2] - a[0] * b[1] + a[1] * b[0] - a[2] * b[3]
    out[3] = a[3] * b[3] + a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True)
def quat_mul_conj(a, b, out):
    """``out = a * conj(b)``: the rotation that takes ``b`` to ``a``; ``out`` may be neither."""
    out[0] = -a[3] * b[0] + a[0] * b[3] - a[1] * b[2] + a[2] * b[1]
    out[1] = -a[3] * b[1] + a[0] * b[2] + a[1] * b[3] - a[2] * b[0]
    out[2] = -a[3] * b[2] - a[0] * b[1] + a[1] * b[0] + a[2] * b[3]
    out[3] = a[3] * b[3] + a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True)
def rotate(q, v, out):
    """``out = R(q) v``; ``out`` may be ``v``."""
    x, y, z = v[0], v[1], v[2]
    tx = 2.0 * (q[1] * z - q[2] * y)
    ty = 2.0 * (q[2] * x - q[0] * z)
    tz = 2.0 * (q[0] * y - q[1] * x)
    out[0] = x + q[3] * tx + q[1] * tz - q[2] * ty
    out[1] = y + q[3] * ty + q[2] * tx - q[0] * tz
    out[2] = z + q[3] * tz + q[0] * ty - q[1] * tx


@njit(cache=True)
def rotate_back(q, v, out):
    """``out = R(q)^T v``; ``out`` may be ``v``."""
    x, y, z = v[0], v[1], v[2]
    tx = 2.0 * (q[2] * y - q[1] * z)
    ty = 2.0 * (q[0] * z - q[2] * x)
    tz = 2.0 * (q[1] * x - q[0] * y)
    out[0] = x + q[3] * tx - q[1] * tz + q[2] * ty
    out[1] = y + q[3] * ty - q[2] * tx + q[0] * tz
    out[2] = z + q[3] * tz - q[0] * ty + q[1] * tx


@njit(cache=True)
def cross(a, b, out):
    """``out = a x b``; ``out`` may be neither ``a`` nor ``b``."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@njit(cache=True)
def rotation_vector(q, out):
    """``out``: the rotation vector [rad] of ``q``, by at most pi."""
    s = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
    sign = 1.0 if q[3] >= 0.0 else -1.0
    scale = (
        2.0 * sign / max(abs(q[3]), s, TINY)
        if s < 1e-12
        else 2.0 * math.atan2(s, abs(q[3])) / s * sign
    )
    out[0] = scale * q[0]
    out[1] = scale * q[1]
    out[2] = scale * q[2]


@njit(cache=True)
def quat_exp(r, out):
    """``out``: the quaternion of the rotation vector ``r`` [rad]."""
    a2 = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
    a = math.sqrt(a2)
    scale = 0.5 - a2 / 48.0 if a < SMALL_ANGLE else math.sin(0.5 * a) / a
    out[0] = scale * r[0]
    out[1] = scale * r[1]
    out[2] = scale * r[2]
    out[3] = math.cos(0.5 * a)


@njit(cache=True)
def quat_normalise(q):
    """Scale ``q`` to unit length, in place."""
    s = 1.0 / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for i in range(4):
        q[i] *= s


@njit(cache=True)
def pose_between(pose_WP, pose_WA, out):
    """``out``: pose of A in P, from the poses of both in W."""
    out[0] = pose_WA[0] - pose_WP[0]
    out[1] = pose_WA[1] - pose_WP[1]
    out[2] = pose_WA[2] - pose_WP[2]
    rotate_back(pose_WP[3:7], out[0:3], out[0:3])
    quat_conj_mul(pose_WP[3:7], pose_WA[3:7], out[3:7])


@njit(cache=True)
def pose_compose(pose_WP, pose_PA, out):
    """``out``: pose of A in W, from that of P in W and of A in P; ``out`` may be neither."""
    rotate(pose_WP[3:7], pose_PA[0:3], out[0:3])
    for i in range(3):
        out[i] += pose_WP[i]
    quat_mul(pose_WP[3:7], pose_PA[3:7], out[3:7])


@njit(cache=True)
def wrench_moved(pose_PS, wrench_S, out):
    """``out``: ``wrench_S`` in S at S's origin, in P at P's origin; ``pose_PS``: of S in P."""
    rotate(pose_PS[3:7], wrench_S[0:3], out[0:3])
    rotate(pose_PS[3:7], wrench_S[3:6], out[3:6])
    add_moment(1.0, pose_PS, out)


@njit(cache=True)
def add_moment(sign, position, wrench):
    """Add to the torque of a ``wrench`` (6,) ``sign`` times the moment of its force at ``position``
    (3,): -1 moves the reference point to ``position``, 1 moves it back.
    """
    wrench[3] += sign * (position[1] * wrench[2] - position[2] * wrench[1])
    wrench[4] += sign * (position[2] * wrench[0] - position[0] * wrench[2])
    wrench[5] += sign * (position[0] * wrench[1] - position[1] * wrench[0])


@njit(cache=True)
def pose_step(pose, twist, h, out):
    """``out``: ``pose`` moved for ``h`` [s] by a constant twist, linear and angular separately."""
    r, q = np.empty(3), np.empty(4)
    for i in range(3):
        r[i] = twist[3 + i] * h
    quat_exp(r, q)
    quat_mul(q, pose[3:7], out[3:7])
    for i in range(3):
        out[i] = pose[i] + h * twist[i]


@njit(cache=True)
def twist_between(pose_0, pose_1, h, out):
    """``out``: the constant twist from ``pose_0`` to ``pose_1`` in ``h`` [s], as in pose_step."""
    q = np.empty(4)
    quat_mul_conj(pose_1[3:7], pose_0[3:7], q)
    rotation_vector(q, out[3:6])
    for i in range(3):
        out[i] = (pose_1[i] - pose_0[i]) / h
        out[3 + i] /= h


def quat_to_mujoco(q: Array) -> Array:
    """``(..., 4)`` x y z w to w x y z."""
    return np.concatenate([q[..., 3:4], q[..., :3]], axis=-1)


def quat_from_mujoco(q: Array) -> Array:
    """``(..., 4)`` w x y z to x y z w."""
    return np.concatenate([q[..., 1:4], q[..., 0:1]], axis=-1)


def quat_from_attitude_deg(attitude_deg: ArrayLike) -> Array:
    """Quaternion ``(..., 4)`` of rotations ``(..., 3)`` about fixed x, then y, then z [deg]."""
    half = 0.5 * np.radians(np.asarray(attitude_deg, dtype=float))
    sine, cosine = np.sin(half), np.cos(half)
    sx, sy, sz = sine[..., 0], sine[..., 1], sine[..., 2]
    cx, cy, cz = cosine[..., 0], cosine[..., 1], cosine[..., 2]
    out = np.empty((*half.shape[:-1], 4))
    out[..., 0] = sx * cy * cz - cx * sy * sz
    out[..., 1] = cx * sy * cz + sx * cy * sz
    out[..., 2] = cx * cy * sz - sx * sy * cz
    out[..., 3] = cx * cy * cz + sx * sy * sz
    return out


# |sin| of the middle angle, above which the first and the last rotation have the same axis
POLE = 1.0 - 1e-12


def attitude_deg_from_quat(q: Array) -> Array:
    """Rotations about the fixed x, then y, then z axis [deg] ``(3,)`` of the quaternion ``(4,)``;
    at y = +-90 deg x is 0.

    The inverse of :func:`quat_from_attitude_deg`.
    """
    x, y, z, w = map(float, q)
    sine = max(-1.0, min(1.0, 2.0 * (w * y - z * x)))
    if abs(sine) < POLE:
        about_z = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        about_x = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    else:
        about_z, about_x = -2.0 * math.copysign(1.0, sine) * math.atan2(x, w), 0.0
    return np.degrees(np.array([about_x, math.asin(sine), about_z]))


def rotation_matrix(q: Array) -> Array:
    """Rotation matrices ``(..., 3, 3)`` of quaternions ``(..., 4)``."""
    x, y, z, w = np.moveaxis(q, -1, 0)
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], axis=-1),
            np.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], axis=-1),
            np.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], axis=-1),
        ],
        axis=-2,
    )


def rotation_vectors(q: Array) -> Array:
    """Rotation vectors ``(..., 3)`` [rad] of quaternions ``(..., 4)``, by at most pi."""
    v, w = q[..., :3], q[..., 3:4]
    s = np.linalg.norm(v, axis=-1, keepdims=True)
    tiny = s < 1e-12
    angle = 2.0 * np.arctan2(s, np.abs(w))
    return np.where(tiny, 2.0, angle / np.where(tiny, 1.0, s)) * np.where(w < 0, -1.0, 1.0) * v
