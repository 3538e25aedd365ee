"""Polynomial extrapolation of the measured force over the delay.

The polynomial of order p through the last p + 1 samples spaced one delay apart, evaluated one delay
ahead:

    F(t) ~ sum over i of (-1)^i C(p + 1, i + 1) F_meas(t - i tau);
    p = 3: 4 F_0 - 6 F_1 + 4 F_2 - F_3

(T. Horiuchi, M. Inoue, T. Konno, Y. Namita, "Real-time hybrid experimental system with actuator
delay compensation and its application to a piping system with energy absorber", Earthquake Eng.
Struct. Dyn. 28, 1999, where it extrapolates the displacement). It needs a force that is smooth over
p delays, which the onset of a contact is not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from hiltestbed.compensation.history import History
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.settings import ForceMethod, Input, force_of
from hiltestbed.frames import Array
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.numerical_model.model import NumericalModel
    from hiltestbed.scenario import Scenario


@register
class Polynomial(ForceMethod):
    """Polynomial extrapolation of the measured wrench over the delay, through samples spaced one
    delay apart.
    """

    kind: Literal["polynomial"] = "polynomial"
    order: Annotated[int, Field(ge=1, le=5)] = Field(
        default=3, description="Order of the polynomial"
    )
    reads: ClassVar[frozenset[Input]] = frozenset({"wrench"})
    removes_delay: ClassVar[bool] = True

    @classmethod
    def start(cls, scenarios: Sequence[Scenario], model: NumericalModel) -> PolynomialBlock:
        return PolynomialBlock(scenarios)


class PolynomialBlock:
    """The extrapolation of all six components of the wrench, for ``n`` runs of the same order."""

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        n = len(scenarios)
        self._ticks = np.array([s.sensor.delay * s.rate for s in scenarios])
        orders = np.array([force.order for force in force_of(scenarios, Polynomial)])
        self._weights = np.array(
            [
                [(-1) ** i * math.comb(p + 1, i + 1) for i in range(int(orders.max()) + 1)]
                for p in orders
            ],
            dtype=float,
        )
        self._history = History(6, self._ticks * orders.max())
        self._late = np.zeros((n, 6))
        self.output = np.zeros((n, 6))

    def compensate(self, measurement: Measurement) -> Array:
        """``(n, 6)`` the wrench extrapolated by the delay."""
        self._history.remember(measurement.wrench)
        self.output[:] = 0.0
        for i in range(self._weights.shape[1]):
            self.output += self._weights[:, i, None] * self._history.before(
                i * self._ticks, self._late
            )
        return self.output
