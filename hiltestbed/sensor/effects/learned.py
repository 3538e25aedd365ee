"""A calibration curve of the sensor learned from data, for departures that no named effect
explains.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from hiltestbed.config.piecewise import Curve
from hiltestbed.effects.base import Effect, quantity
from hiltestbed.effects.search import Candidate, Scales
from hiltestbed.plugins import register
from hiltestbed.sensor.effects.calibration import WRENCH_AXES, WrenchAxis

if TYPE_CHECKING:
    from hiltestbed.sensor.parameters import SensorParameters

Reading = Annotated[Curve, Field(min_length=2)]


@register
class SensorMap(Effect):
    """The reading of one axis follows a non-linear calibration curve instead of the nominal
    straight line.
    """

    kind: Literal["sensor.map"] = "sensor.map"
    reading: Reading = quantity(
        "N, N",
        "Knots of the reading over the true force (torque axes: N m); linearly extrapolated "
        "beyond the ends",
    )
    axis: WrenchAxis = Field(
        default="z", description="Axis of the wrench that the curve applies to"
    )
    link = "sensor"
    equation = "w_axis = curve(w_axis), piecewise linear"
    reference = "calibration curve"
    resembles = ("sensor.gain", "sensor.saturation", "contact.power_law")
    repeats = True
    leading = "reading"

    def apply(self, p: SensorParameters) -> None:
        p.curve[WRENCH_AXES.index(self.axis)] = self.reading

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        """None: it is learned where the named effects leave a residual above the noise floor, see
        :mod:`hiltestbed.diagnosis.learned`.
        """
        return iter(())
