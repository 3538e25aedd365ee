"""The kinds of numerical model: two free-flyers, or the user's model as an FMU."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, cast

from pydantic import Field

from hiltestbed.config.validation import AnyFile
from hiltestbed.numerical_model.settings import ModelKind
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.numerical_model.model import NumericalModel
    from hiltestbed.scenario.like import ScenarioLike


@register
class TwoFreeFlyers(ModelKind):
    """Chaser and target as rigid free-flyers with their appendages."""

    kind: Literal["free_flyers"] = "free_flyers"

    @classmethod
    def start(cls, scenarios: Sequence[ScenarioLike]) -> NumericalModel:
        from hiltestbed.numerical_model.model import NumericalModel

        return NumericalModel(scenarios)


@register
class Fmu(ModelKind):
    """The user's own model, as an FMU (FMI 2.0 or 3.0, co-simulation).

    Inputs: wrench.fx ... tz, exerted by the active side on the passive one, in P at P's origin;
        outputs: pose.px ... qw of A in P and twist.vx ... wz of A relative to P, in P. The input is
        held over a tick, which adds half a tick of delay to the loop.
    """

    kind: Literal["fmu"] = "fmu"
    file: AnyFile = Field(description="Path of the FMU file")
    ticks_late = 0.5

    @classmethod
    def start(cls, scenarios: Sequence[ScenarioLike]) -> NumericalModel:
        from hiltestbed.numerical_model.fmu import FmuModel

        files = [Path(cast("Fmu", s.numerical_model).file) for s in scenarios]
        return FmuModel(scenarios, files)
