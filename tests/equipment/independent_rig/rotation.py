"""Rotations as quaternions x, y, z, w, and measured poses: an independent implementation, so that
an error in `frames` cannot be in both.
"""

from __future__ import annotations

import math

import numpy as np

from hiltestbed.compiled.jit import njit


@njit(cache=True)
def product(a, b):
    """The rotation `b` followed by `a`; (4,)."""
    out = np.empty(4)
    out[0] = a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1]
    out[1] = a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0]
    out[2] = a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3]
    out[3] = a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2]
    return out


@njit(cache=True)
def inverse(q):
    """The inverse rotation; (4,)."""
    out = np.empty(4)
    out[0], out[1], out[2], out[3] = -q[0], -q[1], -q[2], q[3]
    return out


@njit(cache=True)
def matrix(q):
    """Rotation matrix (3, 3) of the quaternion (4,)."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    out = np.empty((3, 3))
    out[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    out[0, 1], out[0, 2] = 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)
    out[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    out[1, 0], out[1, 2] = 2.0 * (x * y + z * w), 2.0 * (y * z - x * w)
    out[2, 2] = 1.0 - 2.0 * (x * x + y * y)
    out[2, 0], out[2, 1] = 2.0 * (x * z - y * w), 2.0 * (y * z + x * w)
    return out


@njit(cache=True)
def turn(vector):
    """Quaternion (4,) of a rotation vector (3,) [rad]."""
    angle = math.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    s = 0.5 - angle * angle / 48.0 if angle < 1e-4 else math.sin(0.5 * angle) / angle
    out = np.empty(4)
    out[0], out[1], out[2] = s * vector[0], s * vector[1], s * vector[2]
    out[3] = math.cos(0.5 * angle)
    return out


@njit(cache=True)
def turn_of(q):
    """Rotation vector (3,) [rad] of the quaternion (4,), with an angle of at most pi."""
    s = math.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2)
    sign = 1.0 if q[3] >= 0.0 else -1.0
    part = 2.0 / abs(q[3]) if s < 1e-9 else 2.0 * math.atan2(s, abs(q[3])) / s
    out = np.empty(3)
    out[0], out[1], out[2] = sign * part * q[0], sign * part * q[1], sign * part * q[2]
    return out


@njit(cache=True)
def times(m, v):
    """Matrix (3, 3) times vector (3,)."""
    out = np.empty(3)
    for i in range(3):
        out[i] = m[i, 0] * v[0] + m[i, 1] * v[1] + m[i, 2] * v[2]
    return out


@njit(cache=True)
def apply(m, x, y, z, out):
    """`out` (3,): matrix (3, 3) times the vector x, y, z."""
    for i in range(3):
        out[i] = m[i, 0] * x + m[i, 1] * y + m[i, 2] * z


@njit(cache=True)
def apply_back(m, x, y, z, out):
    """`out` (3,): transposed matrix (3, 3) times the vector x, y, z."""
    for i in range(3):
        out[i] = m[0, i] * x + m[1, i] * y + m[2, i] * z


@njit(cache=True)
def add_moment(x, y, z, force, sign, out):
    """Add to the torque of `out` (6,) the moment of a force (>= 3,) at x, y, z."""
    out[3] += sign * (y * force[2] - z * force[1])
    out[4] += sign * (z * force[0] - x * force[2])
    out[5] += sign * (x * force[1] - y * force[0])


@njit(cache=True)
def cross(a, b):
    """Vector product of (3,) and (3,)."""
    out = np.empty(3)
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
    return out


def from_attitude(degrees) -> np.ndarray:
    """Quaternion (4,) of roll, pitch, yaw about the fixed axes x, y, z, in this order [deg]."""
    q = np.array([0.0, 0.0, 0.0, 1.0])
    for axis, angle in enumerate(degrees):
        about = np.zeros(3)
        about[axis] = math.radians(float(angle))
        q = product(turn(about), q)
    return q


@njit(cache=True)
def noisy(pose, noise, out):
    """`out` (7,): the pose with noise (6,) on its position and on the quaternion's vector part."""
    for i in range(6):
        out[i] = pose[i] + noise[i]
    out[6] = math.sqrt(max(1.0 - out[3] ** 2 - out[4] ** 2 - out[5] ** 2, 0.0))


@njit(cache=True)
def slope(before, now, h, out):
    """`out` (6,): the twist from one pose to the next in h [s], both parts separately."""
    turned = turn_of(product(now[3:7], inverse(before[3:7])))
    for i in range(3):
        out[i] = (now[i] - before[i]) / h
        out[3 + i] = turned[i] / h


def all_noisy(pose: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Poses (n, 7) with noise (n, 6)."""
    out = pose.copy()
    out[:, :6] += noise
    out[:, 6] = np.sqrt(np.maximum(1.0 - np.sum(out[:, 3:6] ** 2, axis=1), 0.0))
    return out
