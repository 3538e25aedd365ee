"""Calibration errors: the transducer scales and mixes the axes of the wrench."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from hiltestbed.effects.base import Effect, quantity
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.sensor.parameters import SensorParameters

WRENCH_AXES = ("x", "y", "z", "rx", "ry", "rz")
WrenchAxis = Literal["x", "y", "z", "rx", "ry", "rz"]


@register
class SensorGain(Effect):
    """The gain of one axis of the wrench is wrong."""

    kind: Literal["sensor.gain"] = "sensor.gain"
    factor: float = quantity(
        "-", "True gain over nominal gain", gt=0.0, search=(0.3, 3.0), ratio=True
    )
    axis: WrenchAxis = Field(default="z", description="Axis of the wrench that is scaled")
    link = "sensor"
    equation = "w_axis *= factor"
    reference = "calibration error"
    resembles = ("contact.stiffness",)
    repeats = True
    leading = "factor"

    def apply(self, p: SensorParameters) -> None:
        p.calibration[WRENCH_AXES.index(self.axis)] *= self.factor

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        return (
            candidate(cls, {"factor": [0.9, 1.1]}, choices=2, axis=axis) for axis in WRENCH_AXES
        )


@register
class SensorCrosstalk(Effect):
    """A fraction of one axis of the wrench appears on another axis."""

    kind: Literal["sensor.crosstalk"] = "sensor.crosstalk"
    ratio: float = quantity(
        "-",
        "Fraction of the source axis that appears on the other",
        ge=-1.0,
        le=1.0,
        search=(-0.3, 0.3),
    )
    source: WrenchAxis = Field(
        default="z", description="Axis of the wrench that couples into the other"
    )
    axis: WrenchAxis = Field(
        default="x", description="Axis of the wrench on which the crosstalk appears"
    )
    link = "sensor"
    equation = "w_axis += ratio w_source"
    reference = "calibration-matrix error"
    resembles = ("contact.misalignment", "contact.surface_friction")
    repeats = True
    leading = "ratio"

    def apply(self, p: SensorParameters) -> None:
        p.calibration[WRENCH_AXES.index(self.axis)] += (
            self.ratio * p.calibration[WRENCH_AXES.index(self.source)]
        )

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        pairs = [(a, b) for a in WRENCH_AXES for b in WRENCH_AXES if a != b]
        return (candidate(cls, {"ratio": [0.0]}, choices=6, source=a, axis=b) for a, b in pairs)
