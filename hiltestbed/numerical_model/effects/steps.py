"""What the numerical model has wrong in how it steps."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from hiltestbed.effects.base import Effect
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.numerical_model.parameters import DynamicsParameters
    from hiltestbed.scenario import Scenario

MOST_TICKS = 12  # that are searched


@register
class DynamicsStepDelay(Effect):
    """Whole ticks of extra transport in the numerical model."""

    kind: Literal["dynamics.step_delay"] = "dynamics.step_delay"
    ticks: Annotated[int, Field(ge=0, le=100)] = Field(description="Whole ticks of delay", json_schema_extra={"unit": "-"})
    link = "dynamics"
    equation = "pose_cmd is `ticks` rows late"
    reference = "transport within the loop"
    resembles = ("dynamics.integrator",)
    repeats = True
    leading = "ticks"

    def apply(self, p: DynamicsParameters) -> None:
        p.late += self.ticks

    def worth(self, scenario: Scenario, frequency: float) -> float:
        return self.ticks * scenario.tick

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        return (candidate(cls, {}, choices=MOST_TICKS, ticks=ticks) for ticks in range(1, MOST_TICKS + 1))


@register
class DynamicsIntegrator(Effect):
    """The integrator adds energy: it acts as one step of delay."""

    kind: Literal["dynamics.integrator"] = "dynamics.integrator"
    scheme: Literal["explicit_euler"] = Field(
        default="explicit_euler", description="Integration scheme that runs in place of the semi-implicit one"
    )
    link = "dynamics"
    equation = "pose with the old twist, then the twist"
    reference = "explicit Euler"
    resembles = ("dynamics.step_delay",)
    leading = "scheme"

    def apply(self, p: DynamicsParameters) -> None:
        p.explicit = True

    def worth(self, scenario: Scenario, frequency: float) -> float:
        return scenario.tick

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        yield candidate(cls, {})
