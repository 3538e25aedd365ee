"""A six-axis industrial arm that carries the active docking mechanism on its flange.

Commands go to the controller at its own rate, are interpolated there, and take effect whole cycles
later; each joint has a motor, an elastic gear, a link and friction
(:mod:`hiltestbed.platform.facilities.elastic_joint`).
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from hiltestbed.config.models import load
from hiltestbed.frames import Array
from hiltestbed.platform.facilities.drives import Drives, drive_inputs
from hiltestbed.platform.facilities.elastic_joint import ElasticJoints
from hiltestbed.platform.facilities.facility import (
    MOUNT,
    Facility,
    Response,
    add_carrier,
    frame_of,
    friction_law,
    per_run,
)
from hiltestbed.platform.facilities.kinematics import Axis, Kinematics
from hiltestbed.platform.friction import DriveFriction
from hiltestbed.platform.shipped.serial_arm import SerialArmSettings

# Travel and speed of KR 210 R2700 extra as in the public description of the ROS-Industrial project;
# torque and acceleration: estimates.
TRAVEL_DEG = ((-185, 185), (-140, -5), (-120, 155), (-350, 350), (-125, 125), (-350, 350))
SPEED_DEG = (123, 115, 112, 179, 172, 219)  # [deg/s]
TORQUE = (15e3, 20e3, 12e3, 3e3, 3e3, 1.8e3)  # [N m]
ACCELERATION = (5.0, 5.0, 6.0, 10.0, 10.0, 12.0)  # [rad/s^2]
# friction relative to the first axis, in the ratio of the torques
FRICTION_SHARE = (1.0, 1.2, 0.8, 0.2, 0.2, 0.12)
PRESLIDING = 3.0e6  # [N m/rad] of the motor's bearings and seals, at the joint


def arm_axes(prefix: str = "") -> tuple[Axis, ...]:
    """The six axes of one arm."""
    travel, speed = np.radians(TRAVEL_DEG), np.radians(SPEED_DEG)
    return tuple(
        Axis(
            f"{prefix}a{j + 1}",
            "rad",
            float(travel[j, 0]),
            float(travel[j, 1]),
            float(speed[j]),
            ACCELERATION[j],
            TORQUE[j],
        )
        for j in range(6)
    )


def pose_arm(spec: mujoco.MjSpec, angles: Array) -> None:
    """Set the reference configuration of an arm's specification, its home, to the motor angles
    ``angles`` (6,) [rad].
    """
    for j, angle in enumerate(angles):
        joint, rotor = spec.joint(f"a{j + 1}"), spec.body(f"rotor_{j + 1}")
        half = 0.5 * float(angle)
        rotor.quat = [math.cos(half), *(math.sin(half) * np.array(joint.axis))]
        joint.ref = float(angle)


def arm_friction(
    model: mujoco.MjModel,
    settings: Sequence[Any],
    axes: Sequence[Axis],
    step: float,
    share: Sequence[float],
) -> DriveFriction | None:
    """Friction of the motors of every run, None if no run has any; ``share`` (J,) relative to the
    first axis.
    """
    law = friction_law(settings, "controller.friction", share)
    if law is None:
        return None
    names = [axis.joint for axis in axes]
    dofs = np.array([int(model.joint(name).dofadr[0]) for name in names])
    return DriveFriction(
        law,
        PRESLIDING * np.array(share),
        model.dof_armature[dofs],
        dofs,
        drive_inputs(model, names),
        step,
    )


class SerialArm(Facility):
    """The arm of ``models/serial_arm``, which stands on the floor beside the frame."""

    settings: SerialArmSettings

    @property
    def axes(self) -> tuple[Axis, ...]:
        return arm_axes()

    def spec(self) -> mujoco.MjSpec:
        spec = load("serial_arm/serial_arm")
        frame_of(spec)
        add_carrier(spec.worldbody)
        spec.option.gravity = [0.0, 0.0, -9.81]
        return spec

    def kinematics(self, model: mujoco.MjModel, tool: str = MOUNT) -> Kinematics:
        return Kinematics(model, [tool], self.axes, locked=[f"g{j + 1}" for j in range(6)])

    def drives(
        self,
        model: mujoco.MjModel,
        settings: Sequence[Any],
        tick: float,
        substeps: int,
        feed: NDArray[np.bool_],
        tool: str = MOUNT,
    ) -> Drives:
        return ElasticJoints(
            model,
            self.kinematics(model, tool),
            tick,
            substeps,
            settings,
            feed,
            gears=[f"g{j + 1}" for j in range(6)],
            bandwidth=per_run(settings, "controller.bandwidth").tolist(),
            damping_ratio=per_run(settings, "controller.damping_ratio").tolist(),
            encoder=per_run(settings, "controller.encoder_resolution").tolist(),
            friction=arm_friction(model, settings, self.axes, tick / substeps, FRICTION_SHARE),
        )

    def response(self, rate: float, feed: bool) -> Response:
        """The second-order response of the motors; at low frequency the gears add (w/w_gear)^2 and
        no delay.
        """
        controller = self.settings.controller
        return Response(
            (controller.bandwidth,) * 6,
            (controller.damping_ratio,) * 6,
            self.settings.command.lag(rate),
            followed=feed,
        )

    def alike(self) -> Hashable:
        return self.kind
