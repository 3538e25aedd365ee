"""The platform goes elsewhere than it is told: play, stiction, a scale error, a limit of its speed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from hiltestbed.effects.base import Effect, quantity
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.platform.parameters import PlatformParameters

AXES = ("x", "y", "z")
FINE = 20  # instants a tick of a platform that jumps when it must, in place of at the instants of the physics


@register
class PlatformBacklash(Effect):
    """Play that is crossed at each reversal."""

    kind: Literal["platform.backlash"] = "platform.backlash"
    width: float = quantity("m", "Whole play", ge=0.0, search=(0.0, 2e-3))
    link = "platform"
    equation = "x = min(max(x, x_cmd - width/2), x_cmd + width/2)"
    reference = "play operator"
    resembles = ("platform.friction",)
    repeats = True
    leading = "width"

    def apply(self, p: PlatformParameters) -> None:
        p.play += self.width

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        yield candidate(cls, {"width": [1e-5, 4e-5, 1.5e-4, 5e-4]}, bounds={"width": (0.0, max(2e-3, scales.travel))})


@register
class PlatformFriction(Effect):
    """The platform moves in jumps."""

    kind: Literal["platform.friction"] = "platform.friction"
    stick: float = quantity("m", "Distance of the command from the axis at which it moves", ge=0.0, search=(0.0, 1e-3))
    link = "platform"
    equation = "x holds until |x_cmd - x| > stick, then x = x_cmd, and holds again"
    reference = "stiction"
    resembles = ("platform.backlash",)
    repeats = True
    leading = "stick"
    jumps = "stick"

    def apply(self, p: PlatformParameters) -> None:
        p.stick += self.stick
        p.instants = self.variant.get("instants", p.instants)

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        few = list(np.geomspace(5e-6, 8e-4, 6))
        for instants in scales.sticks or dict.fromkeys((scales.substeps, FINE)):
            yield candidate(cls, {"stick": list(scales.sticks.get(instants, few))}, variant={"instants": instants})


@register
class PlatformScale(Effect):
    """One axis of translation is scaled."""

    kind: Literal["platform.scale"] = "platform.scale"
    factor: float = quantity("-", "Reached over commanded translation", gt=0.0, search=(0.8, 1.25), ratio=True)
    axis: Literal["x", "y", "z"] = Field(default="z", description="Axis of translation that is scaled")
    link = "platform"
    equation = "x_axis = factor x_cmd_axis"
    reference = "geometric calibration error"
    resembles = ("contact.touch_offset",)
    repeats = True
    leading = "factor"

    def apply(self, p: PlatformParameters) -> None:
        p.scale[AXES.index(self.axis)] *= self.factor

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        return (candidate(cls, {"factor": [0.97, 1.03]}, choices=3, axis=axis) for axis in AXES)


@register
class PlatformSpeedLimit(Effect):
    """Each axis follows no faster than a limit."""

    kind: Literal["platform.speed_limit"] = "platform.speed_limit"
    speed: float = quantity("m/s", "Highest speed of each axis", gt=0.0, search=(1e-3, 1.0), ratio=True)
    link = "platform"
    equation = "|x'| <= speed"
    reference = "limit of an actuator"
    resembles = ("platform.lag",)
    repeats = True
    leading = "speed"
    vanishes = True
    jumps = "speed"

    def apply(self, p: PlatformParameters) -> None:
        p.speed = min(p.speed, self.speed)

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        yield candidate(cls, {"speed": list(np.geomspace(0.3 * scales.slow, 1.05 * scales.fast, 8))})
