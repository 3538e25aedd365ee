"""The analogue-to-digital conversion zeroes small forces and clips large ones."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

import numpy as np

from hiltestbed.effects.base import Effect, quantity
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.sensor.parameters import SensorParameters


@register
class SensorDeadzone(Effect):
    """A dead zone in the sensor: force axes read zero below a threshold."""

    kind: Literal["sensor.deadzone"] = "sensor.deadzone"
    width: float = quantity(
        "N", "Force below which an axis reads zero", gt=0.0, search=(0.2, 60.0), ratio=True
    )
    link = "sensor"
    equation = "f_axis = 0 where |f_axis| < width"
    reference = "dead zone of an analogue-to-digital conversion"
    resembles = ("loop.deadzone",)
    repeats = True
    leading = "width"
    jumps = "width"

    def apply(self, p: SensorParameters) -> None:
        p.deadzone[:3] = np.maximum(p.deadzone[:3], self.width)

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        widths = list(np.geomspace(scales.noise, 0.5 * scales.force, 16))
        yield candidate(
            cls, {"width": widths}, bounds={"width": (0.5 * scales.noise, 0.7 * scales.force)}
        )


@register
class SensorSaturation(Effect):
    """Force axes clip at the range of the sensor."""

    kind: Literal["sensor.saturation"] = "sensor.saturation"
    limit: float = quantity(
        "N", "Force at which an axis clips", gt=0.0, search=(5.0, 5000.0), ratio=True
    )
    link = "sensor"
    equation = "f_axis = min(max(f_axis, -limit), limit)"
    reference = "range of the sensor or of its amplifier"
    resembles = ("contact.power_law",)
    repeats = True
    leading = "limit"
    vanishes = True
    jumps = "limit"

    def apply(self, p: SensorParameters) -> None:
        p.limit[:3] = np.minimum(p.limit[:3], self.limit)

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        f = scales.force
        limits = [q * f for q in (0.25, 0.4, 0.55, 0.7, 0.8, 0.9, 0.97)] + list(scales.reading)
        yield candidate(cls, {"limit": limits}, bounds={"limit": (0.05 * f, 1.2 * f)})
