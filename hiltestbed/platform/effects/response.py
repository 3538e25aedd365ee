"""The platform responds late or slowly, or rings."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal, NamedTuple

from hiltestbed.effects.base import Effect
from hiltestbed.effects.departure import quantity
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.platform.parameters import PlatformParameters

Grid = dict[str, list[float]]
Bounds = dict[str, tuple[float, float]]
Response = tuple[float, float]
LONGEST = 20.0  # ticks: longest delay that is searched for on a slow loop
# [Hz] loop rate below which the frequencies that are searched are lowered in proportion
SLOW = 500.0
LAG_DAMPING = 0.7
# [s] part of a variant: length of the time steps in which a facility integrates a response; see
# `stepped`
AHEAD = "ahead"
# [rad] chosen: of a response's own phase, longest step that is looked at; a facility's controller
# is far faster
LONGEST_STEP = 0.5


def pace(tick: float) -> float:
    """Factor by which the frequencies that are searched are lowered on a slow loop."""
    return min(1.0, 1.0 / (SLOW * tick))


class Stepped(NamedTuple):
    """The continuous response that one integrated in time steps equals: w [rad/s] and damping ratio
    zeta, fed ``lead`` [s] early.

    begun: of a start at the rate of the command, the share of that rate at which the continuous
        response starts.
    """

    w: float
    zeta: float
    lead: float
    begun: float


def stepped(w: float, zeta: float, base: float, step: float) -> Stepped:
    """The response x'' = w^2 (u - x) - 2 zeta w (x' - base u') by semi-implicit Euler with ``step``
    [s] and u at the end of a step.

    This is the usual way in a controller's code. Its poles z fulfil z^2 - (2 - w^2 h^2 - 2 zeta w
    h) z + 1 - 2 zeta w h = 0; those of the continuous response are log(z) / h. It follows a ramp at
    the same distance, (1 - base) 2 zeta / w - h, and its first step is the same.
    """
    h = min(step, LONGEST_STEP / w)
    if h <= 0.0:
        return Stepped(w, zeta, 0.0, 1.0)
    loss, stiff = 2.0 * zeta * w * h, (w * h) ** 2
    # of z: real part, square of the imaginary part
    real, square = 1.0 - 0.5 * (loss + stiff), stiff - 0.25 * (loss + stiff) ** 2
    # two real poles: such a response neither lags by 0.7 nor rings
    if loss >= 1.0 or square <= 0.0:
        return Stepped(w, zeta, h, 1.0)
    imaginary, decay = math.sqrt(square), -0.5 * math.log1p(-loss) / h
    ringing = math.atan2(imaginary, real) / h
    found = math.hypot(decay, ringing)
    distance = (1.0 - base) * 2.0 * zeta / w - h  # [s] behind a ramp
    # after a step: of an error, of a difference in rate
    kept, gained = real + decay / ringing * imaginary, imaginary / ringing
    begun = 1.0 + (distance * (1.0 - kept) + h * (stiff - (1.0 - base) * loss)) / gained
    return Stepped(found, decay / found, (1.0 - base) * 2.0 * decay / found**2 - distance, begun)


class SecondOrder(Effect):
    """Base of the responses that a facility may integrate in time steps of its own."""

    def respond(
        self, p: PlatformParameters, frequency: float, zeta: float, base: float
    ) -> Response:
        """Natural frequency [rad/s] and damping ratio of the continuous response that equals it,
        for ``frequency`` [Hz]; what else the steps change is put into ``p``.
        """
        step = min(self.variant.get(AHEAD, 0.0), p.tick)
        found = stepped(2.0 * math.pi * frequency, zeta, base, step)
        p.delay -= found.lead
        p.begun *= found.begun
        return found.w, found.zeta

    @classmethod
    def stepped_or_not(cls, grid: Grid, bounds: Bounds, tick: float) -> Iterator[Candidate]:
        """Candidates of the continuous response, and of one in time steps."""
        yield candidate(cls, grid, bounds=bounds)
        yield candidate(
            cls,
            grid | {AHEAD: [0.1 * tick]},
            bounds=bounds | {AHEAD: (0.0, tick)},
            variant={"steps": True},
        )


@register
class PlatformDelay(Effect):
    """Transport delay of the motion platform."""

    kind: Literal["platform.delay"] = "platform.delay"
    delay: float = quantity(
        "s", "Transport delay of the platform", ge=0.0, le=1.0, search=(0.0, 0.05)
    )
    link = "platform"
    equation = "x(t) = x_cmd(t - delay)"
    reference = "pure transport delay"
    resembles = ("platform.lag",)
    repeats = True

    def apply(self, p: PlatformParameters) -> None:
        p.delay += self.delay

    def worth(self, tick: float, frequency: float) -> float:
        return self.delay

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        h = scales.tick
        yield candidate(
            cls,
            {"delay": [s * h for s in (0.3, 1.0, 3.0, 8.0, 20.0)]},
            bounds={"delay": (0.0, max(0.05, LONGEST * h))},
        )


@register
class PlatformLag(SecondOrder):
    """Second-order response of the platform, damping ratio 0.7."""

    kind: Literal["platform.lag"] = "platform.lag"
    bandwidth: float = quantity(
        "Hz", "Natural frequency of the response", gt=0.0, search=(2.0, 400.0), ratio=True
    )
    link = "platform"
    equation = "x'' = w^2 (x_cmd - x) - 1.4 w x', w = 2 pi bandwidth"
    reference = "second-order servo"
    resembles = ("platform.delay",)
    repeats = True
    vanishes = True

    def apply(self, p: PlatformParameters) -> None:
        p.lag.append(self.respond(p, self.bandwidth, LAG_DAMPING, 0.0))

    def worth(self, tick: float, frequency: float) -> float:
        return 2.0 * LAG_DAMPING / (2.0 * math.pi * self.bandwidth)

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        slow = pace(scales.tick)
        grid = {"bandwidth": [slow * f for f in (4, 8, 15, 30, 60, 120, 250)]}
        return cls.stepped_or_not(grid, {"bandwidth": (2.0 * slow, 400.0)}, scales.tick)


@register
class PlatformMode(SecondOrder):
    """A lightly damped mode between drive and port."""

    kind: Literal["platform.mode"] = "platform.mode"
    frequency: float = quantity(
        "Hz", "Natural frequency of the mode", gt=0.0, search=(2.0, 400.0), ratio=True
    )
    damping_ratio: float = quantity(
        "-", "Damping ratio of the mode", gt=0.0, le=1.0, search=(0.002, 0.5), ratio=True
    )
    link = "platform"
    equation = "x'' = w^2 (x_cmd - x) + 2 zeta w (x_cmd' - x')"
    reference = "structural mode excited at its base"
    resembles = ("platform.lag",)
    repeats = True
    vanishes = True

    def apply(self, p: PlatformParameters) -> None:
        p.mode.append(self.respond(p, self.frequency, self.damping_ratio, 1.0))

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        slow, h = pace(scales.tick), scales.tick
        grid = {
            "frequency": [slow * f for f in (5, 8, 12, 18, 27, 40, 60, 90, 130)],
            "damping_ratio": [0.02, 0.1],
        }
        return cls.stepped_or_not(grid, {"frequency": (2.0 * slow, min(400.0, 0.5 / h))}, h)
