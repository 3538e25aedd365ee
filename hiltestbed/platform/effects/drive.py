"""The platform is moved by a position controller with a limited force, against dry friction."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from hiltestbed.effects.base import Effect
from hiltestbed.effects.departure import quantity
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.platform.effects.response import pace
from hiltestbed.platform.effects.tracking import AXES
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.platform.parameters import PlatformParameters
    from hiltestbed.scenario import Scenario

MAX_ERROR = 0.5  # share of the travel: largest following error that friction or load may cause
# share of the travel by which an axis stops short of its command: starting values of the search
STOPS = (0.002, 0.02)


@register
class PlatformDrive(Effect):
    """A position controller that works against dry friction and a load, with a limited force."""

    kind: Literal["platform.drive"] = "platform.drive"
    bandwidth: float = quantity(
        "Hz",
        "Natural frequency of the moving mass on the controller's gain",
        gt=0.0,
        le=2000.0,
        search=(0.5, 400.0),
        ratio=True,
    )
    damping_ratio: float = quantity(
        "-", "Damping ratio", default=0.7, ge=0.0, le=20.0, search=(0.05, 5.0), ratio=True
    )
    friction: float = quantity(
        "m",
        "Coulomb friction over the controller's gain: following error at which the axis stops",
        default=0.0,
        ge=0.0,
        search=(0.0, 2e-3),
    )
    offset: float = quantity(
        "m",
        "Load over the controller's gain: offset of the axis from its command",
        default=0.0,
        search=(-2e-3, 2e-3),
    )
    acceleration_limit: float | None = quantity(
        "m/s^2",
        "Force limit of the drive over the moving mass; none by default",
        default=None,
        gt=0.0,
        search=(1e-3, 1e3),
        ratio=True,
    )
    integral_time: float | None = quantity(
        "s",
        "Integral time of the controller; none by default",
        default=None,
        gt=0.0,
        search=(5e-3, 100.0),
        ratio=True,
    )
    static: float | None = quantity(
        "-", "Ratio of static to Coulomb friction; 1 by default", default=None, ge=1.0, le=10.0
    )
    axis: Literal["all", "x", "y", "z"] = Field(
        default="all", description="Axis of translation with this drive, or all three"
    )
    link = "platform"
    equation = (
        "x'' = sat(w^2 (x_cmd - x + q), acceleration_limit) - 2 damping_ratio w x' - w^2 friction "
        "sgn(x') + w^2 offset, q' = (x_cmd - x)/integral_time, w = 2 pi bandwidth; at rest it "
        "holds while |sat(w^2 (x_cmd - x + q), acceleration_limit) + w^2 offset| <= w^2 static "
        "friction"
    )
    reference = "position controller against Coulomb friction"
    resembles = ("platform.lag", "platform.backlash", "platform.friction", "platform.mode")
    leading = "friction"
    rich = True

    def apply(self, p: PlatformParameters) -> None:
        w, limit, integral = 2.0 * math.pi * self.bandwidth, math.inf, math.inf
        if self.acceleration_limit is not None:
            limit = self.acceleration_limit
        if self.integral_time is not None:
            integral = self.integral_time
        static = 1.0 if self.static is None else self.static
        own = w, self.damping_ratio, self.friction, self.offset, limit, integral, static
        p.drive[slice(None) if self.axis == "all" else AXES.index(self.axis)] = own

    def unfit(self, scenario: Scenario) -> str | None:
        """By Routh's criterion s^3 + 2 zeta w s^2 + w^2 s + w^2/T_i is stable if 2 zeta w T_i >
        1.
        """
        if self.integral_time is None:
            return None
        loss = 4.0 * math.pi * self.damping_ratio * self.bandwidth
        least = 1.0 / loss if loss > 0.0 else math.inf
        if self.integral_time > least:
            return None
        return (
            f"is unstable by itself with an integral_time of {self.integral_time:g} s; allowed is "
            f"more than 1/(4 pi damping_ratio bandwidth) = {least:g} s: give a longer one, or more "
            "bandwidth or damping"
        )

    def worth(self, tick: float, frequency: float) -> float:
        """Delay of the linear part: that of friction and force limit depends on the amplitude."""
        w, s = 2.0 * math.pi * self.bandwidth, 1j * frequency
        if self.integral_time is None:
            return 2.0 * self.damping_ratio / w
        gain = w * w * (1.0 + 1.0 / (self.integral_time * s))
        return -cmath.phase(gain / (s * s + 2.0 * self.damping_ratio * w * s + gain)) / frequency

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        slow, travel = pace(scales.tick), max(scales.travel, 1e-3)
        far = max(2e-3, MAX_ERROR * travel)
        bounds = {
            "bandwidth": (2.0 * slow, 400.0), "friction": (0.0, far), "offset": (-far, far),
            "acceleration_limit": (1e-2 * scales.fast**2 / travel, 1e2 * scales.fast / scales.tick),
            "integral_time": (5.0 * scales.tick, 100.0 * max(scales.duration, 1.0)),
        }  # fmt: skip
        bands = [slow * f for f in (5, 12, 30, 75, 180)]
        linear = {"bandwidth": bands, "damping_ratio": [0.3, 1.0]}
        dry = linear | {"friction": [part * travel for part in STOPS]}
        few = {"bandwidth": [slow * f for f in (12, 40, 120)], "damping_ratio": [0.6]}
        few |= {"friction": [STOPS[0] * travel]}
        limits = [part * scales.fast**2 / travel for part in (0.3, 1.0, 3.0, 10.0)]
        for grid in (
            linear,
            dry,
            dry | {"offset": [0.0]},
            few | {"offset": [0.0], "acceleration_limit": limits},
            few | {"integral_time": [20.0 * scales.tick, 200.0 * scales.tick]},
        ):
            own_bounds = {name: bounds[name] for name in grid if name in bounds}
            yield candidate(cls, grid, bounds=own_bounds)
