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
from collections.abc import Hashable, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from hiltestbed.config.models import load
from hiltestbed.frames import Array
from hiltestbed.platform.facilities import hydraulic
from hiltestbed.platform.facilities.drives import Drives, drive_inputs, mass_matrix
from hiltestbed.platform.facilities.facility import (
    MOUNT,
    Facility,
    Response,
    add_carrier,
    compiled,
    frame_of,
    friction_law,
    per_run,
)
from hiltestbed.platform.facilities.force_servo import ForceServo
from hiltestbed.platform.facilities.kinematics import Axis
from hiltestbed.platform.friction import DriveFriction
from hiltestbed.platform.shipped.stewart import HydraulicDrive, StewartSettings

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

    def drives(
        self,
        model: mujoco.MjModel,
        settings: Sequence[Any],
        tick: float,
        substeps: int,
        feed: NDArray[np.bool_],
        tool: str = MOUNT,
    ) -> Drives:
        kinematics = self.kinematics(model, tool)
        step = tick / substeps
        law = friction_law(settings, "drive.friction", (1.0,) * 6)
        inputs = drive_inputs(model, [a.joint for a in self.axes])
        friction = (
            DriveFriction(law, PRESLIDING, self._least(model), kinematics.v, inputs, step)
            if law is not None
            else None
        )
        if self.settings.drive.kind == "electric":
            return ForceServo(
                model,
                kinematics,
                tick,
                substeps,
                settings,
                feed,
                bandwidth=per_run(settings, "drive.bandwidth").tolist(),
                damping_ratio=per_run(settings, "drive.damping_ratio").tolist(),
                encoder=per_run(settings, "drive.encoder_resolution").tolist(),
                friction=friction,
            )
        valves = [(s.drive.valve.bandwidth, s.drive.valve.damping_ratio) for s in settings]
        numbers = np.array([cylinder_numbers(s.drive, step) for s in settings])
        return hydraulic.Hydraulic(
            model,
            kinematics,
            tick,
            substeps,
            settings,
            feed,
            numbers=numbers,
            valves=valves,
            friction=friction,
        )

    def _least(self, model: mujoco.MjModel) -> float:
        """Smallest mass that a leg moves [kg]: its rod and its drive."""
        return float(
            model.body("rod_0").mass[0] + model.dof_armature[model.joint("leg_0").dofadr[0]]
        )

    def response(self, rate: float, feed: bool) -> Response:
        """At low frequency the third-order system lags by 1/K; its resonance is that of the oil
        with the whole platform, axis by axis.
        """
        drive = self.settings.drive
        delay = self.settings.command.lag(rate)
        if drive.kind == "electric":
            return Response(
                (drive.bandwidth,) * 6, (drive.damping_ratio,) * 6, delay, followed=feed
            )
        oil = oil_modes(drive, self)
        late = 1.0 / drive.gain
        band = tuple(math.sqrt(drive.gain * w) / (2.0 * math.pi) for w in oil)
        valve = 2.0 * drive.valve.damping_ratio / (2.0 * math.pi * drive.valve.bandwidth)
        return Response(
            band,
            tuple(0.5 * late * 2.0 * math.pi * f for f in band),
            delay + (valve if not feed else 0.0),
            followed=feed,
        )


def cylinder_numbers(drive: HydraulicDrive, step: float) -> Array:
    """``(NUMBERS,)`` parameters of a leg, in the order of
    :mod:`hiltestbed.platform.facilities.hydraulic`.
    """
    out = np.empty(hydraulic.NUMBERS)
    out[hydraulic.AREA], out[hydraulic.SUPPLY], out[hydraulic.FLOW] = (
        drive.area,
        drive.supply,
        drive.valve.flow,
    )
    out[hydraulic.MODULUS], out[hydraulic.DEAD], out[hydraulic.STROKE] = (
        drive.bulk_modulus,
        drive.dead_volume,
        STROKE,
    )
    out[hydraulic.LEAKAGE], out[hydraulic.FEEDBACK] = drive.leakage, drive.pressure_feedback
    out[hydraulic.CORNER] = 1.0 - math.exp(-2.0 * math.pi * drive.feedback_corner * step)
    out[hydraulic.GAIN], out[hydraulic.ENCODER] = drive.gain, drive.encoder_resolution
    return out


def oil_stiffness(drive: HydraulicDrive, leg: float = 0.0) -> float:
    """Stiffness of the oil in a leg ``leg`` [m] from home, with its valve shut [N/m]."""
    half = 0.5 * STROKE
    volumes = (
        drive.dead_volume + drive.area * (half + leg),
        drive.dead_volume + drive.area * (half - leg),
    )
    return drive.bulk_modulus * drive.area**2 * sum(1.0 / volume for volume in volumes)


def oil_modes(drive: HydraulicDrive, facility: Stewart) -> tuple[float, ...]:
    """Natural frequency [rad/s] of the oil with the bare platform, for each axis alone: sqrt(k/m)
    of its own stiffness and mass.
    """
    model = compiled(facility.spec())
    kinematics = facility.kinematics(model)
    twists, _ = kinematics.jacobian(kinematics.home)
    legs = np.linalg.inv(twists)
    mass = legs.T @ mass_matrix(kinematics, model) @ legs
    return tuple(
        float(x) for x in np.sqrt(oil_stiffness(drive) * np.diag(legs.T @ legs) / np.diag(mass))
    )
