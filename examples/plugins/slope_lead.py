"""A user-defined compensation: the measured wrench is extrapolated over the delay, with its slope
over the last ticks.

hiltestbed run 03-bumper-delay-uncompensated --plugin examples/plugins/slope_lead.py --set
'compensation.force={kind: slope_lead}' hiltestbed bench cor --quick --plugin
examples/plugins/slope_lead.py
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.settings import ForceMethod, Input, force_of
from hiltestbed.frames import Array
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.numerical_model.model import NumericalModel
    from hiltestbed.scenario import Scenario


@register
class SlopeLead(ForceMethod):
    """Linear extrapolation of the measured wrench over the delay, with the slope of the last
    ticks.
    """

    kind: Literal["slope_lead"] = "slope_lead"
    ticks: Annotated[int, Field(ge=1, le=100)] = Field(
        default=4, description="Ticks over which the slope is taken [-]"
    )
    reads: ClassVar[frozenset[Input]] = frozenset({"wrench"})

    @classmethod
    def start(cls, scenarios: Sequence[Scenario], model: NumericalModel) -> SlopeLeadBlock:
        """The method for ``n`` runs."""
        return SlopeLeadBlock(scenarios)

    def removes(self, scenario: Scenario) -> Mapping[str, float]:
        """For the delay ledger: the delay [s] that the method removes at low frequency."""
        return {self.kind: scenario.sensor.delay}


class SlopeLeadBlock:
    """The extrapolation of all six components, for ``n`` runs."""

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        n, settings = len(scenarios), force_of(scenarios, SlopeLead)
        self._ticks = np.array([s.ticks for s in settings])
        # delay in units of the slope's span
        self._ahead = np.array([s.sensor.delay * s.rate for s in scenarios]) / self._ticks
        # the latest readings, newest first
        self._before = np.zeros((int(self._ticks.max()) + 1, n, 6))
        self._runs = np.arange(n)

    def compensate(self, measurement: Measurement) -> Array:
        """``(n, 6)`` the wrench extrapolated by the delay, with its slope over the last ticks."""
        self._before = np.roll(self._before, 1, axis=0)
        self._before[0] = measurement.wrench
        change = measurement.wrench - self._before[self._ticks, self._runs]
        return measurement.wrench + self._ahead[:, None] * change
