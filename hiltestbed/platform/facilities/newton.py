"""Newton's method on a tree with loops, compiled: joints from the poses of the tools, and rates
from their twists.

The unknown joints solve the loop closures, the commanded poses of the tools and the prescribed
joints simultaneously: residual r(q) = 0, with the Jacobian A of all rows. A step is q <- q - (A^T A
+ e)^-1 A^T r with e at round-off, which also handles redundant rows (a planar linkage closed in
space) and redundant joints (minimum norm for a seventh axis). Rates of the joints for given twists
of the tools are solved with the same matrix.
"""

from __future__ import annotations

import math

import numpy as np

from hiltestbed.compiled.jit import copied, njit
from hiltestbed.frames import quat_exp, quat_mul, quat_normalise, rotate, twist_between
from hiltestbed.platform.facilities.motion import place, tool_pose
from hiltestbed.platform.facilities.tree import FRAME, FREE, HINGE, SLIDE

DAMPING = 1e-11  # e, as a fraction of the largest diagonal term of A^T A
LONGEST_STEP = 0.2  # [m], [rad] of a joint in one iteration
CLOSE = 1e-10  # [m], [rad] the largest residual that counts as solved
ITERATIONS = 40


@njit(cache=True)
def add_rows(tree, w, b, point, sign, r, turns):
    """Add ``sign`` times the Jacobian of a point (3,) of body ``b`` to three rows of ``w.rows``
    from row ``r`` on, and, if it ``turns``, that of its rotation to the three after them.
    """
    axis = w.spare[0:6]
    while b > 0:
        first = tree.bodies[b, 1]
        for j in range(first, first + tree.bodies[b, 2]):
            kind, a = tree.joints[j, 0], tree.joints[j, 3]
            if kind == SLIDE:
                for i in range(3):
                    w.rows[r + i, a] += sign * w.axes[j, 3 + i]
            elif kind == HINGE:
                _add_axis(w.axes[j], point, sign, w.rows, r, a, turns)
            else:
                if kind == FREE:
                    for i in range(3):
                        w.rows[r + i, a + i] += sign
                    a += 3
                copied(w.axes[j, :3], axis[:3])
                for c in range(3):
                    axis[3] = axis[4] = axis[5] = 0.0
                    axis[3 + c] = 1.0
                    rotate(w.poses[b, 3:7], axis[3:6], axis[3:6])
                    _add_axis(axis, point, sign, w.rows, r, a + c, turns)
        b = tree.bodies[b, 0]


@njit(cache=True)
def _add_axis(axis, point, sign, rows, r, column, turns):
    x, y, z = point[0] - axis[0], point[1] - axis[1], point[2] - axis[2]
    rows[r, column] += sign * (axis[4] * z - axis[5] * y)
    rows[r + 1, column] += sign * (axis[5] * x - axis[3] * z)
    rows[r + 2, column] += sign * (axis[3] * y - axis[4] * x)
    if turns:
        for i in range(3):
            rows[r + 3 + i, column] += sign * axis[3 + i]


@njit(cache=True)
def equations(tree, q, poses, values, w):
    """Residual and rows at ``q``, for tools at ``poses`` (nt, 7) and prescribed joints at
    ``values`` (np,); updates the poses.
    """
    place(tree, q, w)
    rows, residual = w.rows, w.residual
    rows[:] = 0.0
    r = 0
    ends = w.spare[6:20].reshape((2, 7))
    for k in range(tree.loops.shape[0]):
        whole = tree.loops[k, 0] == FRAME
        for e in range(2):
            pose, frame = w.poses[tree.loops[k, 1 + e]], tree.loop_frames[k, e]
            rotate(pose[3:7], frame, ends[e])
            for i in range(3):
                ends[e, i] += pose[i]
            if whole:
                quat_mul(pose[3:7], frame[3:7], ends[e, 3:7])
            add_rows(tree, w, tree.loops[k, 1 + e], ends[e], 1.0 - 2.0 * e, r, whole)
        if whole:
            twist_between(ends[1], ends[0], 1.0, residual[r : r + 6])
        else:
            for i in range(3):
                residual[r + i] = ends[0, i] - ends[1, i]
        r += 6 if whole else 3
    for k in range(tree.coupled.shape[0]):
        led, leads = tree.coupled[k, 0], tree.coupled[k, 1]
        c = tree.polynomial[k]
        x = q[tree.joints[leads, 2]] - tree.axes[leads, 6] if leads >= 0 else 0.0
        residual[r] = (
            q[tree.joints[led, 2]]
            - tree.axes[led, 6]
            - (c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * c[4]))))
        )
        rows[r, tree.joints[led, 3]] = 1.0
        if leads >= 0:
            rows[r, tree.joints[leads, 3]] = -(
                c[1] + x * (2.0 * c[2] + x * (3.0 * c[3] + 4.0 * x * c[4]))
            )
        r += 1
    pose = w.spare[20:27]
    for t in range(tree.tools.shape[0]):
        tool_pose(tree, w, t, pose)
        add_rows(tree, w, tree.tools[t], pose, 1.0, r, True)
        twist_between(poses[t], pose, 1.0, residual[r : r + 6])
        r += 6
    for k in range(tree.prescribed.shape[0]):
        j = tree.prescribed[k]
        residual[r] = q[tree.joints[j, 2]] - values[k]
        rows[r, tree.joints[j, 3]] = 1.0
        r += 1


@njit(cache=True)
def factor(tree, w):
    """Cholesky factor of A^T A over the unknown joints, into ``w.square`` (lower half), within its
    skyline.

    ``w.first[i]`` is the first nonzero column of row i: a leg is coupled only to its own joints and
    the platform's, and the Cholesky factor has no fill-in before it.
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
    """``out`` (nv,): least squares A out = ``right`` (r,) over the unknown joints; others are 0."""
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
    """Move the positions ``q`` by ``scale`` times the rates ``step``, as ``mj_integratePos``."""
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
    """Solve for ``q`` (nq,) with tools at ``poses`` and prescribed joints at ``values``, in at most
    ``most`` steps.

    Returns the largest remaining residual. Rows and factor are those before the last step, which is
    below sqrt(close) on convergence.
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
        if longest < close:  # no further progress: out of reach
            break
        # quadratic convergence: the residual after this step
        if worst * worst < close and longest * longest < close:
            worst = longest * longest
            break
    return worst


@njit(cache=True)
def rates(tree, w, twists, speeds, out):
    """``out`` (nv,): rates for the tools' ``twists`` and prescribed ``speeds``, once factored."""
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
    """``out`` (t, nv): joint rates per unit rate of each task, from the current factor."""
    first = w.goal.shape[0] - out.shape[0]
    for t in range(out.shape[0]):
        w.goal[:] = 0.0
        w.goal[first + t] = 1.0
        solve(tree, w, w.goal, out[t])
