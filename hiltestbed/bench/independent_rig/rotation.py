"""Rotations as quaternions x, y, z, w: this rig's own, so that an error in `frames` cannot hide in both."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True)
def product(a, b):
    """The rotation `b` followed by `a`; (4,)."""
    return np.array(
        [
            a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
            a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
            a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
            a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
        ]
    )


@njit(cache=True)
def inverse(q):
    """The rotation backwards; (4,)."""
    return np.array([-q[0], -q[1], -q[2], q[3]])


@njit(cache=True)
def matrix(q):
    """Rotation matrix (3, 3) of the quaternion (4,)."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


@njit(cache=True)
def turn(vector):
    """Quaternion (4,) of a rotation vector (3,) [rad]."""
    angle = math.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    s = 0.5 - angle * angle / 48.0 if angle < 1e-4 else math.sin(0.5 * angle) / angle
    return np.array([s * vector[0], s * vector[1], s * vector[2], math.cos(0.5 * angle)])


@njit(cache=True)
def times(m, v):
    """Matrix (3, 3) times vector (3,)."""
    out = np.empty(3)
    for i in range(3):
        out[i] = m[i, 0] * v[0] + m[i, 1] * v[1] + m[i, 2] * v[2]
    return out


@njit(cache=True)
def cross(a, b):
    """Vector product of (3,) and (3,)."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def from_attitude(degrees) -> np.ndarray:
    """Quaternion (4,) of roll, pitch, yaw about the fixed axes x, y, z, in this order [deg]."""
    q = np.array([0.0, 0.0, 0.0, 1.0])
    for axis, angle in enumerate(degrees):
        about = np.zeros(3)
        about[axis] = math.radians(float(angle))
        q = product(turn(about), q)
    return q
