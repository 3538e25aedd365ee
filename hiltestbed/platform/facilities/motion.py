"""Kinematics of a tree with loops, compiled: places, velocities, the Jacobian of its constraints and tools, and Newton's method.

The unknown joints solve, together, the loop closures, the commanded poses of the tools and the prescribed joints: residual r(q) = 0,
with the Jacobian A of all rows. A step is q <- q - (A^T A + e)^-1 A^T r with e at round-off, which also serves redundant rows (a planar
linkage closed in space) and redundant joints (a seventh axis moves least). Places follow ``mj_kinematics``; tools and loops are
expressed in W. Rates of the joints for given twists of the tools solve the same matrix.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from hiltestbed.frames import Array, quat_exp, quat_mul, quat_normalise, rotate, rotation_vector
from hiltestbed.platform.facilities.tree import FRAME, FREE, HINGE, SLIDE, Integers, Tree

DAMPING = 1e-11  # of the largest diagonal term of A^T A
LONGEST_STEP = 0.2  # [m], [rad] of a joint in one iteration
CLOSE = 1e-10  # [m], [rad] the largest residual that counts as solved
ITERATIONS = 40
SPARE = 27


class Scratch(NamedTuple):
    """What depends on the joints, and room to work in; one set serves all runs in turn.

    Attributes:
        poses: (nb, 7) of the bodies in W. axes: (nj, 6) anchor and axis of each joint in W.
        motion: (nb, 12) velocity and spin of a body, acceleration and its rate of spin, of the body's origin, in W.
        loads: (nb, 6) force and moment about W's origin; for weights: mass and first moment.
        rows: (r, nv). square: (u, u). right, first, filled: (u,). residual, goal: (r,). step: (nv,). spare: (SPARE,).
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


def row_count(tree: Tree) -> int:
    """Number of equations: loops, coupled joints, tools, prescribed joints."""
    loops = sum(6 if kind == FRAME else 3 for kind in tree.loops[:, 0])
    return loops + len(tree.coupled) + 6 * len(tree.tools) + len(tree.prescribed)


def scratch(tree: Tree) -> Scratch:
    """Room for one tree."""
    nb, nj, nv, u, r = len(tree.bodies), len(tree.joints), len(tree.armature), len(tree.unknown), row_count(tree)
    poses = np.zeros((nb, 7))
    poses[:, 6] = 1.0
    return Scratch(
        poses, np.zeros((nj, 6)), np.zeros((nb, 12)), np.zeros((nb, 6)),
        np.zeros((r, nv)), np.zeros((u, u)), np.zeros(u), np.zeros(u), np.zeros(u), np.zeros(r), np.zeros(r), np.zeros(nv),
        np.zeros(SPARE),
    )  # fmt: skip


def packed(tree: Tree) -> tuple[Integers, Array, Array]:
    """A tree and room to work in as three flat arrays: integers, numbers, room. Handing over many arrays costs more than a tick's sums."""
    nb, nj, nv, nl = len(tree.bodies), len(tree.joints), len(tree.armature), len(tree.loops)
    sizes = [nb, nj, nv, nl, len(tree.coupled), len(tree.tools), len(tree.prescribed), len(tree.unknown), row_count(tree)]
    integers = [tree.bodies, tree.joints, tree.loops, tree.coupled, tree.tools, tree.prescribed, tree.unknown]
    numbers = [tree.frames, tree.masses, tree.axes, tree.armature, tree.loop_frames, tree.polynomial, tree.tool_frames]
    room = np.concatenate([part.ravel() for part in scratch(tree)])
    flat = np.concatenate([np.array(sizes, dtype=np.int64), *(part.ravel() for part in integers)])
    return flat, np.concatenate([part.ravel() for part in numbers]), room


@njit(cache=True, inline="always")
def _next(flat, at, rows, columns):
    return flat[at : at + rows * columns].reshape((rows, columns))


@njit(cache=True)
def unpack(integers, numbers, room):
    """Tree and scratch as views of the flat arrays of :func:`packed`."""
    nb, nj, nv, nl, ne = integers[0], integers[1], integers[2], integers[3], integers[4]
    nt, np_, u, r = integers[5], integers[6], integers[7], integers[8]
    i = 9
    bodies = _next(integers, i, nb, 3)
    joints = _next(integers, i + 3 * nb, nj, 4)
    i += 3 * nb + 4 * nj
    loops = _next(integers, i, nl, 3)
    coupled = _next(integers, i + 3 * nl, ne, 2)
    i += 3 * nl + 2 * ne
    tools, prescribed, unknown = integers[i : i + nt], integers[i + nt : i + nt + np_], integers[i + nt + np_ : i + nt + np_ + u]
    frames = _next(numbers, 0, nb, 7)
    masses = _next(numbers, 7 * nb, nb, 13)
    f = 20 * nb
    axes = _next(numbers, f, nj, 7)
    f += 7 * nj
    armature = numbers[f : f + nv]
    f += nv
    loop_frames = numbers[f : f + 14 * nl].reshape((nl, 2, 7))
    f += 14 * nl
    polynomial = _next(numbers, f, ne, 5)
    tool_frames = _next(numbers, f + 5 * ne, nt, 7)
    tree = Tree(
        bodies, frames, masses, joints, axes, armature, loops, loop_frames, coupled, polynomial, tools, tool_frames, prescribed, unknown
    )
    poses = _next(room, 0, nb, 7)
    s = 7 * nb
    lines = _next(room, s, nj, 6)
    s += 6 * nj
    motion = _next(room, s, nb, 12)
    loads = _next(room, s + 12 * nb, nb, 6)
    s += 18 * nb
    rows = _next(room, s, r, nv)
    s += r * nv
    square = _next(room, s, u, u)
    s += u * u
    right, first, filled = room[s : s + u], room[s + u : s + 2 * u], room[s + 2 * u : s + 3 * u]
    s += 3 * u
    residual, goal, step = room[s : s + r], room[s + r : s + 2 * r], room[s + 2 * r : s + 2 * r + nv]
    spare = room[s + 2 * r + nv : s + 2 * r + nv + SPARE]
    return tree, Scratch(poses, lines, motion, loads, rows, square, right, first, filled, residual, goal, step, spare)


@njit(cache=True)
def place(tree, q, w):
    """Where bodies and joints are at the joint positions ``q`` (nq,)."""
    turn, quat, after, r = np.empty(4), np.empty(4), np.empty(4), np.empty(3)
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
    """How the bodies move at the joint rates ``v`` (nv,): velocity and spin in ``w.motion``, from places that are current."""
    local = np.empty(3)
    for b in range(1, tree.bodies.shape[0]):
        p, first, count = tree.bodies[b, 0], tree.bodies[b, 1], tree.bodies[b, 2]
        motion, pose = w.motion[b], w.poses[b]
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
                if kind == FREE:
                    for i in range(3):
                        motion[i] = v[a + i]
                        motion[3 + i] = 0.0
                    a += 3
                rotate(pose[3:7], v[a : a + 3], local)
            for i in range(3):
                k, l = (i + 1) % 3, (i + 2) % 3
                motion[3 + i] += local[i]
                motion[i] += local[k] * (pose[l] - axis[l]) - local[l] * (pose[k] - axis[k])


@njit(cache=True, inline="always")
def _carry(at, motion, point, out):
    """``out``: velocity of the point that moves with a body whose origin ``at`` has ``motion``."""
    for i in range(3):
        k, l = (i + 1) % 3, (i + 2) % 3
        out[i] = motion[i] + motion[3 + k] * (point[l] - at[l]) - motion[3 + l] * (point[k] - at[k])


@njit(cache=True, inline="always")
def tool_pose(tree, w, t, out):
    """``out`` (7,): pose of tool ``t`` in W."""
    pose, frame = w.poses[tree.tools[t]], tree.tool_frames[t]
    rotate(pose[3:7], frame, out)
    for i in range(3):
        out[i] += pose[i]
    quat_mul(pose[3:7], frame[3:7], out[3:7])


@njit(cache=True)
def tool_twist(tree, w, t, out):
    """``out`` (6,): twist of tool ``t`` in W, from places and velocities that are current."""
    b = tree.tools[t]
    point = np.empty(3)
    rotate(w.poses[b, 3:7], tree.tool_frames[t], point)
    for i in range(3):
        point[i] += w.poses[b, i]
    _carry(w.poses[b], w.motion[b], point, out)
    for i in range(3):
        out[3 + i] = w.motion[b, 3 + i]


@njit(cache=True, inline="always")
def add_point(tree, w, b, point, sign, rows, r):
    """Add ``sign`` times the Jacobian of a point (3,) of body ``b`` to three rows of ``rows``, from row ``r`` on."""
    axis = w.spare[0:6]
    while b > 0:
        first = tree.bodies[b, 1]
        for j in range(first, first + tree.bodies[b, 2]):
            kind, a = tree.joints[j, 0], tree.joints[j, 3]
            if kind == SLIDE:
                for i in range(3):
                    rows[r + i, a] += sign * w.axes[j, 3 + i]
            elif kind == HINGE:
                _add_lever(w.axes[j], point, sign, rows, r, a)
            else:
                if kind == FREE:
                    for i in range(3):
                        rows[r + i, a + i] += sign
                    a += 3
                axis[:3] = w.axes[j, :3]
                for c in range(3):
                    _column(w.poses[b], c, axis)
                    _add_lever(axis, point, sign, rows, r, a + c)
        b = tree.bodies[b, 0]


@njit(cache=True, inline="always")
def _add_lever(axis, point, sign, rows, r, column):
    x, y, z = point[0] - axis[0], point[1] - axis[1], point[2] - axis[2]
    rows[r, column] += sign * (axis[4] * z - axis[5] * y)
    rows[r + 1, column] += sign * (axis[5] * x - axis[3] * z)
    rows[r + 2, column] += sign * (axis[3] * y - axis[4] * x)


@njit(cache=True, inline="always")
def _column(pose, c, out):
    """``out[3:6]``: column ``c`` of the rotation matrix of a pose."""
    x, y, z, s = pose[3], pose[4], pose[5], pose[6]
    if c == 0:
        out[3], out[4], out[5] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + z * s), 2.0 * (x * z - y * s)
    elif c == 1:
        out[3], out[4], out[5] = 2.0 * (x * y - z * s), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + x * s)
    else:
        out[3], out[4], out[5] = 2.0 * (x * z + y * s), 2.0 * (y * z - x * s), 1.0 - 2.0 * (x * x + y * y)


@njit(cache=True, inline="always")
def add_turn(tree, w, b, sign, rows, r):
    """Add ``sign`` times the Jacobian of the rotation of body ``b`` to three rows of ``rows``, from row ``r`` on."""
    axis = w.spare[0:6]
    while b > 0:
        first = tree.bodies[b, 1]
        for j in range(first, first + tree.bodies[b, 2]):
            kind, a = tree.joints[j, 0], tree.joints[j, 3]
            if kind == HINGE:
                for i in range(3):
                    rows[r + i, a] += sign * w.axes[j, 3 + i]
            elif kind != SLIDE:
                a += 3 if kind == FREE else 0
                for c in range(3):
                    _column(w.poses[b], c, axis)
                    for i in range(3):
                        rows[r + i, a + c] += sign * axis[3 + i]
        b = tree.bodies[b, 0]


@njit(cache=True)
def attitude_error(goal, quat, out):
    """``out`` (3,): rotation vector, in W, that takes the attitude ``goal`` to ``quat`` [rad]."""
    back, q = np.empty(4), np.empty(4)
    for i in range(3):
        back[i] = -goal[i]
    back[3] = goal[3]
    quat_mul(quat, back, q)
    rotation_vector(q, out)


@njit(cache=True)
def equations(tree, q, poses, values, w):
    """Residual and rows at ``q``, for tools at ``poses`` (nt, 7) and prescribed joints at ``values`` (np,); places become current."""
    place(tree, q, w)
    rows, residual = w.rows, w.residual
    rows[:] = 0.0
    r = _close_loops(tree, w)
    for k in range(tree.coupled.shape[0]):
        led, leads = tree.coupled[k, 0], tree.coupled[k, 1]
        c = tree.polynomial[k]
        x = q[tree.joints[leads, 2]] - tree.axes[leads, 6] if leads >= 0 else 0.0
        residual[r] = q[tree.joints[led, 2]] - tree.axes[led, 6] - (c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * c[4]))))
        rows[r, tree.joints[led, 3]] = 1.0
        if leads >= 0:
            rows[r, tree.joints[leads, 3]] = -(c[1] + x * (2.0 * c[2] + x * (3.0 * c[3] + 4.0 * x * c[4])))
        r += 1
    pose = w.spare[20:27]
    for t in range(tree.tools.shape[0]):
        tool_pose(tree, w, t, pose)
        add_point(tree, w, tree.tools[t], pose, 1.0, rows, r)
        add_turn(tree, w, tree.tools[t], 1.0, rows, r + 3)
        for i in range(3):
            residual[r + i] = pose[i] - poses[t, i]
        attitude_error(poses[t, 3:7], pose[3:7], residual[r + 3 : r + 6])
        r += 6
    for k in range(tree.prescribed.shape[0]):
        j = tree.prescribed[k]
        residual[r] = q[tree.joints[j, 2]] - values[k]
        rows[r, tree.joints[j, 3]] = 1.0
        r += 1


@njit(cache=True, inline="always")
def _close_loops(tree, w):
    """Residual and rows of the loops; returns how many rows they take."""
    ends, turns = w.spare[6:12].reshape((2, 3)), w.spare[12:20].reshape((2, 4))
    r = 0
    for k in range(tree.loops.shape[0]):
        for e in range(2):
            pose, frame = w.poses[tree.loops[k, 1 + e]], tree.loop_frames[k, e]
            rotate(pose[3:7], frame, ends[e])
            for i in range(3):
                ends[e, i] += pose[i]
            add_point(tree, w, tree.loops[k, 1 + e], ends[e], 1.0 - 2.0 * e, w.rows, r)
        for i in range(3):
            w.residual[r + i] = ends[0, i] - ends[1, i]
        r += 3
        if tree.loops[k, 0] == FRAME:
            for e in range(2):
                quat_mul(w.poses[tree.loops[k, 1 + e], 3:7], tree.loop_frames[k, e, 3:7], turns[e])
                add_turn(tree, w, tree.loops[k, 1 + e], 1.0 - 2.0 * e, w.rows, r)
            attitude_error(turns[1], turns[0], w.residual[r : r + 3])
            r += 3
    return r


@njit(cache=True)
def factor(tree, w):
    """Cholesky factor of A^T A over the unknown joints, into ``w.square`` (lower half), within its skyline.

    ``w.first[i]`` is the first column of row i that is not zero: a leg meets its own joints and the platform's alone, and Cholesky's method
    fills nothing in before it.
    """
    u, rows, square, first, filled = tree.unknown.shape[0], w.rows, w.square, w.first, w.filled
    for i in range(u):
        first[i] = i
        for j in range(i + 1):
            square[i, j] = 0.0
    for r in range(rows.shape[0]):
        count = 0
        for i in range(u):
            if rows[r, tree.unknown[i]] != 0.0:
                filled[count] = i
                count += 1
        for p in range(count):
            i = int(filled[p])
            x = rows[r, tree.unknown[i]]
            first[i] = min(first[i], filled[0])
            for q in range(p + 1):
                j = int(filled[q])
                square[i, j] += x * rows[r, tree.unknown[j]]
    most = 0.0
    for i in range(u):
        most = max(most, square[i, i])
    for i in range(u):
        square[i, i] += DAMPING * most
        begin = int(first[i])
        for j in range(begin, i + 1):
            total = square[i, j]
            for k in range(max(begin, int(first[j])), j):
                total -= square[i, k] * square[j, k]
            if i == j:
                square[i, i] = math.sqrt(max(total, DAMPING * DAMPING * most))
            else:
                square[i, j] = total / square[j, j]


@njit(cache=True)
def solve(tree, w, right, out):
    """``out`` (nv,): least-squares solution of A out = ``right`` (r,) over the unknown joints; the others are 0."""
    u, x, square, first = tree.unknown.shape[0], w.right, w.square, w.first
    for i in range(u):
        x[i] = 0.0
    for r in range(w.rows.shape[0]):
        if right[r] != 0.0:
            for i in range(u):
                x[i] += w.rows[r, tree.unknown[i]] * right[r]
    for i in range(u):
        total = x[i]
        for k in range(int(first[i]), i):
            total -= square[i, k] * x[k]
        x[i] = total / square[i, i]
    for i in range(u - 1, -1, -1):
        x[i] /= square[i, i]
        for k in range(int(first[i]), i):
            x[k] -= square[i, k] * x[i]
    out[:] = 0.0
    for i in range(u):
        out[tree.unknown[i]] = x[i]


@njit(cache=True)
def shift(tree, q, step, scale):
    """Move the joint positions ``q`` by ``scale`` times the rates ``step`` (nv,), as ``mj_integratePos`` does."""
    turn, quat, after, r = np.empty(4), np.empty(4), np.empty(4), np.empty(3)
    for j in range(tree.joints.shape[0]):
        kind, a, d = tree.joints[j, 0], tree.joints[j, 2], tree.joints[j, 3]
        if kind in (SLIDE, HINGE):
            q[a] += scale * step[d]
            continue
        if kind == FREE:
            for i in range(3):
                q[a + i] += scale * step[d + i]
            a, d = a + 3, d + 3
        for i in range(3):
            r[i] = scale * step[d + i]
            quat[i] = q[a + 1 + i]
        quat[3] = q[a]
        quat_exp(r, turn)
        quat_mul(quat, turn, after)
        quat_normalise(after)
        for i in range(3):
            q[a + 1 + i] = after[i]
        q[a] = after[3]


@njit(cache=True)
def newton(tree, q, poses, values, w, close, most):
    """Bring ``q`` (nq,) to tools at ``poses`` and prescribed joints at ``values``, in at most ``most`` steps.

    Returns the largest residual that is left. Rows and their factor are those before the last step, which is then below sqrt(close).
    """
    worst = math.inf
    for _ in range(most):
        equations(tree, q, poses, values, w)
        worst = 0.0
        for r in range(w.residual.shape[0]):
            worst = max(worst, abs(w.residual[r])) if math.isfinite(w.residual[r]) else math.inf
        factor(tree, w)
        if not close < worst < math.inf:
            break
        solve(tree, w, w.residual, w.step)
        longest = 0.0
        for d in range(w.step.shape[0]):
            longest = max(longest, abs(w.step[d]))
        shift(tree, q, w.step, -min(1.0, LONGEST_STEP / max(longest, 1e-300)))
        if longest < close:  # no step brings it nearer: out of reach
            break
        if worst * worst < close and longest * longest < close:  # what is left falls with the square
            worst = longest * longest
            break
    return worst


@njit(cache=True)
def rates(tree, w, twists, speeds, out):
    """``out`` (nv,): joint rates for the tools' ``twists`` (nt, 6) in W and the prescribed joints' ``speeds``, from current factors."""
    r = w.goal.shape[0] - 6 * twists.shape[0] - speeds.shape[0]
    w.goal[:r] = 0.0
    for t in range(twists.shape[0]):
        for i in range(6):
            w.goal[r + i] = twists[t, i]
        r += 6
    for k in range(speeds.shape[0]):
        w.goal[r + k] = speeds[k]
    solve(tree, w, w.goal, out)


@njit(cache=True)
def ways(tree, w, out):
    """``out`` (t, nv): joint rates for a unit rate of each task (tools' twists, prescribed joints), from current factors."""
    first = w.goal.shape[0] - out.shape[0]
    for t in range(out.shape[0]):
        w.goal[:] = 0.0
        w.goal[first + t] = 1.0
        solve(tree, w, w.goal, out[t])
