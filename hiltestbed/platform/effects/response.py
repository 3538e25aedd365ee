"""The platform responds late or slowly, or rings."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

from hiltestbed.effects.base import Effect, quantity
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.platform.parameters import PlatformParameters
    from hiltestbed.scenario import Scenario

LONGEST = 20.0  # ticks: longest delay that is searched for on a slow loop
SLOW = 500.0  # [Hz] loop rate below which the frequencies that are searched are lowered in proportion
LAG_DAMPING = 0.7
AHEAD = "ahead"  # [s] part of a variant: a response integrated in time steps uses the command at the end of its step


def pace(tick: float) -> float:
    """Factor by which the frequencies that are searched are lowered on a slow loop."""
    return min(1.0, 1.0 / (SLOW * tick))


@register
class PlatformDelay(Effect):
    """Transport delay of the motion platform."""

    kind: Literal["platform.delay"] = "platform.delay"
    delay: float = quantity("s", "Transport delay of the platform", ge=0.0, le=1.0, search=(0.0, 0.05))
    link = "platform"
    equation = "x(t) = x_cmd(t - delay)"
    reference = "pure transport delay"
    resembles = ("platform.lag",)
    repeats = True
    leading = "delay"

    def apply(self, p: PlatformParameters) -> None:
        p.delay += self.delay

    def worth(self, scenario: Scenario, frequency: float) -> float:
        return self.delay

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        h = scales.tick
        yield candidate(cls, {"delay": [s * h for s in (0.3, 1.0, 3.0, 8.0, 20.0)]}, bounds={"delay": (0.0, max(0.05, LONGEST * h))})


@register
class PlatformLag(Effect):
    """Second-order response of the platform, damping ratio 0.7."""

    kind: Literal["platform.lag"] = "platform.lag"
    bandwidth: float = quantity("Hz", "Natural frequency of the response", gt=0.0, search=(2.0, 400.0), ratio=True)
    link = "platform"
    equation = "x'' = w^2 (x_cmd - x) - 1.4 w x', w = 2 pi bandwidth"
    reference = "second-order servo"
    resembles = ("platform.delay",)
    repeats = True
    leading = "bandwidth"
    vanishes = True

    def apply(self, p: PlatformParameters) -> None:
        p.lag.append((2.0 * math.pi * self.bandwidth, LAG_DAMPING))
        p.delay -= min(self.variant.get(AHEAD, 0.0), p.tick)

    def worth(self, scenario: Scenario, frequency: float) -> float:
        return 2.0 * LAG_DAMPING / (2.0 * math.pi * self.bandwidth)

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        slow = pace(scales.tick)
        grid = {"bandwidth": [slow * f for f in (4, 8, 15, 30, 60, 120, 250)]}
        bounds = {"bandwidth": (2.0 * slow, 400.0)}
        yield candidate(cls, grid, bounds=bounds)
        yield candidate(cls, grid | {AHEAD: [0.1 * scales.tick]}, bounds=bounds | {AHEAD: (0.0, scales.tick)}, variant={"steps": True})


@register
class PlatformMode(Effect):
    """A lightly damped mode between drive and port."""

    kind: Literal["platform.mode"] = "platform.mode"
    frequency: float = quantity("Hz", "Natural frequency of the mode", gt=0.0, search=(2.0, 400.0), ratio=True)
    damping_ratio: float = quantity("-", "Damping ratio of the mode", gt=0.0, le=1.0, search=(0.002, 0.5), ratio=True)
    link = "platform"
    equation = "x'' = w^2 (x_cmd - x) + 2 zeta w (x_cmd' - x')"
    reference = "structural mode excited at its base"
    resembles = ("platform.lag",)
    repeats = True
    leading = "frequency"
    vanishes = True

    def apply(self, p: PlatformParameters) -> None:
        p.mode.append((2.0 * math.pi * self.frequency, self.damping_ratio))
        p.delay -= min(self.variant.get(AHEAD, 0.0), p.tick)

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        slow, h = pace(scales.tick), scales.tick
        grid = {"frequency": [slow * f for f in (5, 8, 12, 18, 27, 40, 60, 90, 130)], "damping_ratio": [0.02, 0.1]}
        bounds = {"frequency": (2.0 * slow, min(400.0, 0.5 / h))}
        yield candidate(cls, grid, bounds=bounds)
        yield candidate(cls, grid | {AHEAD: [0.1 * h]}, bounds=bounds | {AHEAD: (0.0, h)}, variant={"steps": True})
