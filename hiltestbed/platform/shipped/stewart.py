"""A Stewart platform: six legs, hydraulic or electric."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from hiltestbed.config.validation import NotNegative, Positive, Strictly
from hiltestbed.platform.kinds import CommandPath, Driven, Friction, Ratio
from hiltestbed.plugins import register


class Valve(Strictly):
    """Servo valve of a leg: a second order between command and spool."""

    bandwidth: Positive = Field(
        default=120.0,
        description="Natural frequency of the spool [Hz]; a two-stage flow-control valve at small "
        "opening, makers' curves [recalled]",
    )
    damping_ratio: Ratio = Field(
        default=0.7, description="Damping ratio of the spool [-]; makers' curves [recalled]"
    )
    flow: Positive = Field(
        default=5.0e-3,
        description="Flow at full opening without load [m^3/s]; 300 l/min: 0.8 m/s of the piston, "
        "an available size [recalled]",
    )


class HydraulicDrive(Strictly):
    """Cylinder, oil and controller of a leg."""

    kind: Literal["hydraulic"] = Field(
        default="hydraulic", description="Hydraulic cylinders as legs"
    )
    supply: Positive = Field(
        default=2.1e7, description="Supply pressure [Pa]; 210 bar, usual for test rigs"
    )
    area: Positive = Field(
        default=6.26e-3,
        description="Area of the piston [m^2]; bore 100 mm, rod 45 mm on both sides",
    )
    dead_volume: Positive = Field(
        default=6.5e-4,
        description="Dead volume of hose, manifold and cylinder end on each side [m^3]; a tenth "
        "of the stroke volume",
    )
    bulk_modulus: Positive = Field(
        default=8.0e8,
        description="Bulk modulus of oil with hoses and dissolved air [Pa]; 0.7 to 1.0e9 (Merritt "
        "1967)",
    )
    leakage: NotNegative = Field(
        default=2.0e-12, description="Leakage past the piston [m^3/s/Pa]; 2.5 l/min at 210 bar"
    )
    valve: Valve = Field(default=Valve(), description="Servo valve of a leg")
    gain: Positive = Field(
        default=69.0,
        description="Gain of the position loop [1/s]; tuned to stay within 2 dB and 70 deg at 10 "
        "Hz, as Harbin reports",
    )
    pressure_feedback: NotNegative = Field(
        default=3.3e-10,
        description="Dynamic pressure feedback, flow per load pressure [m^3/s/Pa]; gives the "
        "oil's modes damping ratios of 0.2 to 0.6",
    )
    feedback_corner: Positive = Field(
        default=0.5, description="Corner frequency below which the pressure feedback fades out [Hz]"
    )
    encoder_resolution: NotNegative = Field(
        default=1.0e-6, description="Resolution of a leg's transducer [m]; magnetostrictive, 1 um"
    )
    friction: Friction = Field(
        default=Friction(coulomb=120.0, stiction=180.0, stribeck_speed=0.005, viscous=600.0),
        description="Friction of the seals; low-friction seals of test cylinders, 0.1 % of 131 "
        "kN, break-away 1.5 times that",
    )
    speed: Positive = Field(
        default=0.8, description="Highest speed of a leg [m/s]; at full opening of the valve"
    )
    acceleration: Positive = Field(
        default=15.0, description="Highest acceleration of a leg [m/s^2]"
    )


class ElectricDrive(Strictly):
    """Screw drive of a leg with a model-based position loop."""

    kind: Literal["electric"] = Field(description="Electric screw drives as legs")
    bandwidth: Positive = Field(
        default=25.0,
        description="Bandwidth of a leg's position loop [Hz]; half the first mode of large "
        "electric legs",
    )
    damping_ratio: Ratio = Field(
        default=0.9, description="Damping ratio of a leg's position loop [-]"
    )
    encoder_resolution: NotNegative = Field(
        default=1.0e-7,
        description="Resolution of a leg's encoder [m]; 20 bits per revolution, 31 mm lead: 0.03 "
        "um, times the screw's own error",
    )
    friction: Friction = Field(
        default=Friction(coulomb=0.0, stiction=0.0, stribeck_speed=0.005, viscous=0.0),
        description="Friction of screw and guide; zero: compensated",
    )
    force: Positive = Field(default=4.0e4, description="Largest force of a drive [N]")
    speed: Positive = Field(default=1.0, description="Highest speed of a leg [m/s]")
    acceleration: Positive = Field(
        default=15.0, description="Highest acceleration of a leg [m/s^2]"
    )


@register
class StewartSettings(Driven):
    """A Stewart platform: six legs under the active side."""

    distorts: ClassVar[str] = (
        "A hydraulic leg is a third-order system: its position loop lags by 1/K, and the oil's "
        "stiffness rings with the platform's mass. Without feed-forward that lag reduces the "
        "damping by k/K; with it, as in the model-based control at Harbin, the valves and the "
        "oil's modes remain. Seals stick at reversal."
    )

    drives: ClassVar[tuple[str, ...]] = ("drive", "command")
    kind: Literal["stewart"]
    drive: Annotated[HydraulicDrive | ElectricDrive, Field(discriminator="kind")] = Field(
        default=HydraulicDrive(), description="Drives of the legs, hydraulic or electric"
    )
    command: CommandPath = Field(
        default=CommandPath(), description="Path of commands to the drives"
    )

    def cure(self, lost: float) -> tuple[str, dict[str, Any]]:
        return "model-based feed-forward, phase lead of the force (Harbin)", super().cure(lost)[1]

    @classmethod
    def contest(cls) -> Mapping[str, Mapping[str, Any]]:
        return {
            f"stewart, {drive}": {"kind": "stewart", "drive": {"kind": drive}}
            for drive in ("hydraulic", "electric")
        }
