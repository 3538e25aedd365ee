"""Compiled poses, velocities and weights of a tree, equal to MuJoCo's own (``mj_kinematics``,
``mj_comVel``, ``mj_inverse``), and the wrench that a rigid load needs. Tools are in W.

Weights act on the tree's own joints; for closed loops, :func:`drive_forces` transfers them to the
driven joints by virtual work: in every motion that the loops allow, the drives do the work of all
joint forces of the tree.

A six-axis sensor on a moving platform measures its payload as well as the contact. With the load's
mass m, its centre of mass r and its inertia I about it known from weighing, that part can be
subtracted (Newton-Euler, about the origin of what carries it, in any axes):

    f = m (a - g + alpha x r + omega x (omega x r)),   t = I alpha + omega x I omega + r x f
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array, cross, quat_mul, quat_normalise, rotate, rotate_back
from hiltestbed.numerical_model.kernels import solve
from hiltestbed.platform.facilities.tree import FRAME, FREE, HINGE, SLIDE, JointTree

LOCAL = 27  # first number of the part of the work space that poses and velocities use
SPARE = LOCAL + 15


class Scratch(NamedTuple):
    """Quantities that depend on the joints, and work space; one set serves all runs in turn.

    Attributes:
        poses: (nb, 7) of the bodies in W. axes: (nj, 6) anchor and axis of each joint in W.
        motion: (nb, 6) velocity and angular velocity of a body, at its origin, in W.
        loads: (nb, 6) force and moment about W's origin.
        rows: (r, nv). square: (u, u). right, first, filled: (u,). residual, goal: (r,). step:
            (nv,). spare: (SPARE,).
    """

    poses: Array
    axes: Array
    motion: Array
    loads: Array
    rows: Array
    square: Array
    right: Array
    first: Array
    filled: Array
    residual: Array
    goal: Array
    step: Array
    spare: Array


def scratch(tree: JointTree) -> Scratch:
    """Work space for one tree. Rows: loops, coupled joints, tools, prescribed joints."""
    nb, nv, u = len(tree.bodies), len(tree.armature), len(tree.unknown)
    loops = sum(6 if kind == FRAME else 3 for kind in tree.loops[:, 0])
    r = loops + len(tree.coupled) + 6 * len(tree.tools) + len(tree.prescribed)
    return Scratch(
        poses=np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (nb, 1)),
        axes=np.zeros((len(tree.joints), 6)),
        motion=np.zeros((nb, 6)),
        loads=np.zeros((nb, 6)),
        rows=np.zeros((r, nv)),
        square=np.zeros((u, u)),
        right=np.zeros(u),
        first=np.zeros(u),
        filled=np.zeros(u),
        residual=np.zeros(r),
        goal=np.zeros(r),
        step=np.zeros(nv),
        spare=np.zeros(SPARE),
    )


@njit(cache=True)
def place(tree, q, w):
    """Poses of bodies and axes of joints at the joint positions ``q`` (nq,)."""
    local = w.spare[LOCAL:]
    r, turn, quat, after = local[0:3], local[3:7], local[7:11], local[11:15]
    for b in range(1, tree.bodies.shape[0]):
        p, first, count = tree.bodies[b, 0], tree.bodies[b, 1], tree.bodies[b, 2]
        pose = w.poses[b]
        if count == 1 and tree.joints[first, 0] == FREE:
            a = tree.joints[first, 2]
            for i in range(3):
                pose[i] = w.axes[first, i] = q[a + i]
                pose[3 + i] = q[a + 4 + i]
            pose[6] = q[a + 3]
            quat_normalise(pose[3:7])
            continue
        parent = w.poses[p]
        rotate(parent[3:7], tree.frames[b], r)
        for i in range(3):
            pose[i] = parent[i] + r[i]
        quat_mul(parent[3:7], tree.frames[b, 3:7], quat)
        for j in range(first, first + count):
            kind, a = tree.joints[j, 0], tree.joints[j, 2]
            geometry, axis = tree.axes[j], w.axes[j]
            rotate(quat, geometry, axis)
            for i in range(3):
                axis[i] += pose[i]
            rotate(quat, geometry[3:6], axis[3:6])
            if kind == SLIDE:
                for i in range(3):
                    pose[i] += axis[3 + i] * (q[a] - geometry[6])
                continue
            if kind == HINGE:
                half = 0.5 * (q[a] - geometry[6])
                sine = math.sin(half)
                for i in range(3):
                    turn[i] = sine * geometry[3 + i]
                turn[3] = math.cos(half)
            else:
                for i in range(3):
                    turn[i] = q[a + 1 + i]
                turn[3] = q[a]
                quat_normalise(turn)
            quat_mul(quat, turn, after)
            for i in range(4):
                quat[i] = after[i]
            rotate(quat, geometry, r)
            for i in range(3):
                pose[i] = axis[i] - r[i]
        for i in range(4):
            pose[3 + i] = quat[i]


@njit(cache=True)
def move(tree, v, w):
    """Velocities of the bodies in ``w.motion`` for joint rates ``v`` (nv,), at current poses."""
    local = w.spare[LOCAL : LOCAL + 3]
    for b in range(1, tree.bodies.shape[0]):
        p, first, count = tree.bodies[b, 0], tree.bodies[b, 1], tree.bodies[b, 2]
        motion, pose = w.motion[b], w.poses[b]
        if count == 1 and tree.joints[first, 0] == FREE:
            a = tree.joints[first, 3]
            for i in range(3):
                motion[i] = v[a + i]
            rotate(pose[3:7], v[a + 3 : a + 6], motion[3:6])
            continue
        _carry(w.poses[p], w.motion[p], pose, motion)
        for i in range(3):
            motion[3 + i] = w.motion[p, 3 + i]
        for j in range(first, first + count):
            kind, a = tree.joints[j, 0], tree.joints[j, 3]
            axis = w.axes[j]
            if kind == SLIDE:
                for i in range(3):
                    motion[i] += axis[3 + i] * v[a]
                continue
            if kind == HINGE:
                for i in range(3):
                    local[i] = axis[3 + i] * v[a]
            else:
                rotate(pose[3:7], v[a : a + 3], local)
            for i in range(3):
                k, l = (i + 1) % 3, (i + 2) % 3
                motion[3 + i] += local[i]
                motion[i] += local[k] * (pose[l] - axis[l]) - local[l] * (pose[k] - axis[k])


@njit(cache=True)
def _carry(at, motion, point, out):
    """``out``: velocity of a ``point`` fixed to a body whose origin ``at`` has ``motion``."""
    for i in range(3):
        k, l = (i + 1) % 3, (i + 2) % 3
        out[i] = motion[i] + motion[3 + k] * (point[l] - at[l]) - motion[3 + l] * (point[k] - at[k])


@njit(cache=True)
def tool_pose(tree, w, t, out):
    """``out`` (7,): pose of tool ``t`` in W."""
    pose, frame = w.poses[tree.tools[t]], tree.tool_frames[t]
    rotate(pose[3:7], frame, out)
    for i in range(3):
        out[i] += pose[i]
    quat_mul(pose[3:7], frame[3:7], out[3:7])


@njit(cache=True)
def tool_twist(tree, w, t, out):
    """``out`` (6,): twist of tool ``t`` in W; poses and velocities must be current."""
    b, point = tree.tools[t], w.spare[LOCAL : LOCAL + 3]
    rotate(w.poses[b, 3:7], tree.tool_frames[t], point)
    for i in range(3):
        point[i] += w.poses[b, i]
    _carry(w.poses[b], w.motion[b], point, out)
    for i in range(3):
        out[3 + i] = w.motion[b, 3 + i]


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
