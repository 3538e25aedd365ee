"""Inverse dynamics of the 3-3 PSS platform in its sliders: the drive forces for a given motion,
gravity included.

Platform with mechanism as one rigid body, links as uniform rods between carriage and anchor
(consistent mass m/3, m/6, m/3, half the weight at each end), carriages with their drives' armature.
Velocity-dependent terms are neglected: at 0.3 m/s and 0.2 rad/s they are below 1 N of some 7000 N.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array, rotate, rotate_back
from hiltestbed.platform.payload import GRAVITY, load_of


def load_constants(m: mujoco.MjModel, tool: str = "active_A") -> Array:
    """``(16,)``: moved mass [kg], its centre of mass from A in A (3) [m], inertia about it in A (9,
    row-major) [kg m^2], link mass, carriage mass, armature [kg], of a compiled rig at home; A is
    its site ``tool``.
    """
    data = mujoco.MjData(m)
    mujoco.mj_forward(m, data)
    platform = m.body("platform").id
    bodies = [b for b in range(m.nbody) if m.body_rootid[b] == platform]
    carriage, link = m.body("carriage_0").mass[0], m.body("link_0").mass[0]
    armature = m.dof_armature[m.joint("slider_0").dofadr[0]]
    moved = load_of(m, data, bodies, data.site(tool).xpos)
    return np.concatenate([moved, [link, carriage, armature]])


@njit(cache=True)
def invert(a, out):
    """``out = a^-1`` (6, 6), row pivoting; overwrites ``a``. Singular: huge numbers."""
    n = a.shape[0]
    for i in range(n):
        for k in range(n):
            out[i, k] = 1.0 if i == k else 0.0
    for c in range(n):
        p = c
        for r in range(c + 1, n):
            if abs(a[r, c]) > abs(a[p, c]):
                p = r
        if p != c:
            for k in range(n):
                a[c, k], a[p, k] = a[p, k], a[c, k]
                out[c, k], out[p, k] = out[p, k], out[c, k]
        scale = 1.0 / (a[c, c] if abs(a[c, c]) > 1e-9 else math.copysign(1e-9, a[c, c]))
        for k in range(n):
            a[c, k] *= scale
            out[c, k] *= scale
        for r in range(n):
            f = a[r, c]
            if r != c and f != 0.0:
                for k in range(n):
                    a[r, k] -= f * a[c, k]
                    out[r, k] -= f * out[c, k]


@njit(cache=True)
def drive_forces(limbs, load, pose, inverse, accel, force):
    """``force`` (6,) [N] of the drives at the pose ``(7,)`` for slider accelerations ``accel`` (6,)
    [m/s^2].

    ``inverse`` (6, 6) maps slider rates to the twist of A in W; by virtual work its transpose maps
    wrenches to slider forces.
    """
    mass, link, carriage, armature = load[0], load[13], load[14], load[15]
    a = np.empty(6)
    for i in range(6):
        a[i] = 0.0
        for j in range(6):
            a[i] += inverse[i, j] * accel[j]
    r = np.empty(3)
    f = np.empty(3)
    turn = np.empty(3)
    wrench = np.zeros(6)
    rotate(pose[3:7], load[1:4], r)
    f[0] = mass * (a[0] + a[4] * r[2] - a[5] * r[1])
    f[1] = mass * (a[1] + a[5] * r[0] - a[3] * r[2])
    f[2] = mass * (a[2] + a[3] * r[1] - a[4] * r[0] + GRAVITY)
    rotate_back(pose[3:7], a[3:6], turn)
    w = np.empty(3)
    for i in range(3):
        w[i] = load[4 + 3 * i] * turn[0] + load[5 + 3 * i] * turn[1] + load[6 + 3 * i] * turn[2]
    rotate(pose[3:7], w, wrench[3:6])
    add_force(f, r, wrench)
    for j in range(6):
        limb = limbs[j]
        rotate(pose[3:7], limb[6:9], r)
        f[0] = a[0] + a[4] * r[2] - a[5] * r[1]
        f[1] = a[1] + a[5] * r[0] - a[3] * r[2]
        f[2] = a[2] + a[3] * r[1] - a[4] * r[0]
        along = limb[3] * f[0] + limb[4] * f[1] + limb[5] * f[2]
        for i in range(3):
            f[i] = link * (f[i] / 3.0 + limb[3 + i] * accel[j] / 6.0)
        f[2] += 0.5 * link * GRAVITY
        add_force(f, r, wrench)
        force[j] = link * (along / 6.0 + accel[j] / 3.0) + (carriage + armature) * accel[j]
        force[j] += limb[5] * (0.5 * link + carriage) * GRAVITY
    for j in range(6):
        for i in range(6):
            force[j] += inverse[i, j] * wrench[i]


@njit(cache=True)
def add_force(f, r, wrench):
    """Add the force ``f`` at the arm ``r`` to ``wrench`` (6,)."""
    wrench[0] += f[0]
    wrench[1] += f[1]
    wrench[2] += f[2]
    wrench[3] += r[1] * f[2] - r[2] * f[1]
    wrench[4] += r[2] * f[0] - r[0] * f[2]
    wrench[5] += r[0] * f[1] - r[1] * f[0]
