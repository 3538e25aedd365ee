"""The Stewart platform: six legs, each a universal joint on the floor, an extensible leg, a spherical joint at the platform.

Two drives: hydraulic cylinders (:mod:`hiltestbed.platform.facilities.hydraulic`), as most docking simulators of this kind have, or
electric ones (:mod:`hiltestbed.platform.facilities.force_servo`). The reference for the hydraulic one is what Harbin reports for theirs: at
10 Hz at most 2 dB and 70 degrees.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from typing import Annotated, Any, ClassVar, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from hiltestbed.frames import Array
from hiltestbed.platform.facilities import hydraulic
from hiltestbed.platform.facilities.drives import Drives, drive_inputs, mass_matrix
from hiltestbed.platform.facilities.facility import (
    MOUNT,
    CommandPath,
    Facility,
    Friction,
    Ratio,
    Response,
    add_carrier,
    compiled,
    frame_of,
    per_run,
)
from hiltestbed.platform.facilities.force_servo import ForceServo
from hiltestbed.platform.facilities.friction import Rubbing
from hiltestbed.platform.facilities.kinematics import Axis
from hiltestbed.rig.model import load
from hiltestbed.validation import NotNegative, Positive, Strictly

STROKE = 1.04  # [m] of a cylinder
ARMATURE = 120.0  # [kg] of an electric leg: rotor and screw 3e-3 kg m^2 at a lead of 31 mm
PRESLIDING = 2.0e7  # [N/m] of a seal: 300 N at 15 um


class Valve(Strictly):
    """Servo valve of a leg: a second order between command and spool."""

    bandwidth: Positive = Field(
        default=120.0, description="[Hz]; a two-stage flow-control valve at small opening, makers' curves [recalled]"
    )
    damping_ratio: Ratio = Field(default=0.7, description="[-] the same")
    flow: Positive = Field(
        default=5.0e-3, description="at full opening without load [m^3/s]; 300 l/min: 0.8 m/s of the piston, a size that is made [recalled]"
    )


class HydraulicDrive(Strictly):
    """Cylinder, oil and controller of a leg."""

    kind: Literal["hydraulic"] = "hydraulic"
    supply: Positive = Field(default=2.1e7, description="supply pressure [Pa]; 210 bar, the usual one of test rigs")
    area: Positive = Field(default=6.26e-3, description="of the piston [m^2]; bore 100 mm, rod 45 mm on both sides")
    dead_volume: Positive = Field(default=6.5e-4, description="of hose, manifold and end of each side [m^3]; a tenth of the stroke's")
    bulk_modulus: Positive = Field(default=8.0e8, description="of oil with hoses and dissolved air [Pa]; 0.7 to 1.0e9 (Merritt 1967)")
    leakage: NotNegative = Field(default=2.0e-12, description="past the piston [m^3/s/Pa]; 2.5 l/min at 210 bar")
    valve: Valve = Valve()
    gain: Positive = Field(
        default=69.0, description="of the position loop [1/s]; set so that 10 Hz passes within 2 dB and 70 deg, as Harbin reports"
    )
    pressure_feedback: NotNegative = Field(
        default=3.3e-10, description="dynamic, flow per load pressure [m^3/s/Pa]; damps the oil's spring by 0.2 to 0.6"
    )
    feedback_corner: Positive = Field(default=0.5, description="below which the pressure feedback lets go [Hz]")
    encoder_resolution: NotNegative = Field(default=1.0e-6, description="of the leg's transducer [m]; magnetostrictive, 1 um")
    friction: Friction = Field(
        default=Friction(coulomb=120.0, stiction=180.0, stribeck_speed=0.005, viscous=600.0),
        description="of the seals; low-friction seals of test cylinders, 0.1 % of 131 kN, break-away 1.5 times that",
    )
    speed: Positive = Field(default=0.8, description="limit of a leg [m/s]: what the valve lets through")
    acceleration: Positive = Field(default=15.0, description="limit of a leg [m/s^2]")


class ElectricDrive(Strictly):
    """Screw drive of a leg under a model-based position loop."""

    kind: Literal["electric"]
    bandwidth: Positive = Field(default=25.0, description="of the position loop [Hz]; half the first mode of large electric legs")
    damping_ratio: Ratio = Field(default=0.9, description="[-]")
    encoder_resolution: NotNegative = Field(
        default=1.0e-7, description="[m]; 20 bits a turn, 31 mm lead: 0.03 um, times the screw's own error"
    )
    friction: Friction = Field(
        default=Friction(coulomb=0.0, stiction=0.0, stribeck_speed=0.005, viscous=0.0), description="of screw and guide; none: compensated"
    )
    force: Positive = Field(default=4.0e4, description="limit of a drive [N]")
    speed: Positive = Field(default=1.0, description="limit of a leg [m/s]")
    acceleration: Positive = Field(default=15.0, description="limit of a leg [m/s^2]")


class StewartSettings(Strictly):
    """A Stewart platform: six legs under the active side."""

    kind: Literal["stewart"]
    drive: Annotated[HydraulicDrive | ElectricDrive, Field(discriminator="kind")] = Field(
        default=HydraulicDrive(), description="hydraulic or electric legs"
    )
    command: CommandPath = CommandPath()


class Stewart(Facility):
    """The Stewart platform of ``models/stewart``."""

    kind: ClassVar[str] = "stewart"
    settings: StewartSettings

    @property
    def axes(self) -> tuple[Axis, ...]:
        drive = self.settings.drive
        force = drive.supply * drive.area if drive.kind == "hydraulic" else drive.force
        half = 0.5 * STROKE
        return tuple(Axis(f"leg_{j}", "m", -half, half, drive.speed, drive.acceleration, force) for j in range(6))

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
        self, model: mujoco.MjModel, settings: Sequence[Any], tick: float, substeps: int, feed: NDArray[np.bool_], tool: str = MOUNT
    ) -> Drives:
        kinematics = self.kinematics(model, tool)
        cycles, lates = self.lags(settings, tick)
        step = tick / substeps
        rubbing = _rubbing(settings, kinematics.v, drive_inputs(model, [a.joint for a in self.axes]), step, self._least(model))
        if self.settings.drive.kind == "electric":
            return ForceServo(
                model, kinematics, tick, substeps, cycles, lates, feed, bandwidth=per_run(settings, "drive.bandwidth").tolist(),
                damping_ratio=per_run(settings, "drive.damping_ratio").tolist(),
                encoder=per_run(settings, "drive.encoder_resolution").tolist(),
                rubbing=rubbing,
            )  # fmt: skip
        valves = [(s.drive.valve.bandwidth, s.drive.valve.damping_ratio) for s in settings]
        numbers = np.array([cylinder_numbers(s.drive, step) for s in settings])
        return hydraulic.Hydraulic(model, kinematics, tick, substeps, cycles, lates, feed, numbers=numbers, valves=valves, rubbing=rubbing)

    def _least(self, model: mujoco.MjModel) -> float:
        """The least that a leg moves [kg]: its rod and its drive."""
        return float(model.body("rod_0").mass[0] + model.dof_armature[model.joint("leg_0").dofadr[0]])

    def response(self, rate: float, feed: bool) -> Response:
        """At low frequency the third order lags by 1/K; its resonance is that of the oil under the whole platform, axis by axis."""
        drive = self.settings.drive
        delay = self.settings.command.lag(rate)
        if drive.kind == "electric":
            return Response((drive.bandwidth,) * 6, (drive.damping_ratio,) * 6, delay, followed=feed)
        oil = oil_modes(drive, self)
        late = 1.0 / drive.gain
        band = tuple(math.sqrt(drive.gain * w) / (2.0 * math.pi) for w in oil)
        valve = 2.0 * drive.valve.damping_ratio / (2.0 * math.pi * drive.valve.bandwidth)
        return Response(band, tuple(0.5 * late * 2.0 * math.pi * f for f in band), delay + (valve if not feed else 0.0), followed=feed)


def cylinder_numbers(drive: HydraulicDrive, step: float) -> Array:
    """``(NUMBERS,)`` of a leg, as :mod:`hiltestbed.platform.facilities.hydraulic` counts them."""
    out = np.empty(hydraulic.NUMBERS)
    out[hydraulic.AREA], out[hydraulic.SUPPLY], out[hydraulic.FLOW] = drive.area, drive.supply, drive.valve.flow
    out[hydraulic.MODULUS], out[hydraulic.DEAD], out[hydraulic.STROKE] = drive.bulk_modulus, drive.dead_volume, STROKE
    out[hydraulic.LEAKAGE], out[hydraulic.FEEDBACK] = drive.leakage, drive.pressure_feedback
    out[hydraulic.CORNER] = 1.0 - math.exp(-2.0 * math.pi * drive.feedback_corner * step)
    out[hydraulic.GAIN], out[hydraulic.ENCODER] = drive.gain, drive.encoder_resolution
    return out


def oil_stiffness(drive: HydraulicDrive, leg: float = 0.0) -> float:
    """Spring of the oil in a leg that stands ``leg`` [m] from home, its valve shut [N/m]."""
    half = 0.5 * STROKE
    volumes = (drive.dead_volume + drive.area * (half + leg), drive.dead_volume + drive.area * (half - leg))
    return drive.bulk_modulus * drive.area**2 * sum(1.0 / volume for volume in volumes)


def oil_modes(drive: HydraulicDrive, facility: Stewart) -> tuple[float, ...]:
    """Natural frequency [rad/s] of the oil under the bare platform, for each axis by itself: sqrt(k/m) of its own stiffness and mass."""
    model = compiled(facility.spec())
    kinematics = facility.kinematics(model)
    twists, _ = kinematics.jacobian(kinematics.home)
    legs = np.linalg.inv(twists)
    mass = legs.T @ mass_matrix(kinematics, model) @ legs
    return tuple(float(x) for x in np.sqrt(oil_stiffness(drive) * np.diag(legs.T @ legs) / np.diag(mass)))


def _rubbing(settings: Sequence[Any], axes: NDArray, inputs: NDArray, step: float, moved: float) -> Rubbing | None:
    """Friction of the legs, where a run has any."""
    names = ("coulomb", "stiction", "stribeck_speed", "viscous")
    slide, stick, speed, viscous = (np.tile(per_run(settings, f"drive.friction.{name}")[:, None], (1, 6)) for name in names)
    if not (slide.any() or stick.any() or viscous.any()):
        return None
    return Rubbing(slide, stick, speed, viscous, np.full_like(slide, PRESLIDING), np.full(6, moved), axes, inputs, step)
