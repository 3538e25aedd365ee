"""The interface of a facility: base class of every kind of motion platform.

A facility is made from its settings, a section of the scenario. It gives the plant a model,
kinematics and drives; the plant uses neither its name nor its joints. In W, the world of the
composed model, z points along the insertion and the origin is the nominal position of the passive
port P; at home the site `mount`, which carries the active mechanism, is at :data:`MOUNT_HOME`, with
W's attitude.
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

    @property
    def tool_shares(self) -> tuple[float, ...]:
        """Share of the relative motion near the touch that each tool of the kinematics performs."""
        return (1.0,)

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
