"""Settings of the resynchronised prediction."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field

from hiltestbed.compensation.settings import ForceMethod, Input
from hiltestbed.plugins import register
from hiltestbed.validation import NotNegative, Positive, Strictly

if TYPE_CHECKING:
    from hiltestbed.compensation.resynchronised.drive import ResynchronisedDrive
    from hiltestbed.numerical_model.model import NumericalModel
    from hiltestbed.scenario import Scenario


class KnownContact(Strictly):
    """A contact that was identified before."""

    stiffness: Positive = Field(description="[N/m]")
    damping: NotNegative = Field(default=0.0, description="[N s/m]")
    touch: float = Field(default=0.0, description="where along the insertion it is touched first [m]")


@register
class Resynchronised(ForceMethod):
    """The numerical model at t - delay, driven by the measured wrench as what it is, and predicted from there."""

    kind: Literal["resynchronised"] = "resynchronised"
    contact: KnownContact | None = Field(default=None, description="null: nothing is known of it, it is identified as it is met")
    delay: Literal["known", "estimate"] = Field(default="known", description="estimate: correct sensor.delay by the instant of first touch")
    blending: Positive = Field(default=0.002, description="time constant with which a corrected prediction reaches the platform [s]")
    reads: ClassVar[frozenset[Input]] = frozenset({"wrench", "pose", "twist", "identified", "captured", "model"})
    corrects_platform: ClassVar[bool] = True

    @classmethod
    def start(cls, scenarios: Sequence[Scenario], model: NumericalModel) -> ResynchronisedDrive:
        from hiltestbed.compensation.resynchronised.drive import ResynchronisedDrive

        return ResynchronisedDrive(model, scenarios)

    def removes(self, scenario: Scenario) -> Mapping[str, float]:
        sensor = scenario.sensor
        lowpass = 0.0 if sensor.lowpass is None else 1.0 / (2.0 * math.pi * sensor.lowpass)  # it plays the low-pass through as well
        out = {self.kind: sensor.delay + lowpass}
        if self.delay == "estimate":
            out[f"{self.kind}.estimate"] = sum(e.parameters()["delay"] for e in scenario.effects if e.kind == "sensor.delay")
        return out

    def memory(self) -> float:
        return self.blending
