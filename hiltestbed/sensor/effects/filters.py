"""Filters of the electronics: a low-pass that lags, a charge amplifier that leaks."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

from hiltestbed.effects.base import Effect, quantity
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario
    from hiltestbed.sensor.parameters import SensorParameters

SLOWEST = 50.0  # ticks: upper bound of a lag's time constant in the search on a slow loop


@register
class SensorLag(Effect):
    """The force reading passes an additional first-order low-pass."""

    kind: Literal["sensor.lag"] = "sensor.lag"
    time_constant: float = quantity(
        "s", "Time constant of the low-pass", gt=0.0, search=(1e-4, 0.05), ratio=True
    )
    link = "sensor"
    equation = "T y' = u - y, the wrench linear between the physics instants"
    reference = "first-order low-pass, 1/(1 + s T)"
    resembles = ("sensor.delay",)
    repeats = True
    leading = "time_constant"

    def apply(self, p: SensorParameters) -> None:
        p.lag.append(self.time_constant)

    def worth(self, scenario: Scenario, frequency: float) -> float:
        return self.time_constant

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        h = scales.tick
        bounds = {"time_constant": (1e-4, max(0.05, SLOWEST * h))}
        yield candidate(
            cls, {"time_constant": [0.3 * h, h, 3.0 * h, 8.0 * h, 25.0 * h]}, bounds=bounds
        )


@register
class SensorHighpass(Effect):
    """Charge leakage, a high-pass: the reading of a steady force decays, and an undershoot follows
    the contact.
    """

    kind: Literal["sensor.highpass"] = "sensor.highpass"
    time_constant: float = quantity(
        "s", "Time constant of the charge leakage", gt=0.0, search=(0.02, 100.0), ratio=True
    )
    link = "sensor"
    equation = "T (y' - u') = -y, the wrench linear between the physics instants"
    reference = "charge amplifier, s T/(1 + s T)"
    resembles = ("contact.relaxation", "sensor.drift")
    repeats = True
    leading = "time_constant"
    vanishes = True

    def apply(self, p: SensorParameters) -> None:
        p.leak.append(self.time_constant)

    def worth(self, scenario: Scenario, frequency: float) -> float:
        # a high-pass leads: phase 1/(w T)
        return -1.0 / (frequency * frequency * self.time_constant)

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        yield candidate(cls, {"time_constant": [0.05, 0.2, 1.0, 5.0, 25.0]})
