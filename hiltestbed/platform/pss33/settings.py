"""Settings of the 3-3 PSS platform: six sliders on guides, a link to each."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field, model_validator

from hiltestbed.platform.kinds import Platform
from hiltestbed.plugins import register
from hiltestbed.validation import NotNegative, Positive, Problem, Strictly, refuse

if TYPE_CHECKING:
    from hiltestbed.contact.composition import Structure
    from hiltestbed.platform.facilities.facility import Facility
    from hiltestbed.platform.pss33.rig import Pss33Follower, Pss33Rig
    from hiltestbed.scenario import Scenario


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


@register
class Pss33(Platform):
    """Platform of the 3-3 PSS kind: six sliders, each with a link to the platform; drives under computed torque."""

    states_limits: ClassVar[bool] = False
    carries_upper: ClassVar[bool] = True

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

    def facility(self) -> Facility:
        raise NotImplementedError

    def driven(self, scenarios: Sequence[Scenario], structure: Structure, dt: float) -> Pss33Rig:
        from hiltestbed.platform.pss33.rig import Pss33Rig

        return Pss33Rig(scenarios, structure, dt)

    def follower(self, scenarios: Sequence[Scenario], structure: Structure, dt: float) -> Pss33Follower:
        from hiltestbed.platform.pss33.rig import Pss33Follower

        return Pss33Follower()

    def drawn(self, scenario: Scenario) -> None:
        return None

    def alike(self, scenario: Scenario) -> Hashable:
        return self.kind

    def problems(self, scenario: Scenario) -> Iterator[Problem]:
        from hiltestbed.platform.pss33.checks import start_problems

        return start_problems(scenario)

    def nearest_bandwidth(self, scenario: Scenario) -> float:
        return self.bandwidth
