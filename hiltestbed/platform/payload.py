"""Wrench for carrying a rigid load on a moving platform: weight and inertia, at P's origin.

A six-axis sensor on a moving platform measures its payload as well as the contact. With the load's
mass m, its centre of mass r and its inertia I about it known from weighing, and the platform's
motion known from its command, that part can be subtracted (Newton-Euler, about P's origin):

    f = m (a + alpha x r + omega x (omega x r) + g),   t = I alpha + omega x I omega + r x f
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array, cross, rotate, rotate_back

GRAVITY = 9.81  # [m/s^2]; here along -z of W


def load_of(m: mujoco.MjModel, data: mujoco.MjData, bodies: Sequence[int], origin: Array) -> Array:
    """``(13,)`` mass, centre from ``origin`` (3,), inertia about it (9,) of ``bodies`` in W."""
    mass = m.body_mass[bodies]
    com = (mass[:, None] * data.xipos[bodies]).sum(axis=0) / mass.sum()
    inertia = np.zeros((3, 3))
    for b in bodies:
        axes, r = data.ximat[b].reshape(3, 3), data.xipos[b] - com
        inertia += axes @ np.diag(m.body_inertia[b]) @ axes.T + m.body_mass[b] * (
            r @ r * np.eye(3) - np.outer(r, r)
        )
    return np.concatenate([[mass.sum()], com - origin, inertia.ravel()])


@njit(cache=True)
def _inertia_times(load, attitude, v, out):
    """``out = R I R^T v`` with the inertia of ``load``."""
    a, b = np.empty(3), np.empty(3)
    rotate_back(attitude, v, a)
    for i in range(3):
        b[i] = load[4 + 3 * i] * a[0] + load[5 + 3 * i] * a[1] + load[6 + 3 * i] * a[2]
    rotate(attitude, b, out)


@njit(cache=True)
def carry(load, attitude, spin, accel, wrench):
    """``wrench`` (6,) in W at P's origin that accelerates ``load`` (13,) and supports its weight.

    Args:
        attitude: (4,) of P in W. spin: (3,) angular velocity of P. accel: (6,) linear (of P's
            origin) and angular acceleration; all in W.
    """
    r, v, w, f = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    rotate(attitude, load[1:4], r)
    cross(spin, r, v)
    cross(spin, v, w)
    cross(accel[3:6], r, v)
    for j in range(3):
        f[j] = load[0] * (accel[j] + v[j] + w[j])
    f[2] += load[0] * GRAVITY
    _inertia_times(load, attitude, spin, v)
    cross(spin, v, w)
    _inertia_times(load, attitude, accel[3:6], v)
    wrench[0:3] = f
    cross(r, f, wrench[3:6])
    for j in range(3):
        wrench[3 + j] += v[j] + w[j]
