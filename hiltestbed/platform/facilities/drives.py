"""Drives of `n` runs of a facility: from the commanded relative pose to the input of each actuator,
step by step.

A tick: ``aim`` solves for the joints at the command and plans the references over the tick;
``push`` is called before every physics step with the current state, and writes the actuators'
inputs. The control law of a drive is defined by the subclass.

The relative pose is that of A in P. If the passive side is fixed, P is W, and one tool follows the
command. A facility that moves both sides overrides :meth:`Drives.allocate`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.bound import Call, bound
from hiltestbed.compiled.jit import interpreted, njit
from hiltestbed.errors import InputError
from hiltestbed.frames import Array, pose_step
from hiltestbed.platform.facilities.facility import UPRIGHT, Mover, Runs
from hiltestbed.platform.facilities.kinematics import Kinematics
from hiltestbed.platform.facilities.motion import drive_forces, scratch, weights
from hiltestbed.platform.facilities.newton import newton, rates, shift, ways
from hiltestbed.platform.facilities.reference import TickPlan, plan_tick, sample
from hiltestbed.platform.friction import DriveFriction

# Newton steps per tick; one suffices for motion, the others are for a command that jumps
PER_TICK = 3
SOLVED = 1e-9  # [m], [rad] tolerance of the solution
# controller cycles between two updates of the weight, which changes by less than 1e-3 of itself
# meanwhile
WEIGHED = 4


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


@njit(cache=True)
def _aim(tree, w, targets, plan):
    """Plan a tick; at the start of a cycle solve for joints and rates, every few cycles weights."""
    k, axes, joints, nv = plan.ticks[0], targets.axes, plan.goal.shape[1], targets.rates.shape[1]
    tasks = 6 * targets.poses.shape[1] + targets.held.shape[1]
    every, forces, square = np.empty((tasks, nv)), np.empty(nv), np.empty((joints, joints))
    for i in range(targets.poses.shape[0]):
        cycle = plan.length[i]
        if k < 0 or k % cycle == 0:
            q, rate = targets.qs[i], targets.rates[i]
            if k >= 0:
                shift(tree, q, rate, plan.tick * cycle)
            targets.missed[i] = newton(
                tree, q, targets.poses[i], targets.held[i], w, SOLVED, PER_TICK
            )
            rates(tree, w, targets.twists[i], targets.held_rates[i], rate)
            for j in range(joints):
                plan.goal[i, j] = q[axes[0, j]]
                plan.leave[i, j] = rate[axes[1, j]]
            if k < 0 or (k // cycle) % WEIGHED == 0:
                ways(tree, w, every)
                weights(tree, targets.gravity, w, forces)
                drive_forces(every, axes[1], forces, square, targets.load[i])
            if k >= 0:
                sample(plan, i)
        if k >= 0:
            plan_tick(plan, i)
    if k >= 0:
        plan.ticks[0] = k + 1


class Drives(Mover):
    """References and inputs of the drives of `n` runs; all arrays are updated in place.

    Attributes, at t_k:
        load: (n, J) gravity load on the drives at the command [N, N m]; in targets.
        plan: the controller's references.
        encoder: (n,) resolution of the encoders.
    """

    def __init__(self, model: mujoco.MjModel, kinematics: Kinematics, runs: Runs) -> None:
        super().__init__(model, kinematics, runs)
        n, joints = self.joints.shape
        self.tick, self.step = runs.tick, runs.step
        commands = [s.command for s in runs.settings]
        self._home = kinematics.joints_home
        tools, held = len(kinematics.tools), len(kinematics.prescribed)
        self.targets = Targets(
            axes=self.axes,
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
        late = np.array([c.delay_cycles for c in commands], dtype=np.int64)
        self.plan = TickPlan(
            tick=runs.tick,
            length=np.array([c.cycle(1.0 / runs.tick) for c in commands], dtype=np.int64),
            late=late,
            feed=np.asarray(runs.feed, dtype=bool),
            ticks=np.zeros(1, dtype=np.int64),
            goal=np.tile(self._home, (n, 1)),
            leave=np.zeros((n, joints)),
            ring=np.zeros((n, int(late.max(initial=0)) + 1, 2, joints)),
            span=np.zeros((n, 2, 2, joints)),
            reference=np.tile(self._home, (n, 1)),
            velocity=np.zeros((n, joints)),
            steps=np.zeros((n, runs.substeps, 3, joints)),
        )
        self.poses, self.twists = self.targets.poses, self.targets.twists
        self.held, self.held_rates = self.targets.held, self.targets.held_rates
        self.load, self.missed = self.targets.load, self.targets.missed
        self._start, self._unaccelerated = np.tile(UPRIGHT, (n, 1)), np.zeros((n, 6))
        self.encoder: Array = np.zeros(n)
        self._friction: DriveFriction | None = None
        self._inputs = drive_inputs(model, [axis.joint for axis in kinematics.axes])

    @property
    def solution(self) -> Array:
        """(n, nq) joint positions of the last solution."""
        return self.targets.qs

    # What a subclass gives: the law of its drives, and their own state if they have one.

    # kernel that writes the inputs: the number of the step, qpos, qvel, ctrl
    _pushed: Call

    def rest(self, qpos: Array, qvel: Array) -> None:
        """Initialise the drives' own state; ``qpos`` (n, nq) may deflect under the weight."""
        if self._friction:
            self._friction.settle(qvel)

    def feedback(self) -> Array:
        """``(n, k)`` view of the drives' own state that depends on the rig's motion, if any."""
        return np.zeros((len(self.pose), 0))

    def rub(
        self,
        law: Sequence[tuple[float, ...]],
        presliding: float,
        moved: Array | float,
        share: Sequence[float] = (1.0,),
    ) -> None:
        """Let friction act on the drives.

        Args:
            law: (n, 5) of each run's drives (:class:`hiltestbed.platform.friction.DriveFriction`).
            presliding: stiffness before break-away. moved: smallest mass that a drive moves, (J,)
                or of all.
            share: (J,) factor of forces and stiffness of each drive.
        """
        laws, part = np.array(law), np.broadcast_to(share, len(self._inputs))
        if laws[:, [0, 1, 3]].any():
            scaled = np.where([True, True, False, True, False], part[:, None], 1.0)
            self._friction = DriveFriction(
                laws[:, None] * scaled,
                presliding * part,
                moved,
                self.axes[1],
                self._inputs,
                self.step,
            )

    # What is common to all drives.

    def push(self, sub: int, qpos: Array, qvel: Array, inputs: Array) -> None:
        self._pushed.on(qpos, qvel, inputs)(sub)
        if self._friction is not None:
            self._friction.act(qvel, inputs)

    def release(self) -> None:
        """Switch off friction and encoder quantisation, so that measurements are linear."""
        self._friction, self.encoder[:] = None, 0.0

    def allocate(self, pose: Array, twist: Array, accel: Array, half: float) -> None:
        """Write ``poses`` and ``twists`` of the tools in W (and the prescribed joints) for the
        relative ``pose`` (n, 7) and the velocity ``half`` [s] after ``twist`` (n, 6), with
        ``accel`` (n, 6).
        """
        self.poses[:, 0], self.twists[:, 0] = pose, twist + half * accel

    def settle(self, pose: Array, twist: Array, qpos: Array, qvel: Array) -> None:
        """Initialise joints, references and drives in a uniform motion with ``twist`` (n, 6) whose
        command is at ``pose`` (n, 7): the facility is behind by the controller's lag.

        Raises:
            InputError: a start that is out of reach, beyond a joint's travel, or singular.
        """
        lag = self.lag
        for i in range(len(pose)):
            interpreted(pose_step)(pose[i], twist[i], -lag[i], self._start[i])
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
        plan = self.plan
        plan.reference[:] = plan.goal
        plan.velocity[:] = np.where(plan.feed[:, None], plan.leave, 0.0)
        plan.span[:, :, 0], plan.span[:, :, 1] = plan.goal[:, None], plan.leave[:, None]
        slots = plan.ring.shape[1]
        for back in range(1, slots):  # commands that are still delayed
            ahead = self.tick * plan.length * (plan.late + 1 - back)
            plan.ring[:, -back % slots, 0] = plan.goal + plan.leave * ahead[:, None]
            plan.ring[:, -back % slots, 1] = plan.leave
        self.rest(qpos, qvel)
        self.arrive()

    @property
    def lag(self) -> Array:
        """(n,) lag of each controller [s]: its cycle less a tick, and its delay in cycles."""
        plan = self.plan
        return np.asarray(self.tick * (plan.length * (plan.late + 1) - 1), dtype=float)

    @cached_property
    def _solve(self) -> Callable[[], None]:
        """The plan of a tick, once the tools' poses and twists are written."""
        tree = self.kinematics.tree
        return bound(_aim, tree, scratch(tree), self.targets, self.plan)

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
        self.allocate(pose_cmd, twist_cmd, accel_cmd, 0.5 * self.tick)
        self._solve()

    def follow(self, pose: Array, twist: Array) -> None:
        """Joints for A at ``pose`` (n, 7) with ``twist`` (n, 6) under exact tracking."""
        self.allocate(pose, twist, self._unaccelerated, 0.0)
        self._solve_alone()
        np.subtract(self.plan.goal, self._home, out=self.joints)
        self.joint_rates[:], self.reference[:] = self.plan.leave, self.joints

    def arrive(self) -> None:
        np.subtract(self.plan.reference, self._home, out=self.reference)


def mass_matrix(kinematics: Kinematics, model: mujoco.MjModel) -> Array:
    """``(J, J)``: forces of the driven joints per unit acceleration of each, at home."""
    tree, w, home = kinematics.tree, scratch(kinematics.tree), kinematics.home
    interpreted(newton)(
        tree, home.copy(), kinematics.home_poses, kinematics.held_home, w, SOLVED, 1
    )
    every = np.zeros((6 * len(kinematics.tools) + len(kinematics.prescribed), model.nv))
    interpreted(ways)(tree, w, every)
    # (J, nv): rates of all joints per unit rate of a driven joint
    reach = np.linalg.pinv(every[:, kinematics.v]) @ every
    data, mass = mujoco.MjData(model), np.empty((model.nv, model.nv))
    data.qpos[:] = home
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass)
    return reach @ mass @ reach.T


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
