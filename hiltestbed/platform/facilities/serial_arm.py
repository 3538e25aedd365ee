"""A six-axis industrial arm that carries the active docking mechanism on its flange.

Commands go to the controller at its own rate, are interpolated there, and take effect whole cycles
later; each joint has a motor, an elastic gear, a link and friction
(:mod:`hiltestbed.platform.facilities.force_servo`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from math import radians

import mujoco
import numpy as np

from hiltestbed.config.models import load
from hiltestbed.frames import Array
from hiltestbed.platform.facilities.drives import Drives
from hiltestbed.platform.facilities.facility import MOUNT, Facility, add_carrier, frame_of
from hiltestbed.platform.facilities.force_servo import ElasticJoints
from hiltestbed.platform.facilities.kinematics import Axis, Kinematics
from hiltestbed.platform.facilities.mover import Runs
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
    numbers = zip(TRAVEL_DEG, SPEED_DEG, ACCELERATION, TORQUE, strict=True)
    return tuple(
        Axis(f"{prefix}a{j + 1}", "rad", radians(low), radians(high), radians(speed), bend, torque)
        for j, ((low, high), speed, bend, torque) in enumerate(numbers)
    )


def pose_arm(spec: mujoco.MjSpec, angles: Array) -> None:
    """Set an arm's reference configuration, its home, to the ``angles`` (6,) [rad]."""
    for j, angle in enumerate(angles):
        joint, rotor = spec.joint(f"a{j + 1}"), spec.body(f"rotor_{j + 1}")
        half = 0.5 * float(angle)
        rotor.quat = [math.cos(half), *(math.sin(half) * np.array(joint.axis))]
        joint.ref = float(angle)


def gear_names(prefix: str = "") -> list[str]:
    """The joints of an arm's gears."""
    return [f"{prefix}g{j + 1}" for j in range(6)]


def let_arms_rub(drives: ElasticJoints, share: Sequence[float]) -> None:
    """Friction of the motors of one arm or two; ``share`` (J,): relative to the first axis."""
    law = [s.controller.friction.law() for s in drives.runs.settings]
    drives.rub(law, PRESLIDING, drives.model.dof_armature[drives.kinematics.v], share)


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
        return Kinematics(model, [tool], self.axes, locked=gear_names())

    def drives(self, model: mujoco.MjModel, runs: Runs, tool: str = MOUNT) -> Drives:
        kinematics = self.kinematics(model, tool)
        drives = ElasticJoints(model, kinematics, runs, "controller", gear_names())
        let_arms_rub(drives, FRICTION_SHARE)
        return drives

    def bandwidth(self) -> float:
        """Of the motors; at low frequency the gears add (w/w_gear)^2 and no delay."""
        return self.settings.controller.bandwidth
