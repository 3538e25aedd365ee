"""The interface of a facility: base class of every kind of motion platform.

A facility is made from its settings, a section of the scenario. It gives the plant a model,
kinematics and drives; the plant uses neither its name nor its joints. In W, the world of the
composed model, z points along the insertion and the origin is the nominal position of the passive
port P; at home the site `mount`, which carries the active mechanism, is at :data:`MOUNT_HOME`, with
W's attitude.

What moves the ports of `n` runs, drives that follow commands or bodies that move freely, is a
:class:`Mover`; both are read in the same way.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Sequence
from functools import cached_property
from operator import attrgetter
from typing import Any, ClassVar, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.config.models import load
from hiltestbed.contact.mount import CARRIER
from hiltestbed.contact.wrench import relate_one
from hiltestbed.frames import Array
from hiltestbed.platform.facilities.kinematics import Axis, Kinematics
from hiltestbed.platform.facilities.motion import move, place, scratch, tool_pose, tool_twist
from hiltestbed.platform.facilities.tree import compose, inverse_pose

MOUNT = "mount"
NOMINAL = "P_nominal"  # site on the carrier of the passive mechanism, at the nominal pose of P
# a docking mechanism is 0.60 m tall: A is then at P
MOUNT_HOME = np.array([0.0, 0.0, -0.60, 0.0, 0.0, 0.0, 1.0])
UPRIGHT = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
TOOL_HOME = np.array([0.0, 0.0, 0.60, 0.0, 0.0, 0.0, 1.0])  # pose of A in the mount
SENSOR_HEIGHT = 0.76  # [m] of the sensor's flange over P


class Runs(NamedTuple):
    """`n` runs on one compiled model.

    Attributes:
        tick: of the loop [s]. substeps: physics steps per tick. settings: (n,) of each run's
            platform. feed: (n,) bool, feed-forward of velocity and acceleration.
    """

    tick: float
    substeps: int
    settings: Sequence[Any]
    feed: NDArray[np.bool_]

    @property
    def step(self) -> float:
        """Of the physics [s]."""
        return self.tick / self.substeps

    def numbers(self, name: str) -> Array:
        """``(n,)`` one parameter of each run's settings, by its dotted name."""
        return np.array([attrgetter(name)(s) for s in self.settings], dtype=float)


class PortMotion(NamedTuple):
    """Poses (n, 7) and twists (n, 6) of A and P in W, and those of A relative to P, in P, which are
    the same arrays as those of A in W if P is W.
    """

    place_A: Array
    motion_A: Array
    place_P: Array
    motion_P: Array
    pose: Array
    twist: Array


class Mover:
    """The moving ports of `n` runs; all arrays are updated in place.

    Attributes, at t_k:
        pose, twist: (n, 7), (n, 6) of A relative to P, in P. place_A, motion_A, place_P, motion_P:
            of both in W; all in sides.
        joints, joint_rates: (n, J) of the driven joints, actual, from home. reference: (n, J)
            commanded, from home.
        missed: (n,) distance by which the last command was out of the facility's reach [m, rad].
        axes: (2, J) addresses of the driven joints' positions and rates.
    """

    writes: ClassVar[str] = "ctrl"  # field of MuJoCo's data that `push` writes

    def __init__(self, model: mujoco.MjModel, kinematics: Kinematics, runs: Runs) -> None:
        n, joints = len(runs.settings), len(kinematics.axes)
        self.model, self.kinematics, self.runs = model, kinematics, runs
        moved = [(np.tile(UPRIGHT, (n, 1)), np.zeros((n, 6))) for _ in range(3)]
        if len(kinematics.tools) == 1:
            moved[2] = moved[0]
        self.sides = PortMotion(*(x for side in moved for x in side))
        self.place_A, self.motion_A, self.place_P, self.motion_P, self.pose, self.twist = self.sides
        self.joints, self.joint_rates, self.reference = (np.zeros((n, joints)) for _ in range(3))
        self.missed = np.zeros(n)
        self.axes = np.array([kinematics.q, kinematics.v])

    def settle(self, pose: Array, twist: Array, qpos: Array, qvel: Array) -> None:
        """Initialise joints and drives in a uniform motion of A through ``pose`` (n, 7) with
        ``twist`` (n, 6). Raises InputError for a start that cannot be.
        """
        raise NotImplementedError

    def aim(self, pose_cmd: Array, twist_cmd: Array, accel_cmd: Array) -> None:
        """Plan one tick; nothing commands bodies that move freely."""

    def push(self, sub: int, qpos: Array, qvel: Array, inputs: Array) -> None:
        """Write the inputs of step ``sub`` of the tick, from the current joint state."""
        raise NotImplementedError

    def arrive(self) -> None:
        """Complete the tick."""

    @cached_property
    def _seen(self) -> Call:
        tree = self.kinematics.tree.towards_tools()
        readings = self.axes, self.kinematics.joints_home, self.joints, self.joint_rates
        return Call(_observe, tree, scratch(tree), readings, self.sides, *(GIVEN,) * 4)

    def observing(
        self, qpos: Array, qvel: Array, limit: float, diverged: NDArray[np.bool_]
    ) -> Callable[[], bool]:
        """Call that reads poses, twists and joints, bound to arrays that are reused; it returns
        whether a run has just exceeded ``limit`` [m/s, rad/s], and marks it in ``diverged`` (n,).
        """
        return self._seen.on(qpos, qvel, limit, diverged)


@njit(cache=True)
def _observe(tree, w, readings, sides, qpos, qvel, limit, diverged):
    """With one tool P is W. A run has diverged if a joint rate reaches ``limit``, or a position or
    rate is not finite.
    """
    (axes, home, joints, rates), speed, lost = readings, np.empty((1, 3)), False
    for i in range(qpos.shape[0]):
        bounded = not diverged[i]
        for rate in qvel[i]:
            bounded = bounded and abs(rate) < limit  # false of NaN too
        for position in qpos[i]:
            bounded = bounded and math.isfinite(position)
        if not bounded:
            lost = lost or not diverged[i]
            diverged[i] = True
            continue
        place_A, motion_A = sides.place_A[i], sides.motion_A[i]
        place(tree, qpos[i], w)
        move(tree, qvel[i], w)
        tool_pose(tree, w, 0, place_A)
        tool_twist(tree, w, 0, motion_A)
        if tree.tools.shape[0] > 1:
            place_P, motion_P = sides.place_P[i], sides.motion_P[i]
            tool_pose(tree, w, 1, place_P)
            tool_twist(tree, w, 1, motion_P)
            pose, twist = sides.pose[i], sides.twist[i]
            relate_one(place_A, motion_A, place_P, motion_P, pose, twist, speed)
        for j in range(home.shape[0]):
            joints[i, j] = qpos[i, axes[0, j]] - home[j]
            rates[i, j] = qvel[i, axes[1, j]]
    return lost


class Facility(ABC):
    """A motion platform with its drives.

    Attributes:
        settings: its section of the scenario. moves_passive: whether its passive side moves as
            well.
    """

    moves_passive: ClassVar[bool] = False

    def __init__(self, settings: Any) -> None:
        self.settings = settings

    @property
    def kind(self) -> str:
        """Its name in a scenario."""
        return self.settings.kind

    @property
    @abstractmethod
    def axes(self) -> tuple[Axis, ...]:
        """The driven joints, with travel and limits."""

    @abstractmethod
    def spec(self) -> mujoco.MjSpec:
        """A new specification of the facility at home: site :data:`MOUNT`, body :data:`CARRIER`
        with site :data:`NOMINAL`, gravity, and a motor or position actuator on every driven joint.
        The plant sets the time step and the stiffness of loops.
        """

    @abstractmethod
    def drives(self, model: mujoco.MjModel, runs: Runs, tool: str = MOUNT) -> Mover:
        """Drives, or bodies that move freely, of runs whose settings may differ in parameters;
        ``tool`` is the site that follows the command (A, or the mount).
        """

    @abstractmethod
    def bandwidth(self) -> float:
        """Nominal [Hz]: of the second order closest at low frequency, along the insertion."""

    def kinematics(self, model: mujoco.MjModel, tool: str = MOUNT) -> Kinematics:
        """Geometry of a compiled model; ``tool`` is the site that follows the command."""
        return Kinematics(model, [tool], self.axes)

    def alike(self) -> Hashable:
        """Everything that the model depends on, which must be equal in the runs of one batch."""
        return self.kind

    @cached_property
    def bare(self) -> Kinematics:
        """Geometry of the facility without a mechanism, for checks before a run."""
        return self.kinematics(compiled(self.spec()))

    @property
    def tool_shares(self) -> tuple[float, ...]:
        """Share of the relative motion near the touch that each tool of the kinematics performs."""
        return (1.0,)

    def complaints(self, pose: Array, tool: Array = TOOL_HOME) -> list[str]:
        """Why the facility cannot bring A to ``pose`` (7,) in P; ``tool`` (7,) is the pose of A in
        the mount. Empty: it can.
        """
        return self.bare.complaints(compose(np.asarray(pose, dtype=float), inverse_pose(tool)))


def standing(name: str) -> mujoco.MjSpec:
    """The specification ``name`` of a facility that stands below P, with a fixed passive side on
    the flange of the force sensor, in a frame over it.
    """
    spec = load(name)
    spec.attach(load("frame/frame"), prefix="frame_", frame=spec.worldbody.add_frame())
    add_carrier(spec.worldbody)
    spec.option.gravity = [0.0, 0.0, -9.81]
    return spec


def add_carrier(body: Any, pose: Array = UPRIGHT) -> None:
    """Add the carrier of the passive side to a ``body``, at ``pose`` (7,) in it."""
    quat = [pose[6], *pose[3:6]]
    body.add_body(name=CARRIER, pos=pose[:3], quat=quat).add_site(name=NOMINAL)


def compiled(spec: mujoco.MjSpec, timestep: float = 2.5e-4) -> mujoco.MjModel:
    """The model as the plant would step it: no purely visual parts, loops as stiff as possible."""
    spec.compiler.discardvisual = True
    set_steps(spec, timestep)
    return spec.compile()


def set_steps(spec: mujoco.MjSpec, timestep: float) -> None:
    """Set how a specification is stepped, and give the constraints that close loops a time constant
    of two steps, the stiffest that MuJoCo allows.
    """
    option = spec.option
    option.timestep, option.integrator = timestep, mujoco.mjtIntegrator.mjINT_EULER
    # there is one island: the search for more costs a tenth of a step; a diverging run stops
    # instead of being reset silently
    option.disableflags |= (
        mujoco.mjtDisableBit.mjDSBL_ISLAND | mujoco.mjtDisableBit.mjDSBL_AUTORESET
    )
    for joint in spec.equalities:
        if joint.type in LOOPS:
            joint.solref[:] = [2.0 * timestep, 1.0]


LOOPS = (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD, mujoco.mjtEq.mjEQ_JOINT)
