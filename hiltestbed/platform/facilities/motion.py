"""Compiled poses and velocities of a tree, equal to MuJoCo's own (``mj_kinematics``,
``mj_comVel``); tools are in W.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array, quat_mul, quat_normalise, rotate
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
