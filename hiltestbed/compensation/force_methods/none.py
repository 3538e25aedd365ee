"""No compensation: the numerical model is driven with the wrench as measured."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar, Literal

from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.settings import ForceMethod, Input
from hiltestbed.frames import Array
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.numerical_model.model import NumericalModel
    from hiltestbed.scenario import Scenario


@register
class NoForceCompensation(ForceMethod):
    """The numerical model is driven with the measured wrench as it is."""

    kind: Literal["none"] = "none"
    reads: ClassVar[frozenset[Input]] = frozenset({"wrench"})

    @classmethod
    def start(cls, scenarios: Sequence[Scenario], model: NumericalModel) -> UncompensatedBlock:
        return UncompensatedBlock()


class UncompensatedBlock:
    """Hands the measured wrench on."""

    def compensate(self, measurement: Measurement) -> Array:
        """``(n, 6)`` the measured wrench itself."""
        return measurement.wrench
