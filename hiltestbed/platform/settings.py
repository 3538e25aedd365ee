"""The rig's section of a scenario: the motion platform, and what carries the passive side."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from hiltestbed.validation import NotNegative, Positive, Strictly, refuse


class Actuator(Strictly):
    """The drive of each slider of the platform, and the friction that each of its motors works against.

    The numbers are those of a preloaded screw with its guide: 0.5 % of the 40 kN that a drive gives, break-away 1.5 times that, the
    Stribeck speed of oiled steel, and a viscous part that equals the sliding one at 0.5 m/s.
    """

    kind: Literal["ideal", "single", "dual"] = Field(
        default="ideal",
        description="Motors of a drive. ideal: without friction; single: one; dual: two summed by a differential screw, kept turning",
    )
    coulomb: NotNegative = Field(default=200.0, description="Sliding friction of a motor [N]")
    stiction: NotNegative = Field(default=300.0, description="Break-away friction of a motor [N], at least coulomb")
    stribeck_speed: Positive = Field(
        default=0.005, description="Speed at which the excess of the break-away friction has fallen to 1/e [m/s]"
    )
    viscous: NotNegative = Field(default=400.0, description="Viscous friction of a motor [N s/m]")
    bias_speed: Positive = Field(
        default=0.3, description="Speed at which both motors of a dual drive turn at rest, in terms of the slider [m/s]"
    )

    @model_validator(mode="after")
    def _breaks_away(self) -> Actuator:
        if self.stiction < self.coulomb:
            refuse([(("stiction",), f"is less than coulomb (got {self.stiction:g} N); allowed is {self.coulomb:g} N and more")])
        return self


class Platform(Strictly):
    """The motion platform and how it follows."""

    kind: Literal["pss33"] = Field(default="pss33", description="Motion platform. pss33: 3-3 PSS, six sliders")
    tracking: Literal["servo", "ideal"] = Field(
        default="servo",
        description="How it follows. servo: its dynamics under its drives; ideal: the pose reaches the command exactly, one tick later",
    )
    bandwidth: Positive = Field(
        default=40.0,
        description="Bandwidth of the drives' position loop [Hz]; the default is a quarter of the first mode of a large rig's limbs",
    )
    damping_ratio: Positive = Field(default=1.0, description="Damping ratio of the drives' position loop [-]")
    actuator: Actuator = Field(default=Actuator(), description="Motors and friction of the drives; with tracking servo alone")


class UpperPlatform(Strictly):
    """What carries the passive side and the force sensor."""

    kind: Literal["fixed", "prs3"] = Field(
        default="fixed",
        description="Upper platform. fixed: none; prs3: heave of 2 m and two tilts, clamped while the ports are less than 0.19 m apart",
    )
    tracking: Literal["servo", "ideal"] = Field(
        default="servo", description="How the upper platform follows. servo: under its drives; ideal: it is where it is planned to be"
    )


class Rig(Strictly):
    """The physical side: the motion platform, and what carries the passive port."""

    platform: Platform = Field(default=Platform(), description="The motion platform that carries the active side")
    upper: UpperPlatform = Field(default=UpperPlatform(), description="What carries the passive side and the force sensor")
