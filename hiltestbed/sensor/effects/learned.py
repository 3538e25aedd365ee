"""A curve of the sensor that was learned from data, where no effect with a name does it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from hiltestbed.effects.base import Effect, quantity
from hiltestbed.effects.search import Candidate, Scales
from hiltestbed.piecewise import Curve
from hiltestbed.plugins import register
from hiltestbed.sensor.effects.calibration import WRENCH_AXES, WrenchAxis

if TYPE_CHECKING:
    from hiltestbed.sensor.parameters import SensorParameters

Reading = Annotated[Curve, Field(min_length=2)]


@register
class SensorMap(Effect):
    """The reading of one axis follows a curve that is not the straight line believed."""

    kind: Literal["sensor.map"] = "sensor.map"
    reading: Reading = quantity(
        "N, N", "Knots of what the axis shows over what it feels, of a torque in N m; past the ends the last slopes"
    )
    axis: WrenchAxis = Field(default="z", description="Axis of the wrench whose curve it is")
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
        """None: it is learned where the effects with a name leave more than noise, see :mod:`hiltestbed.diagnosis.learned`."""
        return iter(())
