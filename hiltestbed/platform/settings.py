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
        description="ideal: no friction; single: one motor; dual: two summed by a differential screw, each kept turning by bias_speed",
    )
    coulomb: NotNegative = Field(default=200.0, description="sliding friction [N]")
    stiction: NotNegative = Field(default=300.0, description="break-away [N], at least coulomb")
    stribeck_speed: Positive = Field(default=0.005, description="speed at which the break-away excess has fallen to 1/e [m/s]")
    viscous: NotNegative = Field(default=400.0, description="[N s/m]")
    bias_speed: Positive = Field(default=0.3, description="of each of the two motors at rest, in terms of the slider [m/s]; dual alone")

    @model_validator(mode="after")
    def _breaks_away(self) -> Actuator:
        if self.stiction < self.coulomb:
            refuse([(("stiction",), f"is less than coulomb (got {self.stiction:g} N); allowed is {self.coulomb:g} N and more")])
        return self


class Platform(Strictly):
    """The motion platform and how it follows."""

    kind: Literal["pss33"] = "pss33"
    tracking: Literal["servo", "ideal"] = Field(default="servo", description="ideal: the pose reaches the command exactly, one tick later")
    bandwidth: Positive = Field(
        default=40.0,
        description="of the drives' position loop [Hz]; a quarter of the first mode that large parallel rigs have in their limbs",
    )
    damping_ratio: Positive = Field(default=1.0, description="of the drives' position loop [-]")
    actuator: Actuator = Field(default=Actuator(), description="with tracking servo")


class UpperPlatform(Strictly):
    """What carries the passive side and the force sensor."""

    kind: Literal["fixed", "prs3"] = Field(
        default="fixed", description="prs3: heave of 2 m and two tilts while the ports are more than 0.19 m apart, clamped below that"
    )
    tracking: Literal["servo", "ideal"] = Field(default="servo", description="of prs3; ideal: it is where it is planned to be")


class Rig(Strictly):
    """The physical side."""

    platform: Platform = Platform()
    upper: UpperPlatform = UpperPlatform()
