"""Kinematics of a facility: from poses of its tools to its joints and back, for batches, and checks
of reach, travel and singularities.

Every facility solves the same equations (:mod:`hiltestbed.platform.facilities.newton`): tools at
their poses, loops closed. A pose far from home is reached along a straight path in steps, so that
the solution stays on the branch (elbow, wrist, legs) of home.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from hiltestbed.compiled.jit import Seldom, interpreted
from hiltestbed.frames import Array, pose_step, twist_between
from hiltestbed.platform.facilities.motion import move, place, scratch, tool_pose, tool_twist
from hiltestbed.platform.facilities.newton import CLOSE, ITERATIONS, equations, newton, rates
from hiltestbed.platform.facilities.tree import HINGE, SLIDE, build_tree

STRIDE = 0.05  # [m], [rad] step of a tool between two solutions on the way to a far pose
# largest number of steps of a path; longer paths, which are linear or out of reach anyway, have
# longer steps
MOST_STRIDES = 10_000
LEVER = 0.5  # [m] scales a rotation to a length: half the height of a docking mechanism
# [m/s] a direction in which the drives at full speed move the tool less than this is singular
SLOWEST = 0.02
# largest ratio of the fastest direction to the middle one, and of the middle one to the slowest,
# that is not singular
LOOSEST = 100.0
# prefixes of joints of the attached mechanisms, not of the facility
MECHANISMS = ("active_", "passive_", "mount_")
# in the loop, kernels call these
_place, _move, _tool_pose, _tool_twist = map(Seldom, (place, move, tool_pose, tool_twist))
_equations, _newton, _rates = map(Seldom, (equations, newton, rates))
AXES = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True)
class Axis:
    """One driven joint.

    Attributes:
        joint: its name in the model. unit: "m" or "rad". low, high: travel [unit], as joint
            positions. speed [unit/s], acceleration [unit/s^2], force [N or N m]: the drive's
            limits.
    """

    joint: str
    unit: str
    low: float
    high: float
    speed: float
    acceleration: float
    force: float


class Kinematics:
    """A facility's geometry, read from its compiled model at home.

    Attributes:
        home: (nq,) joint positions. axes: the driven joints. q, v: (J,) their addresses.
            joints_home: (J,) at home.
        tools: names of the sites whose poses are commanded.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        tools: Sequence[str],
        axes: Sequence[Axis],
        locked: Sequence[str] = (),
        prescribed: Sequence[str] = (),
        home: Array | None = None,
    ) -> None:
        """Args: locked: joints that do not move (a gear's deflection), besides those of the
        mechanisms. prescribed: driven joints whose values are given (a rail).
        """
        every = [model.joint(j).name for j in range(model.njnt)]
        locked = [*locked, *(name for name in every if name.startswith(MECHANISMS))]
        self.axes, self.tools, self.prescribed = tuple(axes), tuple(tools), tuple(prescribed)
        self.tree = build_tree(model, tools, prescribed, locked)
        names = [axis.joint for axis in axes]
        self._forward = build_tree(model, (), names, locked)
        self._work, self._forward_work = scratch(self.tree), scratch(self._forward)
        joints = [model.joint(name) for name in names]
        self.q = np.array([int(j.qposadr[0]) for j in joints], dtype=np.int64)
        self.v = np.array([int(j.dofadr[0]) for j in joints], dtype=np.int64)
        self.home = np.array(model.qpos0 if home is None else home, dtype=float)
        self.joints_home = self.home[self.q]
        self._held = np.array(
            [int(model.joint(name).qposadr[0]) for name in prescribed], dtype=np.int64
        )
        self._travel = list(_travels(model, axes, locked))
        self._names = [every[j] or f"joint {j}" for j in model.dof_jntid]

    @cached_property
    def home_poses(self) -> Array:
        """(nt, 7) poses of the tools in W at home."""
        return self.poses(self.home)

    @property
    def held_home(self) -> Array:
        """(np,) values of the prescribed joints at home."""
        return self.home[self._held]

    def poses(self, q: Array) -> Array:
        """``(nt, 7)`` poses of the tools in W at the joint positions ``q`` (nq,)."""
        out = np.empty((len(self.tools), 7))
        _place(self.tree, np.ascontiguousarray(q, dtype=float), self._work)
        for t in range(len(out)):
            _tool_pose(self.tree, self._work, t, out[t])
        return out

    def twists(self, q: Array, v: Array) -> Array:
        """``(nt, 6)`` twists of the tools in W at positions ``q`` (nq,) and rates ``v`` (nv,)."""
        out = np.empty((len(self.tools), 6))
        _place(self.tree, np.ascontiguousarray(q, dtype=float), self._work)
        _move(self.tree, np.ascontiguousarray(v, dtype=float), self._work)
        for t in range(len(out)):
            _tool_twist(self.tree, self._work, t, out[t])
        return out

    def solve(
        self, poses: Array, held: Array | None = None, start: Array | None = None
    ) -> tuple[Array, float]:
        """Joint positions ``(nq,)`` that put the tools at ``poses`` (nt, 7) in W, and the remaining
        residual [m, rad].

        Follows a straight path from ``start`` (home), with prescribed joints moving to ``held``
        (np,) along with it. If a part of the path cannot be reached, the joints are those of the
        last point reached.
        """
        q = (self.home if start is None else start).copy()
        goal = np.ascontiguousarray(np.atleast_2d(poses), dtype=float)
        values = self.held_home if held is None else np.asarray(held, dtype=float)
        begin, begin_values = self.poses(q), q[self._held]
        twists = np.empty((len(goal), 6))
        for t in range(len(goal)):
            interpreted(twist_between)(begin[t], goal[t], 1.0, twists[t])
        span = max(
            float(np.abs(twists).max(initial=0.0)),
            float(np.abs(values - begin_values).max(initial=0.0)),
        )
        steps, worst = max(1, math.ceil(min(span / STRIDE, MOST_STRIDES))), 0.0
        at = np.empty_like(goal)
        for s in range(1, steps + 1):
            for t in range(len(goal)):
                interpreted(pose_step)(begin[t], twists[t], s / steps, at[t])
            if s == steps:
                at[:] = goal
            before = q.copy()
            held_now = begin_values + (values - begin_values) * (s / steps)
            worst = _newton(self.tree, q, at, held_now, self._work, CLOSE, ITERATIONS)
            if not worst < 1e3 * CLOSE:
                return before, worst
        return q, worst

    def nearest(self, poses: Array) -> tuple[Array, float]:
        """Joints ``(nq,)`` closest to ``poses`` (nt, 7), from home, and the residual [m, rad]."""
        q, goal = self.home.copy(), np.ascontiguousarray(poses, dtype=float)
        return q, _newton(self.tree, q, goal, self.held_home, self._work, CLOSE, ITERATIONS)

    def closed(self, q: Array) -> Array:
        """Joints ``(nq,)`` near ``q`` with loops closed and the driven joints of ``q``."""
        out, work = q.copy(), self._forward_work
        for close, most in ((CLOSE, ITERATIONS), (0.0, 1)):  # the last step is down to rounding
            _newton(self._forward, out, np.empty((0, 7)), q[self.q], work, close, most)
        return out

    def following(self, q: Array, speeds: Array) -> Array:
        """Joint rates ``(nv,)`` for rates (J,) of the driven joints, at ``q`` (nq,) with closed
        loops.
        """
        tree, work = self._forward, self._forward_work
        _equations(tree, q.copy(), np.empty((0, 7)), q[self.q], work)
        work.goal[:] = 0.0
        work.goal[-len(speeds) :] = speeds
        out = np.zeros(len(tree.armature))
        rows = work.rows[:, tree.unknown]
        out[tree.unknown] = np.linalg.lstsq(rows, work.goal, rcond=None)[0]
        return out

    def rates(self, q: Array, twists: Array, held: Array | None = None) -> Array:
        """Joint rates ``(nv,)`` for twists ``(nt, 6)`` of the tools in W, at solved ``q`` (nq,)."""
        out = np.empty(len(self.tree.armature))
        _newton(self.tree, q.copy(), self.poses(q), q[self._held], self._work, CLOSE, 1)
        _rates(
            self.tree,
            self._work,
            np.atleast_2d(twists),
            np.zeros(len(self._held)) if held is None else held,
            out,
        )
        return out

    def motion(
        self, poses: Array, twists: Array, held: Array, held_rates: Array
    ) -> tuple[Array, Array]:
        """Joint positions ``(nq,)`` and rates ``(nv,)`` for tools at ``poses`` (nt, 7) that move
        with ``twists`` (nt, 6) in W, and the prescribed joints (np,).
        """
        q, _ = self.solve(poses, held)
        return q, self.rates(q, twists, held_rates)

    def jacobian(self, q: Array) -> tuple[Array, Array]:
        """Twist of the tools in W per unit rate of the driven joints, ``(6 nt, J)``, and free
        motions that no drive controls, ``(nv, f)``.

        With N the motions that the loops allow (null space of their rows): twists = J N
        (N_driven)^+; the motions of N without motion of the driven joints are free.
        """
        _equations(self.tree, q.copy(), self.poses(q), q[self._held], self._work)
        rows = self._work.rows[:, self.tree.unknown]
        count = len(rows) - 6 * len(self.tools) - len(self._held)
        allowed = _null_space(rows[:count])
        driven = allowed[np.searchsorted(self.tree.unknown, self.v)]
        left = allowed @ _null_space(driven)
        moves = np.linalg.norm(rows[count : count + 6 * len(self.tools)] @ left, axis=0)
        left = left[:, moves > 1e-9]  # only free motions that move the tools matter
        free = np.zeros((len(self.tree.armature), left.shape[1]))
        free[self.tree.unknown] = left
        return rows[count : count + 6 * len(self.tools)] @ allowed @ np.linalg.pinv(
            driven, rcond=1e-9
        ), free

    def allowed(self, q: Array) -> Array:
        """``(nv, f)`` orthonormal basis of all rates that keep the loops closed at ``q`` (nq,)."""
        _equations(self.tree, q.copy(), self.poses(q), q[self._held], self._work)
        count = len(self._work.rows) - 6 * len(self.tools) - len(self._held)
        return _null_space(self._work.rows[:count])

    def lost_motion(self, q: Array) -> str | None:
        """The motions of the first tool that the drives cannot produce, or one that they cannot
        resist.
        """
        twists, free = self.jacobian(q)
        if free.shape[1]:
            joint = self._names[int(np.argmax(np.abs(free[:, 0])))]
            loose = f"{joint!r} is neither driven nor constrained by a loop"
            return f"{loose}, so the tool can move freely"
        scaled = twists[:6] * np.array([axis.speed for axis in self.axes])
        scaled[3:] *= LEVER
        left, values, _ = np.linalg.svd(scaled)
        values = np.concatenate([values, np.zeros(6 - len(values))])
        middle = math.sqrt(values[2] * values[3])
        least = SLOWEST
        if middle > 0.0:
            least = max(least, middle / max(LOOSEST, values[0] / middle))
        if lost := [direction(left[:, i]) for i in np.flatnonzero(values < least)]:
            return f"no motion {' or '.join(dict.fromkeys(lost))}"
        if values[0] > LOOSEST * middle:
            return f"no stiffness {direction(left[:, 0])}"
        return None

    def complaints(self, poses: Array, held: Array | None = None) -> list[str]:
        """Why tools cannot be at ``poses`` (nt, 7): reach, travel, singularity. Empty: they can."""
        poses = np.atleast_2d(poses)
        q, left = self.solve(poses, held)
        if not left < 1e3 * CLOSE:
            return [self._unreached(poses, q)]
        found = self.past_travel(q)
        lost = self.lost_motion(q)
        return [*found, f"singular: {lost} at {pose_in_words(self.poses(q)[0])}"] if lost else found

    def past_travel(self, q: Array) -> list[str]:
        """The joints beyond their travel at the positions ``q`` (nq,), as messages."""
        found = []
        for name, address, low, high, turns in self._travel:
            if not low <= q[address] <= high:
                scale, unit = (math.degrees(1.0), "deg") if turns else (1.0, "m")
                found.append(
                    f"joint {name} would be at {q[address] * scale:.4g} {unit}; "
                    f"its travel is {low * scale:.4g} to {high * scale:.4g} {unit}"
                )
        return found

    def _unreached(self, poses: Array, q: Array) -> str:
        reached = self.poses(q)
        t = int(np.argmax(np.linalg.norm(np.atleast_2d(poses)[:, :3] - reached[:, :3], axis=1)))
        return (
            f"out of reach: {self.tools[t]} cannot be at {pose_in_words(np.atleast_2d(poses)[t])}; "
            f"on the way there it gets to {pose_in_words(reached[t])}"
        )


def _travels(
    model: mujoco.MjModel, axes: Sequence[Axis], locked: Sequence[str]
) -> Iterator[tuple[str, int, float, float, bool]]:
    """Name, address, travel, whether it rotates: driven joints, then others with a range."""
    for axis in axes:
        address = int(model.joint(axis.joint).qposadr[0])
        yield axis.joint, address, axis.low, axis.high, axis.unit == "rad"
    others = {*(axis.joint for axis in axes), *locked}
    for j in range(model.njnt):
        joint, (low, high), kind = model.joint(j), model.jnt_range[j], int(model.jnt_type[j])
        if joint.name not in others and low < high and kind in (SLIDE, HINGE):
            yield joint.name, int(joint.qposadr[0]), float(low), float(high), kind == HINGE


def _null_space(rows: Array) -> Array:
    """Orthonormal columns that span the null space of the rows."""
    if not len(rows):
        return np.eye(rows.shape[1])
    _, values, right = np.linalg.svd(rows)
    rank = int(np.count_nonzero(values > 1e-8 * max(values[0], 1e-300)))
    return right[rank:].T


def pose_in_words(pose: Array) -> str:
    """A pose in words [m], [deg]."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_quat(pose[3:7]).as_rotvec(degrees=True)
    return (
        f"({', '.join(f'{x:.3f}' for x in pose[:3])}) m, rotated by "
        f"({', '.join(f'{x:.1f}' for x in turn)}) deg"
    )


def direction(twist: Array) -> str:
    """A direction (6,) in words: the axes that contribute 95 % of its square."""
    share = np.asarray(twist, dtype=float) ** 2
    order = np.argsort(-share)
    count = int(np.searchsorted(np.cumsum(share[order]), 0.95 * share.sum())) + 1
    if count == 1:
        k = int(order[0])
        return f"{'along' if k < 3 else 'about'} {'xyz'[k % 3]}"
    parts = [f"{np.sign(twist[order[0]]) * twist[k]:+.2f} {AXES[k]}" for k in order[:count]]
    return "in the direction " + " ".join(parts)
