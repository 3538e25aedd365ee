"""Inverse dynamics of a tree (recursive Newton-Euler; Featherstone, Rigid Body Dynamics Algorithms,
2008, ch. 5), written in W, and of one rigid body that a platform carries.

Forces act on the tree's own joints; for closed loops, :func:`drive_forces` transfers them to the
driven joints by virtual work: in every motion that the loops allow, the drives do the work of all
joint forces of the tree.

A load of mass m, centre of mass r and inertia I about it, about the origin of what carries it:

    f = m (a + alpha x r + omega x (omega x r) + g),   t = I alpha + omega x I omega + r x f
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array, cross, rotate, rotate_back
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
    """``wrench`` (6,) in W at its origin that accelerates ``load`` (13,) and supports its weight.

    Args:
        attitude: (4,) of what carries it. spin: (3,) its angular velocity. accel: (6,) linear (of
            its origin) and angular acceleration; all in W. work: (>= 6, 3), overwritten.
    """
    r, v, w, f = work[2], work[3], work[4], work[5]
    rotate(attitude, load[1:4], r)
    cross(spin, r, v)
    cross(spin, v, w)
    cross(accel[3:6], r, v)
    for j in range(3):
        f[j] = load[0] * (accel[j] + v[j] + w[j])
    f[2] += load[0] * GRAVITY
    _inertia_times(load, attitude, spin, work, v)
    cross(spin, v, w)
    _inertia_times(load, attitude, accel[3:6], work, v)
    cross(r, f, wrench[3:6])
    for j in range(3):
        wrench[j] = f[j]
        wrench[3 + j] += v[j] + w[j]


@njit(cache=True)
def _component(a, i0, b, j0, i):
    """Component ``i`` of a x b, with both vectors at the given offsets of their arrays."""
    k, l = (i + 1) % 3, (i + 2) % 3
    return a[i0 + k] * b[j0 + l] - a[i0 + l] * b[j0 + k]


@njit(cache=True)
def joint_forces(tree, v, a, gravity, w, out):
    """``out`` (nv,) [N, N m]: forces in the joints for rates ``v`` and accelerations ``a`` (nv,),
    gravity (3,) [m/s^2] included.

    Poses must be current (:func:`hiltestbed.platform.facilities.motion.place`).
    """
    w.motion[0] = 0.0
    for i in range(3):
        w.motion[0, 6 + i] = -gravity[i]
    for b in range(1, tree.bodies.shape[0]):
        _accelerate(tree, w, b, v, a, gravity)
    for b in range(tree.bodies.shape[0]):
        _inertial_load(tree, gravity, w, b)
    _gather(tree, w, out)
    for d in range(out.shape[0]):
        out[d] += tree.armature[d] * a[d]


@njit(cache=True)
def _accelerate(tree, w, b, v, a, gravity):
    """Motion of body ``b``: its parent's, and the velocity field of one joint after the other."""
    turn, bend, r, arm = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    p, first, count = tree.bodies[b, 0], tree.bodies[b, 1], tree.bodies[b, 2]
    motion, parent, pose = w.motion[b], w.motion[p], w.poses[b]
    for i in range(3):
        r[i] = pose[i] - w.poses[p, i]
    for i in range(3):
        arm[i] = _component(parent, 3, r, 0, i)
    for i in range(3):
        motion[3 + i], motion[9 + i] = parent[3 + i], parent[9 + i]
        motion[6 + i] = (
            parent[6 + i] + _component(parent, 9, r, 0, i) + _component(parent, 3, arm, 0, i)
        )
    for j in range(first, first + count):
        kind, d = tree.joints[j, 0], tree.joints[j, 3]
        axis = w.axes[j]
        if kind == SLIDE:
            for i in range(3):
                motion[6 + i] += axis[3 + i] * a[d] + 2.0 * v[d] * _component(motion, 3, axis, 3, i)
            continue
        if kind == HINGE:
            for i in range(3):
                turn[i], bend[i] = axis[3 + i] * v[d], axis[3 + i] * a[d]
        else:
            if kind == FREE:
                for i in range(3):
                    motion[6 + i] = a[d + i] - gravity[i]
                    motion[3 + i] = motion[9 + i] = 0.0
                d += 3
            rotate(pose[3:7], v[d : d + 3], turn)
            rotate(pose[3:7], a[d : d + 3], bend)
        for i in range(3):
            r[i] = pose[i] - axis[i]
            bend[i] += _component(motion, 3, turn, 0, i)
        for i in range(3):
            arm[i] = _component(motion, 3, r, 0, i)
        for i in range(3):
            motion[6 + i] += _component(bend, 0, r, 0, i) - _component(motion, 3, arm, 0, i)
        for i in range(3):
            motion[3 + i] += turn[i]
            motion[9 + i] += bend[i]
        for i in range(3):
            arm[i] = _component(motion, 3, r, 0, i)
        for i in range(3):
            motion[6 + i] += _component(motion, 3, arm, 0, i)


@njit(cache=True)
def _inertial_load(tree, gravity, w, b):
    """``w.loads``: force for a body's acceleration, less its counterweight, and its moment."""
    r, arm, spin, twirl, load = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    mass, motion, pose, out = tree.masses[b], w.motion[b], w.poses[b], w.loads[b]
    rotate(pose[3:7], mass[1:4], r)
    for i in range(3):
        arm[i] = _component(motion, 3, r, 0, i)
    for i in range(3):
        out[i] = mass[0] * (
            motion[6 + i]
            + _component(motion, 9, r, 0, i)
            + _component(motion, 3, arm, 0, i)
            + mass[13] * gravity[i]
        )
    rotate_back(pose[3:7], motion[3:6], spin)
    rotate_back(pose[3:7], motion[9:12], twirl)
    for i in range(3):
        arm[i] = load[i] = 0.0
        for k in range(3):
            arm[i] += mass[4 + 3 * i + k] * spin[k]
            load[i] += mass[4 + 3 * i + k] * twirl[k]
    for i in range(3):
        twirl[i] = load[i] + _component(spin, 0, arm, 0, i)
    rotate(pose[3:7], twirl, load)
    for i in range(3):
        r[i] += pose[i]
    for i in range(3):
        out[3 + i] = load[i] + _component(r, 0, out, 0, i)


@njit(cache=True)
def _gather(tree, w, out):
    """``out`` (nv,): joint forces that support the bodies' loads, summed towards the root."""
    load = np.empty(3)
    out[:] = 0.0
    for b in range(tree.bodies.shape[0] - 1, 0, -1):
        p, first, count = tree.bodies[b, 0], tree.bodies[b, 1], tree.bodies[b, 2]
        force = w.loads[b]
        for i in range(6):
            w.loads[p, i] += force[i]
        for j in range(first, first + count):
            kind, d = tree.joints[j, 0], tree.joints[j, 3]
            axis = w.axes[j]
            if kind == SLIDE:
                for i in range(3):
                    out[d] += axis[3 + i] * force[i]
                continue
            for i in range(3):
                load[i] = force[3 + i] - _component(axis, 0, force, 0, i)
            if kind == HINGE:
                for i in range(3):
                    out[d] += axis[3 + i] * load[i]
                continue
            if kind == FREE:
                for i in range(3):
                    out[d + i] = force[i]
                d += 3
            rotate_back(w.poses[b, 3:7], load, out[d : d + 3])


@njit(cache=True)
def weights(tree, gravity, w, out):
    """``out`` (nv,) [N, N m]: joint forces that support the bodies' weight, less the part supported
    by counterweights.

    Poses must be current.
    """
    r = np.empty(3)
    for b in range(tree.bodies.shape[0]):
        mass, pose, load = tree.masses[b], w.poses[b], w.loads[b]
        rotate(pose[3:7], mass[1:4], r)
        for i in range(3):
            r[i] += pose[i]
            load[i] = -mass[0] * (1.0 - mass[13]) * gravity[i]
        for i in range(3):
            load[3 + i] = _component(r, 0, load, 0, i)
    _gather(tree, w, out)


@njit(cache=True)
def drive_forces(ways, axes, forces, square, right, out):
    """``out`` (J,): forces of the driven joints that do the work of ``forces`` (nv,) in each of the
    motions ``ways`` (t, nv).

    axes: (J,) their degrees of freedom. square (J, J) and right (J,) are work space. With more
        drives than motions: the minimum norm.
    """
    tasks, n = ways.shape[0], axes.shape[0]
    most = 0.0
    for i in range(n):
        right[i] = 0.0
        for j in range(n):
            square[i, j] = 0.0
    for t in range(tasks):
        work = 0.0
        for d in range(ways.shape[1]):
            work += ways[t, d] * forces[d]
        for i in range(n):
            x = ways[t, axes[i]]
            right[i] += x * work
            for j in range(i + 1):
                square[i, j] += x * ways[t, axes[j]]
    for i in range(n):
        most = max(most, square[i, i])
    for i in range(n):
        square[i, i] += 1e-12 * most
    solve_symmetric(square, right, out)


@njit(cache=True)
def solve_symmetric(a, b, out):
    """``out``: a^-1 b for a symmetric positive ``a`` (n, n), lower half, which is overwritten."""
    n = b.shape[0]
    for i in range(n):
        for j in range(i + 1):
            total = a[i, j]
            for k in range(j):
                total -= a[i, k] * a[j, k]
            a[i, j] = math.sqrt(max(total, 1e-300)) if i == j else total / a[j, j]
        total = b[i]
        for k in range(i):
            total -= a[i, k] * out[k]
        out[i] = total / a[i, i]
    for i in range(n - 1, -1, -1):
        total = out[i]
        for k in range(i + 1, n):
            total -= a[k, i] * out[k]
        out[i] = total / a[i, i]
