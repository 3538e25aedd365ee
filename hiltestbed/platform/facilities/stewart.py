"""The Stewart platform: six legs, each a universal joint on the floor, an extensible leg, a
spherical joint at the platform.

Two kinds of drives: hydraulic cylinders (:mod:`hiltestbed.platform.facilities.hydraulic`), as in
most docking simulators of this type, or electric ones
(:mod:`hiltestbed.platform.facilities.force_servo`). The reference for the hydraulic one is the
response reported for the
simulator in Harbin: at most 2 dB and 70 degrees at 10 Hz.
"""

from __future__ import annotations

import math
from collections.abc import Hashable

import mujoco
import numpy as np

from hiltestbed.config.models import load
from hiltestbed.platform.facilities.drives import Drives, mass_matrix
from hiltestbed.platform.facilities.facility import MOUNT, Facility, add_carrier, compiled, frame_of
from hiltestbed.platform.facilities.force_servo import ForceServo
from hiltestbed.platform.facilities.hydraulic import Hydraulic
from hiltestbed.platform.facilities.kinematics import Axis
from hiltestbed.platform.facilities.mover import Runs
from hiltestbed.platform.shipped.stewart import StewartSettings

STROKE = 1.04  # [m] of a cylinder
ARMATURE = 120.0  # [kg] of an electric leg: rotor and screw 3e-3 kg m^2 at a lead of 31 mm
PRESLIDING = 2.0e7  # [N/m] of a seal: 300 N at 15 um


class Stewart(Facility):
    """The Stewart platform of ``models/stewart``."""

    settings: StewartSettings

    @property
    def axes(self) -> tuple[Axis, ...]:
        drive = self.settings.drive
        force = drive.supply * drive.area if drive.kind == "hydraulic" else drive.force
        half = 0.5 * STROKE
        return tuple(
            Axis(f"leg_{j}", "m", -half, half, drive.speed, drive.acceleration, force)
            for j in range(6)
        )

    def alike(self) -> Hashable:
        return (self.kind, self.settings.drive.kind)

    def spec(self) -> mujoco.MjSpec:
        spec = load("stewart/stewart")
        if self.settings.drive.kind == "electric":
            for j in range(6):
                spec.joint(f"leg_{j}").armature = ARMATURE
        frame_of(spec)
        add_carrier(spec.worldbody)
        spec.option.gravity = [0.0, 0.0, -9.81]
        return spec

    def drives(self, model: mujoco.MjModel, runs: Runs, tool: str = MOUNT) -> Drives:
        kinematics = self.kinematics(model, tool)
        drives = (
            ForceServo(model, kinematics, runs, "drive")
            if self.settings.drive.kind == "electric"
            else Hydraulic(model, kinematics, runs, STROKE)
        )
        # the smallest mass that a leg moves: its rod and its drive
        leg = float(
            model.body("rod_0").mass[0] + model.dof_armature[model.joint("leg_0").dofadr[0]]
        )
        drives.rub([s.drive.friction.law() for s in runs.settings], PRESLIDING, leg)
        return drives

    def bandwidth(self) -> float:
        """Hydraulic: at low frequency the third-order system lags by 1/K; its resonance is that of
        the oil with the bare platform in heave, sqrt(k/m) of its own stiffness and mass.
        """
        drive = self.settings.drive
        if drive.kind == "electric":
            return drive.bandwidth
        model = compiled(self.spec())
        kinematics = self.kinematics(model)
        twists, _ = kinematics.jacobian(kinematics.home)
        legs = np.linalg.inv(twists)
        mass = legs.T @ mass_matrix(kinematics, model) @ legs
        side = drive.dead_volume + 0.5 * drive.area * STROKE
        oil = 2.0 * drive.bulk_modulus * drive.area**2 / side  # [N/m] of a leg, its valve shut
        w = math.sqrt(oil * float((legs.T @ legs)[2, 2] / mass[2, 2]))
        return math.sqrt(drive.gain * w) / (2.0 * math.pi)
