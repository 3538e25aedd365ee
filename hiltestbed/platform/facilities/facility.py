"""The interface of a facility: base class of every kind of motion platform.

A facility is made from its settings, a section of the scenario. It gives the plant a model,
kinematics and drives; the plant uses neither its name nor its joints. In W, the world of the
composed model, z points along the insertion and the origin is the nominal position of the passive
port P; at home the site `mount`, which carries the active mechanism, is at :data:`MOUNT_HOME`, with
W's attitude.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from hiltestbed.config.models import load
from hiltestbed.contact.mount import CARRIER
from hiltestbed.frames import Array
from hiltestbed.platform.facilities.drives import Drives
from hiltestbed.platform.facilities.kinematics import Axis, Kinematics
from hiltestbed.platform.facilities.tree import compose, inverse_pose

MOUNT = "mount"
NOMINAL = "P_nominal"  # site on the carrier of the passive mechanism, at the nominal pose of P
# a docking mechanism is 0.60 m tall: A is then at P
MOUNT_HOME = np.array([0.0, 0.0, -0.60, 0.0, 0.0, 0.0, 1.0])
UPRIGHT = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
TOOL_HOME = np.array([0.0, 0.0, 0.60, 0.0, 0.0, 0.0, 1.0])  # pose of A in the mount
SENSOR_HEIGHT = 0.76  # [m] of the sensor's flange over P


@dataclass(frozen=True)
class Response:
    """Nominal response of a facility to its command, for each of the axes x, y, z, rx, ry, rz.

    Attributes:
        bandwidth: (6,) [Hz] natural frequency of the second-order system that is closest at low
            frequency. damping_ratio: (6,).
        delay: pure delay [s]: command delay and controller's cycle.
        followed: whether feed-forward removes the lag of the second-order system.
    """

    bandwidth: tuple[float, ...]
    damping_ratio: tuple[float, ...]
    delay: float
    followed: bool = False

    def late(self, axis: int = 2) -> float:
        """Delay at low frequency [s]: 2 zeta/w of the second order, and the pure delay."""
        if self.followed or math.isinf(self.bandwidth[axis]):
            return self.delay
        return self.delay + 2.0 * self.damping_ratio[axis] / (2.0 * math.pi * self.bandwidth[axis])

    def at(self, frequency: float, axis: int = 2) -> complex:
        """Complex ratio of reached to commanded at a frequency [Hz]."""
        s = 2j * math.pi * frequency
        w = 2.0 * math.pi * self.bandwidth[axis]
        lag = (
            1.0
            if self.followed or math.isinf(w)
            else w * w / (s * s + 2.0 * self.damping_ratio[axis] * w * s + w * w)
        )
        return complex(lag * np.exp(-s * self.delay))


class Facility(ABC):
    """A motion platform with its drives.

    Attributes:
        settings: its section of the scenario. moves_passive: whether its passive side moves as
            well. physical: whether freely moving bodies replace the numerical model
            (:class:`hiltestbed.platform.facilities.bodies.Bodies`).
    """

    moves_passive: ClassVar[bool] = False
    physical: ClassVar[bool] = False

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
    def drives(
        self,
        model: mujoco.MjModel,
        settings: Sequence[Any],
        tick: float,
        substeps: int,
        feed: NDArray[np.bool_],
        tool: str = MOUNT,
    ) -> Drives:
        """Drives of runs whose ``settings`` may differ in parameters; ``tool`` is the site that
        follows the command (A, or the mount).
        """

    @abstractmethod
    def response(self, rate: float, feed: bool) -> Response:
        """Nominal response in a loop of ``rate`` [Hz], with or without feed-forward of velocity and
        acceleration.
        """

    def kinematics(self, model: mujoco.MjModel, tool: str = MOUNT) -> Kinematics:
        """Geometry of a compiled model that contains the facility; ``tool`` is the site that
        follows the command.
        """
        return Kinematics(model, [tool], self.axes)

    def alike(self) -> Hashable:
        """Everything that the model depends on, which must be equal in the runs of one batch."""
        return self.kind

    def problems(self, rate: float) -> Iterator[tuple[tuple[str | int, ...], str]]:
        """Settings that are invalid in a loop of ``rate`` [Hz]: path below the settings,
        message.
        """
        yield from self.settings.command.problems(rate)

    @cached_property
    def bare(self) -> Kinematics:
        """Geometry of the facility without a mechanism, for checks before a run."""
        return self.kinematics(compiled(self.spec()))

    def complaints(self, pose: Array, tool: Array = TOOL_HOME) -> list[str]:
        """Why the facility cannot bring A to ``pose`` (7,) in P; ``tool`` (7,) is the pose of A in
        the mount. Empty: it can.
        """
        return self.bare.complaints(compose(np.asarray(pose, dtype=float), inverse_pose(tool)))


def frame_of(spec: mujoco.MjSpec) -> None:
    """Add the shipped frame, with the force sensor's flange, over a facility that stands below
    P.
    """
    spec.attach(load("frame/frame"), prefix="frame_", frame=spec.worldbody.add_frame())


def add_carrier(body: Any, pose: Array = UPRIGHT) -> None:
    """Add the carrier of the passive side to ``body`` of a specification, at ``pose`` (7,) in
    it.
    """
    quat = [pose[6], *pose[3:6]]
    body.add_body(name=CARRIER, pos=pose[:3], quat=quat).add_site(name=NOMINAL)


def compiled(spec: mujoco.MjSpec, timestep: float = 2.5e-4) -> mujoco.MjModel:
    """The model of a specification as the plant would step it: without purely visual parts, loops
    as stiff as possible.
    """
    spec.compiler.discardvisual = True
    spec.option.timestep = timestep
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.option.disableflags |= (
        mujoco.mjtDisableBit.mjDSBL_ISLAND | mujoco.mjtDisableBit.mjDSBL_AUTORESET
    )
    stiffen(spec, timestep)
    return spec.compile()


LOOPS = (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD, mujoco.mjtEq.mjEQ_JOINT)


def stiffen(spec: mujoco.MjSpec, timestep: float) -> None:
    """Give the joints that close loops a time constant of two steps, the stiffest that MuJoCo
    allows.
    """
    for joint in spec.equalities:
        if joint.type in LOOPS:
            joint.solref[:] = [2.0 * timestep, 1.0]


def per_run(settings: Sequence[Any], name: str) -> Array:
    """``(n,)`` one parameter of each run's settings, by its dotted name."""
    out = []
    for s in settings:
        value = s
        for part in name.split("."):
            value = getattr(value, part)
        out.append(value)
    return np.array(out, dtype=float)


def friction_law(settings: Sequence[Any], section: str, share: Sequence[float]) -> Array | None:
    """``(n, J, 5)`` laws of the drives' friction (:class:`hiltestbed.platform.friction.
    DriveFriction`) from the ``section`` of each run's settings, with forces scaled by ``share``
    (J,); None if no run has any.
    """
    names = ("coulomb", "stiction", "stribeck_speed", "viscous")
    given = np.stack([per_run(settings, f"{section}.{name}") for name in names], axis=-1)
    if not given[:, [0, 1, 3]].any():
        return None
    law = np.zeros((len(settings), len(share), 5))
    scale = np.array(share)[:, None]
    law[:, :, :4] = given[:, None, :] * np.where([True, True, False, True], scale, 1.0)
    return law
