"""The interface of a facility: base class of every kind of motion platform.

A facility is made from its settings, a section of the scenario. It gives the plant a model,
kinematics and drives; the plant uses neither its name nor its joints. In W, the world of the
composed model, z points along the insertion and the origin is the nominal position of the passive
port P; at home the site `mount`, which carries the active mechanism, is at :data:`MOUNT_HOME`, with
W's attitude.

What an acceleration takes of the drives (:func:`force_shares`): joint accelerations a that move the
tool and keep the loops closed satisfy J a = (tool, 0). The drives' forces f, the loads r in locked
joints and l in the loops then satisfy M a = S' f + L' r + C' l (R. Featherstone, Rigid Body
Dynamics Algorithms, 2008, equation 8.6), S, L and C the rows of the Jacobian of driven joints,
locked joints and loops.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Hashable
from functools import cached_property
from typing import Any, ClassVar

import mujoco
import numpy as np

from hiltestbed.config.models import load
from hiltestbed.contact.mount import CARRIER
from hiltestbed.frames import Array
from hiltestbed.platform.facilities.kinematics import Axis, Kinematics
from hiltestbed.platform.facilities.mover import Mover, Runs
from hiltestbed.platform.facilities.tree import compose, inverse_pose

MOUNT = "mount"
NOMINAL = "P_nominal"  # site on the carrier of the passive mechanism, at the nominal pose of P
# a docking mechanism is 0.60 m tall: A is then at P
MOUNT_HOME = np.array([0.0, 0.0, -0.60, 0.0, 0.0, 0.0, 1.0])
UPRIGHT = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
TOOL_HOME = np.array([0.0, 0.0, 0.60, 0.0, 0.0, 0.0, 1.0])  # pose of A in the mount
SENSOR_HEIGHT = 0.76  # [m] of the sensor's flange over P


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
    def _bare_model(self) -> mujoco.MjModel:
        return compiled(self.spec())

    @cached_property
    def bare(self) -> Kinematics:
        """Geometry of the facility without a mechanism, for checks before a run."""
        return self.kinematics(self._bare_model)

    @cached_property
    def force_shares(self) -> Array:
        """``(J, 6)`` share of the drives' forces that an acceleration of the mount takes, see
        :func:`hiltestbed.platform.facilities.facility.force_shares`.
        """
        return force_shares(self._bare_model, self.bare)

    def complaints(self, pose: Array, tool: Array = TOOL_HOME) -> list[str]:
        """Why the facility cannot bring A to ``pose`` (7,) in P; ``tool`` (7,) is the pose of A in
        the mount. Empty: it can.
        """
        return self.bare.complaints(compose(np.asarray(pose, dtype=float), inverse_pose(tool)))


def frame_of(spec: mujoco.MjSpec) -> None:
    """Add the frame with the force sensor's flange over a facility that stands below P."""
    spec.attach(load("frame/frame"), prefix="frame_", frame=spec.worldbody.add_frame())


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


def force_shares(model: mujoco.MjModel, kinematics: Kinematics) -> Array:
    """``(J, 6)`` share of each drive's force, beyond its load at rest, that a unit acceleration of
    the first tool takes at home, in W [s^2/m, s^2/rad]; 1 is all that the drive has.

    Springs (the deflection of gears) and prescribed joints (a rail) are locked.
    """
    data = mujoco.MjData(model)
    data.qpos = kinematics.home
    jacobian = model.opt.jacobian
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    mujoco.mj_forward(model, data)
    model.opt.jacobian = jacobian
    tool = np.zeros((6, model.nv))
    mujoco.mj_jacSite(model, data, tool[:3], tool[3:], model.site(kinematics.tools[0]).id)
    closed = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    loops = data.efc_J.reshape(-1, model.nv)[closed]
    held = [model.joint(name).id for name in kinematics.prescribed]
    locked = np.isin(model.dof_jntid, [*held, *np.flatnonzero(model.jnt_stiffness)])
    rows = np.eye(model.nv)
    fixed = np.vstack([rows[locked], loops])
    rates = np.linalg.pinv(np.vstack([tool, fixed]))[:, :6]
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    free = ~locked[kinematics.v]
    driven, most = kinematics.v[free], np.array([axis.force for axis in kinematics.axes])[free]
    forces = np.linalg.pinv(np.vstack([rows[driven], fixed]).T)[: len(driven)]
    weight = forces @ (data.qfrc_bias - data.qfrc_gravcomp)
    # a drive that cannot hold the weight has nothing left
    left = np.maximum(most - np.abs(weight), np.finfo(float).eps * most)
    return forces @ mass @ rates / left[:, None]
