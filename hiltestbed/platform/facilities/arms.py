"""Industrial arms: one that carries the active docking mechanism on its flange, and two that face
each other, one of them on a rail, as at EPOS: the passive side moves too.

Commands go to the controller at its own rate, are interpolated there, and take effect whole cycles
later; each joint has a motor, an elastic gear, a link and friction
(:mod:`hiltestbed.platform.facilities.force_servo`).

Of two arms insertion is horizontal: W's z along the rail, y up, gravity along -y. The base of the
active arm is fixed, the passive arm moves on the rail and carries force sensor and passive
mechanism.

Allocation of the relative pose (p, R = exp(r)) to the two sides, with s the passive side's share:

    rail     far(g), g = -p_z: 0 up to HOLD, then growing,slope 1 from CLEAR on: at rest in contact
    passive  attitude exp(-s (1 - far') r), position  far z - s R_P p',   p' = p + far z
    active   the rest: its pose in W is that of P in W times (p, R)

so that near the touch the two arms perform (1 - s) and s of every motion, and far away the passive
arm only moves with the rail.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from math import radians
from typing import ClassVar

import mujoco
import numpy as np

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.config.models import load
from hiltestbed.frames import (
    Array,
    pose_step,
    quat_exp,
    quat_mul,
    rotate,
    rotation_vector,
    twist_between,
)
from hiltestbed.platform.facilities.drives import Drives
from hiltestbed.platform.facilities.facility import (
    MOUNT,
    NOMINAL,
    SENSOR_HEIGHT,
    TOOL_HOME,
    Facility,
    Runs,
    add_carrier,
    standing,
)
from hiltestbed.platform.facilities.force_servo import ElasticJoints
from hiltestbed.platform.facilities.kinematics import Axis, Kinematics
from hiltestbed.platform.facilities.tree import compose, inverse_pose
from hiltestbed.platform.shipped.arms import SerialArmSettings, TwoArmsSettings

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
        return standing("serial_arm/serial_arm")

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


ACTIVE, PASSIVE = "chaser_", "target_"  # prefixes of the two arms' names
GEARS = [*gear_names(ACTIVE), *gear_names(PASSIVE)]
# [rad], a6 of the passive arm
HOME = (0.0, -1.0506357359978915, 1.6113790755209094, 0.0, -0.5607433395296182, 1.5707963267948966)
# [m] gap up to which the rail is at rest, and beyond which it performs the whole motion
HOLD, CLEAR = 0.10, 0.30
RAIL = Axis("rail", "m", -0.3, 24.5, 2.0, 1.0, 2.0e4)
RAIL_FRICTION = 1.0  # the first axis' friction parameters, with N in place of N m
SLICE = 1e-4  # [s] interval of the difference quotient of the allocated poses


@njit(cache=True)
def share_out(pose, share, active, passive):
    """Poses (7,) of A and P in W for that of A in P; returns the rail's position [m]."""
    gap, u = -pose[2], (-pose[2] - HOLD) / (CLEAR - HOLD)
    ride, slope = 0.0, 0.0  # the rail's share of the gap [m], and its slope
    if u >= 1.0:
        ride, slope = 0.5 * (CLEAR - HOLD) + gap - CLEAR, 1.0
    elif u > 0.0:
        ride, slope = (CLEAR - HOLD) * (u * u * u - 0.5 * u**4), u * u * (3.0 - 2.0 * u)
    r, v = np.empty(3), np.empty(3)
    rotation_vector(pose[3:7], r)
    for i in range(3):
        r[i] *= -share * (1.0 - slope)
        v[i] = pose[i]
    v[2] += ride
    quat_exp(r, passive[3:7])
    rotate(passive[3:7], v, v)
    for i in range(3):
        passive[i] = -share * v[i]
    passive[2] += ride
    rotate(passive[3:7], pose[0:3], v)
    for i in range(3):
        active[i] = passive[i] + v[i]
    quat_mul(passive[3:7], pose[3:7], active[3:7])
    return ride


@njit(cache=True)
def _allocate(pose, twist, accel, half, shares, targets):
    """Poses, rail and, by central differences over SLICE, their rates, of the tools."""
    poses = targets.poses
    speed = np.empty(6)
    moved, before, after = np.empty(7), np.empty((2, 7)), np.empty((2, 7))
    for i in range(pose.shape[0]):
        for c in range(6):
            speed[c] = twist[i, c] + half * accel[i, c]
        targets.held[i, 0] = share_out(pose[i], shares[i], poses[i, 0], poses[i, 1])
        pose_step(pose[i], speed, -0.5 * SLICE, moved)
        first = share_out(moved, shares[i], before[0], before[1])
        pose_step(pose[i], speed, 0.5 * SLICE, moved)
        last = share_out(moved, shares[i], after[0], after[1])
        targets.held_rates[i, 0] = (last - first) / SLICE
        for t in range(2):
            twist_between(before[t], after[t], SLICE, targets.twists[i, t])


class FacingArms(ElasticJoints):
    """Drives of both arms and the rail."""

    @cached_property
    def _allocated(self) -> Call:
        shares = self.runs.numbers("passive_share")
        return Call(_allocate, GIVEN, GIVEN, GIVEN, ..., shares, self.targets)

    def allocate(self, pose: Array, twist: Array, accel: Array, half: float) -> None:
        self._allocated.on(pose, twist, accel)(half)


class TwoArms(Facility):
    """The hall of ``models/two_arms`` with two arms of ``models/serial_arm``."""

    moves_passive: ClassVar[bool] = True
    settings: TwoArmsSettings

    @property
    def axes(self) -> tuple[Axis, ...]:
        return (*arm_axes(ACTIVE), *arm_axes(PASSIVE), RAIL)

    @property
    def tool_shares(self) -> tuple[float, ...]:
        return 1.0 - self.settings.passive_share, self.settings.passive_share

    def spec(self) -> mujoco.MjSpec:
        spec = load("two_arms/two_arms")
        for prefix, stand, turn in (
            (ACTIVE, "active_stand", -1.0),
            (PASSIVE, "passive_stand", 1.0),
        ):
            arm = load("serial_arm/serial_arm")
            pose_arm(arm, np.array([*HOME[:5], turn * HOME[5]]))
            arm.body("base").pos, arm.body("base").quat = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]
            spec.attach(arm, prefix=prefix, site=spec.site(stand))
        spec.site(ACTIVE + MOUNT).name = MOUNT
        flange = spec.site(PASSIVE + MOUNT)
        # The sensor's flange points along -z of P; P is SENSOR_HEIGHT in front of it.
        down = np.array([0.0, 0.0, SENSOR_HEIGHT, 1.0, 0.0, 0.0, 0.0])
        at = compose(
            np.array([*flange.pos, *np.array(flange.quat)[[1, 2, 3, 0]]]), inverse_pose(down)
        )
        add_carrier(flange.parent, at)
        return spec

    def kinematics(self, model: mujoco.MjModel, tool: str = MOUNT) -> Kinematics:
        return Kinematics(model, [tool, NOMINAL], self.axes, locked=GEARS, prescribed=["rail"])

    def drives(self, model: mujoco.MjModel, runs: Runs, tool: str = MOUNT) -> FacingArms:
        kinematics = self.kinematics(model, tool)
        drives = FacingArms(model, kinematics, runs, "controller", [*GEARS, None])
        let_arms_rub(drives, (*FRICTION_SHARE, *FRICTION_SHARE, RAIL_FRICTION))
        return drives

    def bandwidth(self) -> float:
        return self.settings.controller.bandwidth

    def complaints(self, pose: Array, tool: Array = TOOL_HOME) -> list[str]:
        active, passive = np.empty(7), np.empty(7)
        rail = share_out(
            np.asarray(pose, dtype=float), self.settings.passive_share, active, passive
        )
        return self.bare.complaints(
            np.array([compose(active, inverse_pose(tool)), passive]), np.array([rail])
        )
