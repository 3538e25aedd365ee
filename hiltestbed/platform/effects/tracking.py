"""The platform does not reach its commanded position: play, stiction, a scale error, a speed
limit.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from hiltestbed.effects.base import Effect
from hiltestbed.effects.departure import quantity
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.platform.parameters import PlatformParameters

AXES = ("x", "y", "z")
# instants per tick at which a sticking platform may move, searched beside the number of physics
# steps
FINE = 20


@register
class PlatformBacklash(Effect):
    """Play that is taken up at each reversal."""

    kind: Literal["platform.backlash"] = "platform.backlash"
    width: float = quantity("m", "Total width of the play", ge=0.0, search=(0.0, 2e-3))
    link = "platform"
    equation = "x = min(max(x, x_cmd - width/2), x_cmd + width/2)"
    reference = "play operator"
    resembles = ("platform.friction",)
    repeats = True

    def apply(self, p: PlatformParameters) -> None:
        p.play += self.width

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        yield candidate(
            cls,
            {"width": [1e-5, 4e-5, 1.5e-4, 5e-4]},
            bounds={"width": (0.0, max(2e-3, scales.travel))},
        )


@register
class PlatformFriction(Effect):
    """The platform moves in jumps."""

    kind: Literal["platform.friction"] = "platform.friction"
    stick: float = quantity(
        "m", "Distance between command and axis at which the axis moves", ge=0.0, search=(0.0, 1e-3)
    )
    link = "platform"
    equation = "x holds until |x_cmd - x| > stick, then x = x_cmd, and holds again"
    reference = "stiction"
    resembles = ("platform.backlash",)
    repeats = True
    jumps = "stick"

    def apply(self, p: PlatformParameters) -> None:
        p.stick += self.stick
        p.instants = self.variant.get("instants", p.instants)
        p.phase = self.variant.get("phase", p.phase)

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        few = list(np.geomspace(5e-6, 8e-4, 6))
        sticks = scales.sticks or {(n, 0.0): few for n in (scales.substeps, FINE)}
        for (instants, phase), starts in sticks.items():
            variant = {"instants": instants, "phase": phase}
            yield candidate(cls, {"stick": list(starts)}, variant=variant)


@register
class PlatformScale(Effect):
    """One axis of translation is scaled."""

    kind: Literal["platform.scale"] = "platform.scale"
    factor: float = quantity(
        "-", "Ratio of actual to commanded translation", gt=0.0, search=(0.8, 1.25), ratio=True
    )
    axis: Literal["x", "y", "z"] = Field(
        default="z", description="Axis of translation that is scaled"
    )
    link = "platform"
    equation = "x_axis = factor x_cmd_axis"
    reference = "geometric calibration error"
    resembles = ("contact.touch_offset",)
    repeats = True

    def apply(self, p: PlatformParameters) -> None:
        p.scale[AXES.index(self.axis)] *= self.factor

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        return (candidate(cls, {"factor": [0.97, 1.03]}, choices=3, axis=axis) for axis in AXES)


@register
class PlatformSpeedLimit(Effect):
    """Each axis follows its command no faster than a limit."""

    kind: Literal["platform.speed_limit"] = "platform.speed_limit"
    speed: float = quantity(
        "m/s", "Maximum speed of each axis", gt=0.0, search=(1e-3, 1.0), ratio=True
    )
    link = "platform"
    equation = "|x'| <= speed"
    reference = "actuator rate limit"
    resembles = ("platform.lag",)
    repeats = True
    vanishes = True
    jumps = "speed"

    def apply(self, p: PlatformParameters) -> None:
        p.speed = min(p.speed, self.speed)

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        yield candidate(
            cls, {"speed": list(np.geomspace(0.3 * scales.slow, 1.05 * scales.fast, 8))}
        )
