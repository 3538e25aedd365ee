"""Measured poses: with noise, and with twists as their differences over a tick."""

from __future__ import annotations

import math

import numpy as np

from hiltestbed.compiled.jit import njit
from tests.equipment.independent_rig.rotation import inverse, product, turn_of


@njit(cache=True)
def noisy(pose, noise, out):
    """`out` (7,): the pose with noise (6,) on its position and on the quaternion's vector part."""
    for i in range(6):
        out[i] = pose[i] + noise[i]
    out[6] = math.sqrt(max(1.0 - out[3] ** 2 - out[4] ** 2 - out[5] ** 2, 0.0))


@njit(cache=True)
def slope(before, now, h, out):
    """`out` (6,): the twist from one pose to the next in h [s], linear and angular part
    separately.
    """
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
