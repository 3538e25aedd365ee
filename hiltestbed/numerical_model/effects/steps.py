"""Errors in the time stepping of the numerical model."""

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

MOST_TICKS = 12  # longest delay that is searched


@register
class DynamicsStepDelay(Effect):
    """The pose of the numerical model is late by extra whole ticks."""

    kind: Literal["dynamics.step_delay"] = "dynamics.step_delay"
    ticks: Annotated[int, Field(ge=0, le=100)] = Field(
        description="Whole ticks of delay", json_schema_extra={"unit": "-"}
    )
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
        return (
            candidate(cls, {}, choices=MOST_TICKS, ticks=ticks)
            for ticks in range(1, MOST_TICKS + 1)
        )


@register
class DynamicsIntegrator(Effect):
    """The integrator of the numerical model adds energy: it acts as a delay of one step."""

    kind: Literal["dynamics.integrator"] = "dynamics.integrator"
    scheme: Literal["explicit_euler"] = Field(
        default="explicit_euler",
        description="Integration scheme used instead of semi-implicit Euler",
    )
    link = "dynamics"
    equation = "pose integrated with the old twist, then the twist"
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
