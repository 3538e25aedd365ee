"""The weight of a tree on its drives, and the wrench that a rigid load needs.

Weights act on the tree's own joints; for closed loops, :func:`drive_forces` transfers them to the
driven joints by virtual work: in every motion that the loops allow, the drives do the work of all
joint forces of the tree.

A six-axis sensor on a moving platform measures its payload as well as the contact. With the load's
mass m, its centre of mass r and its inertia I about it known from weighing, that part can be
subtracted (Newton-Euler, about the origin of what carries it, in any axes):

    f = m (a - g + alpha x r + omega x (omega x r)),   t = I alpha + omega x I omega + r x f
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array, cross, rotate, rotate_back
from hiltestbed.numerical_model.kernels import solve
from hiltestbed.platform.facilities.tree import FREE, HINGE, SLIDE

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
def _inertia_times(load, attitude, v, work, out):
    """``out = R I R^T v`` with the inertia of ``load``; ``work`` (>= 2, 3) is overwritten."""
    a, b = work[0], work[1]
    rotate_back(attitude, v, a)
    for i in range(3):
        b[i] = load[4 + 3 * i] * a[0] + load[5 + 3 * i] * a[1] + load[6 + 3 * i] * a[2]
    rotate(attitude, b, out)


@njit(cache=True)
def carry(load, attitude, spin, accel, work, wrench):
    """``wrench`` (6,) at its origin that accelerates ``load`` (13,) and supports its weight.

    Args:
        attitude: (4,) of what carries it. spin: (3,) its angular velocity. accel: (6,) linear (of
            its origin, less gravity's) and angular acceleration; all in the axes of the wrench.
            work: (>= 6, 3), overwritten.
    """
    r, v, w, f = work[2], work[3], work[4], work[5]
    rotate(attitude, load[1:4], r)
    cross(spin, r, v)
    cross(spin, v, w)
    cross(accel[3:6], r, v)
    for j in range(3):
        f[j] = load[0] * (accel[j] + v[j] + w[j])
    _inertia_times(load, attitude, spin, work, v)
    cross(spin, v, w)
    _inertia_times(load, attitude, accel[3:6], work, v)
    cross(r, f, wrench[3:6])
    for j in range(3):
        wrench[j] = f[j]
        wrench[3 + j] += v[j] + w[j]


@njit(cache=True)
def weights(tree, gravity, w, out):
    """``out`` (nv,) [N, N m]: joint forces that support the bodies' weight, less the part supported
    by counterweights: forces and moments about W's origin, summed towards the root (Featherstone,
    Rigid Body Dynamics Algorithms, 2008, ch. 5).

    Poses must be current.
    """
    r = np.empty(3)
    for b in range(tree.bodies.shape[0]):
        mass, pose, load = tree.masses[b], w.poses[b], w.loads[b]
        rotate(pose[3:7], mass[1:4], r)
        for i in range(3):
            r[i] += pose[i]
            load[i] = -mass[0] * (1.0 - mass[13]) * gravity[i]
        cross(r, load, load[3:6])
    out[:] = 0.0
    for b in range(tree.bodies.shape[0] - 1, 0, -1):
        p, first, count = tree.bodies[b, 0], tree.bodies[b, 1], tree.bodies[b, 2]
        load = w.loads[b]
        for i in range(6):
            w.loads[p, i] += load[i]
        for j in range(first, first + count):
            kind, d = tree.joints[j, 0], tree.joints[j, 3]
            axis = w.axes[j]
            if kind == SLIDE:
                for i in range(3):
                    out[d] += axis[3 + i] * load[i]
                continue
            cross(axis, load, r)
            for i in range(3):
                r[i] = load[3 + i] - r[i]
            if kind == HINGE:
                for i in range(3):
                    out[d] += axis[3 + i] * r[i]
                continue
            if kind == FREE:
                for i in range(3):
                    out[d + i] = load[i]
                d += 3
            rotate_back(w.poses[b, 3:7], r, out[d : d + 3])


@njit(cache=True)
def drive_forces(ways, axes, forces, square, out):
    """``out`` (J,): forces of the driven joints that do the work of ``forces`` (nv,) in each of the
    motions ``ways`` (t, nv).

    axes: (J,) their degrees of freedom. square: (J, J) work space. With more drives than motions:
        the minimum norm.
    """
    tasks, n = ways.shape[0], axes.shape[0]
    most = 0.0
    for i in range(n):
        out[i] = 0.0
        for j in range(n):
            square[i, j] = 0.0
    for t in range(tasks):
        work = 0.0
        for d in range(ways.shape[1]):
            work += ways[t, d] * forces[d]
        for i in range(n):
            x = ways[t, axes[i]]
            out[i] += x * work
            for j in range(i + 1):
                square[i, j] += x * ways[t, axes[j]]
    for i in range(n):
        most = max(most, square[i, i])
    for i in range(n):
        square[i, i] += 1e-12 * most
    solve(square, out, square)
