"""Settings of the resynchronised prediction."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field

from hiltestbed.compensation.settings import ForceMethod, Input
from hiltestbed.plugins import register
from hiltestbed.validation import NotNegative, Positive, Problem, Strictly

if TYPE_CHECKING:
    from hiltestbed.compensation.resynchronised.drive import ResynchronisedDrive
    from hiltestbed.numerical_model.model import NumericalModel
    from hiltestbed.scenario import Scenario


class KnownContact(Strictly):
    """A contact that was identified before."""

    stiffness: Positive = Field(description="Stiffness of the contact as it is known [N/m]")
    damping: NotNegative = Field(default=0.0, description="Damping of the contact as it is known [N s/m]")
    touch: float = Field(default=0.0, description="Place of the first touch along the insertion [m]")


@register
class Resynchronised(ForceMethod):
    """Resynchronised prediction: a delayed numerical model is driven by the measured wrench, and the present is predicted from it."""

    kind: Literal["resynchronised"] = "resynchronised"
    contact: KnownContact | None = Field(
        default=None, description="Contact that was identified before; null: nothing is known of it, it is identified as it is met"
    )
    delay: Literal["known", "estimate"] = Field(
        default="known",
        description="Delay of the force. known: sensor.delay as it stands; estimate: corrected by the instant of first touch",
    )
    blending: Positive = Field(default=0.002, description="Time constant with which a corrected prediction reaches the platform [s]")
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

    def idle(self, scenario: Scenario) -> Iterable[Problem]:
        if scenario.mechanism.captured:
            yield ("blending",), "the mechanism holds from the start: there is no first contact, from which a correction would come"

    def memory(self) -> float:
        return self.blending
