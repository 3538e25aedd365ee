"""The force reading is delayed, by a constant or a varying time."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

from hiltestbed.effects.base import Effect, quantity
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario
    from hiltestbed.sensor.parameters import SensorParameters


@register
class SensorDelay(Effect):
    """An additional constant delay of the force reading."""

    kind: Literal["sensor.delay"] = "sensor.delay"
    delay: float = quantity(
        "s", "Delay on top of the nominal one", ge=0.0, le=1.0, search=(0.0, 0.03)
    )
    link = "sensor"
    equation = "w_meas(t) = w(t - delay_nominal - delay)"
    reference = "pure transport delay"
    resembles = ("contact.damping", "log.skew", "sensor.lag")
    repeats = True
    leading = "delay"
    jumps = "delay"

    def apply(self, p: SensorParameters) -> None:
        p.delay += self.delay

    def worth(self, scenario: Scenario, frequency: float) -> float:
        return self.delay

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        yield candidate(
            cls, {"delay": scales.delays}, bounds={"delay": (0.0, scales.longest_delay)}
        )


@register
class SensorJitter(Effect):
    """Jitter: the delay of the force reading varies from sample to sample."""

    kind: Literal["sensor.jitter"] = "sensor.jitter"
    sigma: float = quantity(
        "s", "Standard deviation of the delay", ge=0.0, le=0.1, search=(0.0, 0.005)
    )
    link = "sensor"
    equation = "w_meas(t_k) = w(t_k - delay - sigma n_k), n_k standard normal, total delay >= 0"
    reference = "sampling jitter"
    resembles = ("sensor.delay",)
    repeats = True
    leading = "sigma"

    def apply(self, p: SensorParameters) -> None:
        p.jitter = math.hypot(p.jitter, self.sigma)

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        """None: jitter is noise proportional to the reading's rate of change; it is found by
        likelihood, not by a change of the mean.
        """
        return iter(())
