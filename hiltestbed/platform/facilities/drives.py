"""Drives of `n` runs of a facility: from the commanded relative pose to the input of each actuator,
step by step.

A tick: ``aim`` solves for the joints at the command and plans the references over the tick;
``push`` is called before every physics step with the current state, and writes the actuators'
inputs; ``observe`` reads poses and joints from the state. The control law of a drive is defined by
the subclass.

The relative pose is that of A in P. If the passive side is fixed, P is W, and one tool follows the
command. A facility that moves both sides overrides the kernel of :meth:`Drives.allocate`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call, Joined, bound, together
from hiltestbed.compiled.jit import njit
from hiltestbed.contact.wrench import relate_one
from hiltestbed.errors import InputError
from hiltestbed.frames import Array, pose_step
from hiltestbed.platform.divergence import has_diverged
from hiltestbed.platform.facilities.inverse_dynamics import drive_forces, joint_forces, weights
from hiltestbed.platform.facilities.kinematics import Kinematics
from hiltestbed.platform.facilities.motion import (
    move,
    packed,
    place,
    scratch,
    tool_pose,
    tool_twist,
    unpack,
)
from hiltestbed.platform.facilities.newton import newton, rates, shift, ways
from hiltestbed.platform.facilities.reference import Cycles, TickPlan, plan_tick, sample
from hiltestbed.platform.friction import DriveFriction

# Newton steps per tick; one suffices for motion, the others are for a command that jumps
PER_TICK = 3
SOLVED = 1e-9  # [m], [rad] tolerance of the solution
# controller cycles between two updates of the weight, which changes by less than 1e-3 of itself
# meanwhile
WEIGHED = 4
UPRIGHT = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


class Targets(NamedTuple):
    """What the joints of n runs are solved for, and the solution.

    Attributes:
        axes: (2, J) addresses of the driven joints in positions and rates. gravity: (3,) [m/s^2].
        poses, twists: (n, nt, 7), (n, nt, 6) of the tools in W. held, held_rates: (n, np)
            prescribed joints.
        qs, rates: (n, nq), (n, nv) the last solution. load: (n, J) gravity load on the drives [N,
            N m]. missed: (n,) residual [m, rad].
    """

    axes: NDArray[np.int64]
    gravity: Array
    poses: Array
    twists: Array
    held: Array
    held_rates: Array
    qs: Array
    rates: Array
    load: Array
    missed: Array


class PortMotion(NamedTuple):
    """Poses (n, 7) and twists (n, 6) of A and P in W, and those of A relative to P, in P."""

    place_A: Array
    motion_A: Array
    place_P: Array
    motion_P: Array
    pose: Array
    twist: Array


_CYCLES, _TARGETS = len(Cycles._fields), len(Cycles._fields) + len(Targets._fields)
_PORTS = len(PortMotion._fields)


@njit(cache=True)
def _aim(integers, numbers, room, *given):
    """Plan a tick; at the start of a cycle solve for joints, rates and weights.

    integers, numbers, room: the tree (:func:`hiltestbed.platform.facilities.motion.packed`). given:
        the fields of Cycles, Targets and TickPlan.
    """
    cycles, targets, plan = (
        Cycles(*given[:_CYCLES]),
        Targets(*given[_CYCLES:_TARGETS]),
        TickPlan(*given[_TARGETS:]),
    )
    tree, w = unpack(integers, numbers, room)
    k = plan.ticks[0]
    for i in range(targets.poses.shape[0]):
        if k < 0 or k % cycles.length[i] == 0:
            _solve(tree, w, cycles, targets, plan, i)
            if k >= 0:
                sample(cycles, plan, i)
        if k >= 0:
            plan_tick(cycles, plan, i)
    if k >= 0:
        plan.ticks[0] = k + 1


@njit(cache=True)
def _solve(tree, w, cycles, targets, plan, i):
    """One run at the start of a cycle: joints, their rates, and every few cycles the weight."""
    k, cycle, axes = plan.ticks[0], cycles.length[i], targets.axes
    q, rate, poses, held = targets.qs[i], targets.rates[i], targets.poses[i], targets.held[i]
    if k >= 0:
        shift(tree, q, rate, cycles.tick * cycle)
    targets.missed[i] = newton(tree, q, poses, held, w, SOLVED, PER_TICK)
    rates(tree, w, targets.twists[i], targets.held_rates[i], rate)
    for j in range(plan.goal.shape[1]):
        plan.goal[i, j] = q[axes[0, j]]
        plan.leave[i, j] = rate[axes[1, j]]
    if k < 0 or (k // cycle) % WEIGHED == 0:
        joints, nv = plan.goal.shape[1], tree.armature.shape[0]
        every, forces = np.empty((6 * poses.shape[0] + held.shape[0], nv)), np.empty(nv)
        square, right = np.empty((joints, joints)), np.empty(joints)
        ways(tree, w, every)
        weights(tree, targets.gravity, w, forces)
        drive_forces(every, axes[1], forces, square, right, targets.load[i])


@njit(cache=True)
def _follow(pose, twist, accel, half, poses, twists):
    for i in range(pose.shape[0]):
        for c in range(7):
            poses[i, 0, c] = pose[i, c]
        for c in range(6):
            twists[i, 0, c] = twist[i, c] + half * accel[i, c]


@njit(cache=True)
def _less(a, b, out):
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            out[i, j] = a[i, j] - b[j]


@njit(cache=True)
def _observe(integers, numbers, room, axes, home, qpos, qvel, limit, diverged, *given):
    """Read ports and driven joints; given: the fields of PortMotion, joints, joint rates (n, J)."""
    sides = PortMotion(*given[:_PORTS])
    joints, rate = given[_PORTS:]
    tree, w = unpack(integers, numbers, room)
    lost = False
    for i in range(qpos.shape[0]):
        if diverged[i]:
            continue
        if has_diverged(qpos[i], qvel[i], limit):
            diverged[i] = True
            lost = True
            continue
        read_ports(tree, w, qpos[i], qvel[i], sides, i)
        for j in range(home.shape[0]):
            joints[i, j] = qpos[i, axes[0, j]] - home[j]
            rate[i, j] = qvel[i, axes[1, j]]
    return lost


@njit(cache=True)
def read_ports(tree, w, q, v, sides, i):
    """Write the sides of run ``i`` at the joints ``q`` (nq,) with rates ``v`` (nv,); with one tool
    P is W.
    """
    place(tree, q, w)
    move(tree, v, w)
    tool_pose(tree, w, 0, sides.place_A[i])
    tool_twist(tree, w, 0, sides.motion_A[i])
    if tree.tools.shape[0] == 1:
        sides.pose[i] = sides.place_A[i]
        sides.twist[i] = sides.motion_A[i]
        return
    tool_pose(tree, w, 1, sides.place_P[i])
    tool_twist(tree, w, 1, sides.motion_P[i])
    relate_one(
        sides.place_A[i],
        sides.motion_A[i],
        sides.place_P[i],
        sides.motion_P[i],
        sides.pose[i],
        sides.twist[i],
        np.empty((1, 3)),
    )


def ports_at_home(n: int) -> PortMotion:
    """PortMotion of n runs at home."""
    poses = [np.tile(UPRIGHT, (n, 1)) for _ in range(3)]
    twists = [np.zeros((n, 6)) for _ in range(3)]
    return PortMotion(poses[0], twists[0], poses[1], twists[1], poses[2], twists[2])


class _Pushed:
    """The arrays of the last call of ``push``, and the compiled call bound to them."""

    __slots__ = ("call", "ctrl", "friction", "qpos", "qvel")

    def __init__(self) -> None:
        self.qpos: Array | None = None
        self.qvel: Array | None = None
        self.ctrl: Array | None = None
        self.friction: DriveFriction | None = None
        self.call: Any = None


class Drives:
    """References and inputs of the drives of `n` runs, and joint readings; all arrays are updated
    in place.

    Attributes, at t_k:
        pose, twist: (n, 7), (n, 6) of A relative to P, in P. place_A, motion_A, place_P, motion_P:
            of both in W; all in sides.
        joints, joint_rates: (n, J) actual, from home. reference: (n, J) commanded, from home.
        missed: (n,) distance by which the last command was out of the facility's reach [m, rad].
        load: (n, J) gravity load on the drives at the command [N, N m]; both in targets.
        cycles, plan: of the controller, and its references.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        kinematics: Kinematics,
        tick: float,
        substeps: int,
        settings: Sequence[Any],
        feed: NDArray[np.bool_],
    ) -> None:
        """Args: settings: (n,) of each run's platform, with the path of its commands. feed: (n,)
        feed-forward.
        """
        n, joints = len(feed), len(kinematics.axes)
        self.kinematics, self.tick, self.step = kinematics, tick, tick / substeps
        self.model = model
        self.cycles = Cycles(
            tick,
            np.array([s.command.cycle(1.0 / tick) for s in settings], dtype=np.int64),
            np.array([s.command.delay_cycles for s in settings], dtype=np.int64),
            np.asarray(feed, dtype=bool),
        )
        self._axes, self._home = np.array([kinematics.q, kinematics.v]), kinematics.joints_home
        tools, held = len(kinematics.tools), len(kinematics.prescribed)
        self.targets = Targets(
            axes=self._axes,
            gravity=np.array(model.opt.gravity, dtype=float),
            poses=np.tile(UPRIGHT, (n, tools, 1)),
            twists=np.zeros((n, tools, 6)),
            held=np.tile(kinematics.held_home, (n, 1)),
            held_rates=np.zeros((n, held)),
            qs=np.tile(kinematics.home, (n, 1)),
            rates=np.zeros((n, model.nv)),
            load=np.zeros((n, joints)),
            missed=np.zeros(n),
        )
        self.plan = TickPlan(
            ticks=np.zeros(1, dtype=np.int64),
            goal=np.tile(self._home, (n, 1)),
            leave=np.zeros((n, joints)),
            ring=np.zeros((n, int(self.cycles.late.max(initial=0)) + 1, 2, joints)),
            span=np.zeros((n, 2, 2, joints)),
            reference=np.tile(self._home, (n, 1)),
            velocity=np.zeros((n, joints)),
            steps=np.zeros((n, substeps, 3, joints)),
        )
        self.poses, self.twists = self.targets.poses, self.targets.twists
        self.held, self.held_rates = self.targets.held, self.targets.held_rates
        self.load, self.missed = self.targets.load, self.targets.missed
        self._start, self._unaccelerated = np.tile(UPRIGHT, (n, 1)), np.zeros((n, 6))
        self.sides = sides = ports_at_home(n)
        self.place_A, self.motion_A, self.place_P, self.motion_P, self.pose, self.twist = sides
        self.joints, self.joint_rates, self.reference = (
            np.zeros((n, joints)),
            np.zeros((n, joints)),
            np.zeros((n, joints)),
        )
        self._friction: DriveFriction | None = None
        self._last = _Pushed()
        self._inputs = drive_inputs(model, [axis.joint for axis in kinematics.axes])

    @property
    def solution(self) -> Array:
        """(n, nq) joint positions of the last solution."""
        return self.targets.qs

    # Methods overridden by a facility that moves both sides or has other drives.

    @cached_property
    def _allocated(self) -> Call:
        """The kernel of :meth:`allocate`: pose, twist, accel, half, and the arrays it writes."""
        return Call(_follow, GIVEN, GIVEN, GIVEN, ..., self.poses, self.twists)

    def push(self, sub: int, qpos: Array, qvel: Array, ctrl: Array) -> None:
        """Write the drives' inputs to ``ctrl`` (n, nu) for step ``sub`` of the tick, from the
        current joint state.
        """
        raise NotImplementedError

    def pushing(self, push: Call, qpos: Array, qvel: Array, ctrl: Array) -> Callable[[int], None]:
        """``push`` and the friction of the drives, bound to reused state arrays, as one call with
        the step's number.
        """
        last = self._last
        if (
            last.qpos is not qpos
            or last.qvel is not qvel
            or last.ctrl is not ctrl
            or last.friction is not self._friction
        ):
            last.qpos, last.qvel, last.ctrl, last.friction = qpos, qvel, ctrl, self._friction
            alone = push.on(qpos, qvel, ctrl)
            last.call = (
                together(alone, self._friction.acting(qvel, ctrl)) if self._friction else alone
            )
        return last.call

    def rest(self, qpos: Array, qvel: Array) -> None:
        """Initialise the drives' own state for uniform motion; ``qpos`` (n, nq) may deflect under
        the weight.
        """

    def feedback(self) -> Array:
        """``(n, k)`` view of the drives' own state that depends on the motion of the rig; none: (n,
        0).
        """
        return np.zeros((len(self.pose), 0))

    # Methods common to all drives.

    def allocate(self, pose: Array, twist: Array, accel: Array, half: float) -> None:
        """Write ``poses`` and ``twists`` of the tools in W (and the prescribed joints) for the
        relative ``pose`` (n, 7) and the velocity ``half`` [s] after ``twist`` (n, 6), with
        ``accel`` (n, 6).
        """
        self._allocated.on(pose, twist, accel)(half)

    def settle(self, pose: Array, twist: Array, qpos: Array, qvel: Array) -> None:
        """Initialise joints, references and drives in a uniform motion with ``twist`` (n, 6) whose
        command is at ``pose`` (n, 7): the facility is behind by the controller's lag.

        Raises:
            InputError: a start that is out of reach, beyond a joint's travel, or singular.
        """
        lag = self.lag
        for i in range(len(pose)):
            pose_step(pose[i], twist[i], -lag[i], self._start[i])
        self.allocate(self._start, twist, self._unaccelerated, 0.0)
        for i in range(len(pose)):
            found = self.kinematics.complaints(self.poses[i], self.held[i])
            if found:
                raise InputError("the start cannot be: " + "; ".join(found))
            qpos[i], qvel[i] = self.kinematics.motion(
                self.poses[i], self.twists[i], self.held[i], self.held_rates[i]
            )
            self.targets.qs[i] = qpos[i]
        self._solve_alone()
        self.plan.reference[:], self.plan.velocity[:] = (
            self.plan.goal,
            np.where(self.cycles.feed[:, None], self.plan.leave, 0.0),
        )
        self.plan.span[:, :, 0], self.plan.span[:, :, 1] = (
            self.plan.goal[:, None],
            self.plan.leave[:, None],
        )
        for back in range(1, self.plan.ring.shape[1]):  # commands that are still delayed
            ahead = self.tick * self.cycles.length * (self.cycles.late + 1 - back)
            self.plan.ring[:, -back % self.plan.ring.shape[1], 0] = (
                self.plan.goal + self.plan.leave * ahead[:, None]
            )
            self.plan.ring[:, -back % self.plan.ring.shape[1], 1] = self.plan.leave
        self.rest(qpos, qvel)
        self.arrive()

    @property
    def lag(self) -> Array:
        """(n,) lag of each run's controller [s]: its cycle less the tick at whose end a pose is
        due, plus the delay in whole cycles.
        """
        return np.asarray(
            self.tick * (self.cycles.length * (self.cycles.late + 1) - 1), dtype=float
        )

    @cached_property
    def _solve(self) -> Callable[[], None]:
        """The plan of a tick, once the tools' poses and twists are written."""
        flat = packed(self.kinematics.tree)
        return bound(_aim, *flat, *self.cycles, *self.targets, *self.plan)

    def _solve_alone(self) -> None:
        """Joints and rates at the tools' poses and twists, without a plan."""
        self.plan.ticks[0] = -1
        self._solve()
        self.plan.ticks[0] = 0

    def aim(self, pose_cmd: Array, twist_cmd: Array, accel_cmd: Array) -> None:
        """Plan one tick; ``pose_cmd`` (n, 7) is commanded for its end, with ``twist_cmd`` and
        ``accel_cmd`` (n, 6), all in P.

        The velocity at the command is that of the tick plus half a tick of its acceleration: a
        semi-implicit velocity belongs to the middle of its tick.
        """
        self._aimed.on(pose_cmd, twist_cmd, accel_cmd)(0.5 * self.tick)

    @cached_property
    def _aimed(self) -> Joined:
        return Joined(lambda *command: [self._allocated.on(*command), self._solve])

    def follow(self, pose: Array, twist: Array) -> None:
        """Joints and their rates for A at ``pose`` (n, 7) with ``twist`` (n, 6) under exact
        tracking, without drives.
        """
        self.allocate(pose, twist, self._unaccelerated, 0.0)
        self._solve_alone()
        np.subtract(self.plan.goal, self._home, out=self.joints)
        self.joint_rates[:], self.reference[:] = self.plan.leave, self.joints

    def arrive(self) -> None:
        """Complete the tick."""
        self._arrived()

    @cached_property
    def _arrived(self) -> Callable[[], None]:
        return bound(_less, self.plan.reference, self._home, self.reference)

    @cached_property
    def _seen(self) -> Call:
        return Call(
            _observe,
            *packed(self.kinematics.tree.towards_tools()),
            self._axes,
            self._home,
            *(GIVEN,) * 4,
            *self.sides,
            self.joints,
            self.joint_rates,
        )

    def observe(self, qpos: Array, qvel: Array, limit: float, diverged: NDArray[np.bool_]) -> bool:
        """Read poses, twists and joints; returns whether a run just exceeded ``limit`` [m/s,
        rad/s], and marks it in ``diverged`` (n,).
        """
        return self.observing(qpos, qvel, limit, diverged)()

    def observing(
        self, qpos: Array, qvel: Array, limit: float, diverged: NDArray[np.bool_]
    ) -> Callable[[], bool]:
        """:meth:`observe` bound to arrays that are reused."""
        return self._seen.on(qpos, qvel, limit, diverged)

    def release(self) -> None:
        """Switch off the drives' friction and encoder quantisation, so that measurements are
        linear.
        """
        self._friction = None

    def state(self) -> dict[str, NDArray[Any]]:
        """The arrays of the state between two ticks; restoring them resumes the drives from
        there.
        """
        solved = {"qs": self.targets.qs, "rates": self.targets.rates, "load": self.targets.load}
        return self.plan._asdict() | solved | (self._friction.state() if self._friction else {})

    def mass_matrix(self) -> Array:
        """``(J, J)`` [kg, kg m, kg m^2] mass matrix at the drives, at home: loops closed, by
        virtual work.
        """
        return mass_matrix(self.kinematics, self.model)


def mass_matrix(kinematics: Kinematics, model: mujoco.MjModel) -> Array:
    """``(J, J)``: forces of the driven joints for a unit acceleration of each, at home, without
    gravity or velocities.
    """
    tree, w, home = kinematics.tree, scratch(kinematics.tree), kinematics.home
    newton(tree, home.copy(), kinematics.home_poses, kinematics.held_home, w, SOLVED, 1)
    every = np.zeros((6 * len(kinematics.tools) + len(kinematics.prescribed), model.nv))
    ways(tree, w, every)
    # (J, nv): rates of all joints per unit rate of a driven joint
    reach = np.linalg.pinv(every[:, kinematics.v]) @ every
    forces, none = np.empty((len(reach), model.nv)), np.zeros(3)
    for j, way in enumerate(reach):
        joint_forces(tree, np.zeros(model.nv), np.ascontiguousarray(way), none, w, forces[j])
    return reach @ forces.T


def drive_inputs(model: mujoco.MjModel, joints: Sequence[str]) -> NDArray[np.int64]:
    """``(J,)`` index of the actuator on each joint. Raises InputError for a joint without one."""
    found = []
    for name in joints:
        joint = model.joint(name).id
        acts = np.flatnonzero(
            (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT)
            & (model.actuator_trnid[:, 0] == joint)
        )
        if not len(acts):
            raise InputError(
                f"joint {name!r} has no actuator, but is a driven joint of the facility"
            )
        found.append(int(acts[0]))
    return np.array(found, dtype=np.int64)
