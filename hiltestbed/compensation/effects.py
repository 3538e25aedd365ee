"""A dead zone between the measured and the compensated wrench."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

import numpy as np

from hiltestbed.effects.base import Effect
from hiltestbed.effects.departure import quantity
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.compensation.input import InputParameters


@register
class LoopDeadzone(Effect):
    """A dead zone in the loop: small forces are not passed on to the numerical model."""

    kind: Literal["loop.deadzone"] = "loop.deadzone"
    width: float = quantity(
        "N", "Force below which an axis is taken as zero", gt=0.0, search=(0.2, 60.0), ratio=True
    )
    link = "compensation"
    equation = "f_axis = 0 where |f_axis| < width, before the compensation"
    reference = "guard against drift of the numerical model"
    resembles = ("sensor.deadzone",)
    repeats = True
    leading = "width"
    jumps = "width"

    def apply(self, p: InputParameters) -> None:
        p.width = max(p.width, self.width)
        p.where = self.variant.get("where", p.where)

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        # steps of 8 %: a width 10 % off fits no better than none
        widths = list(np.geomspace(0.3 * scales.noise, 0.3 * scales.force, 100))
        bounds = {"width": (0.1 * scales.noise, 0.8 * scales.force)}
        for variant in ({}, {"where": "after"}, {"where": "magnitude"}):
            yield candidate(cls, {"width": widths}, bounds=bounds, variant=variant)
