"""No compensation: the measured wrench drives the numerical model unchanged."""

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
    """No compensation: the measured wrench drives the numerical model unchanged."""

    kind: Literal["none"] = "none"
    reads: ClassVar[frozenset[Input]] = frozenset({"wrench"})

    @classmethod
    def start(cls, scenarios: Sequence[Scenario], model: NumericalModel) -> UncompensatedBlock:
        return UncompensatedBlock()


class UncompensatedBlock:
    """Passes the measured wrench on."""

    def compensate(self, measurement: Measurement) -> Array:
        """``(n, 6)`` the measured wrench itself."""
        return measurement.wrench
