"""The input of the compensation: the sensor's reading after a dead zone in the loop."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.effects.base import Effect, LinkParameters
from hiltestbed.effects.departure import quantity
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.frames import Array
from hiltestbed.plugins import register

COMPONENTS, MAGNITUDE, AFTER = 0, 1, 2
PLACES = {"before": COMPONENTS, "magnitude": MAGNITUDE, "after": AFTER}


@dataclass
class InputParameters(LinkParameters):
    """The dead zone of one run. width: [N], 0 for none. where: "before" the compensation on each
    axis, before it on the force's "magnitude", or "after" the compensation on each axis.
    """

    link = "compensation"
    width: float = 0.0
    where: str = "before"


class InputDeadZone:
    """The dead zone between reading and compensation, for ``n`` runs.

    Attributes:
        active: whether any run has a dead zone. wrench: ``(n, 6)`` the last reading after the dead
            zone.
    """

    def __init__(self, parameters: Sequence[InputParameters]) -> None:
        self._width = np.array([p.width for p in parameters])
        self._where = np.array([PLACES[p.where] for p in parameters])
        self.active = bool(self._width.any())
        self.wrench = np.zeros((len(parameters), 6))

    def update(self, reading: Array) -> Array:
        """A reading ``(n, 6)`` after the dead zone; torques pass, except with "magnitude"."""
        _dead(reading, self._width, self._where, False, self.wrench)
        return self.wrench

    def after(self, wrench: Array) -> None:
        """Zero small forces of ``wrench`` (n, 6) where the dead zone is after the compensation."""
        _dead(wrench, self._width, self._where, True, wrench)


@njit(cache=True)
def _dead(reading, width, where, behind, out):
    for i in range(reading.shape[0]):
        w = width[i] if (where[i] == AFTER) == behind else 0.0
        whole = where[i] == MAGNITUDE and not behind
        small = reading[i, 0] ** 2 + reading[i, 1] ** 2 + reading[i, 2] ** 2 < w * w
        for j in range(6):
            cut = small if whole else j < 3 and abs(reading[i, j]) < w
            out[i, j] = 0.0 if cut else reading[i, j]


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
