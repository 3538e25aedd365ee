"""The kinds of numerical model: two free-flyers, or a model of the user's own as an FMU."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from hiltestbed.numerical_model.settings import ModelKind
from hiltestbed.plugins import register
from hiltestbed.validation import ModelFile

if TYPE_CHECKING:
    from hiltestbed.numerical_model.model import NumericalModel
    from hiltestbed.scenario import Scenario


@register
class TwoFreeFlyers(ModelKind):
    """Chaser and target as rigid free-flyers with their appendages."""

    kind: Literal["free_flyers"] = "free_flyers"

    @classmethod
    def start(cls, scenarios: Sequence[Scenario]) -> NumericalModel:
        from hiltestbed.numerical_model.model import NumericalModel

        return NumericalModel(scenarios)


@register
class Fmu(ModelKind):
    """A model of the user's own, as an FMU of FMI 3.0 for co-simulation.

    Inputs: wrench.fx ... tz, what the active side exerts on the passive one, in P at P's origin; outputs: pose.px ... qw of A in P and
    twist.vx ... wz of A relative to P, in P. An input is held over a tick, which is worth half a tick of delay in the loop.
    """

    kind: Literal["fmu"] = "fmu"
    file: ModelFile = Field(description="The FMU")
    ticks_late = 0.5

    @classmethod
    def start(cls, scenarios: Sequence[Scenario]) -> NumericalModel:
        from hiltestbed.numerical_model.fmu import FmuModel

        return FmuModel(scenarios)
