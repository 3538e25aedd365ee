"""How a servo follows its command."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Literal

from hiltestbed.axis import servo
from hiltestbed.axis.effects.base import RecordScale, ServoEffect, Sought
from hiltestbed.effects.departure import quantity
from hiltestbed.effects.search import Candidate, candidate
from hiltestbed.plugins import register

# [Hz] of a response, from which it is sought; those that the rows resolve are tried
BANDWIDTHS = (0.3, 0.8, 2.0, 5.0, 12.0, 30.0, 80.0, 200.0)
MOST_PHASE = 2.0  # [rad] of a response over a row: a faster one is not resolved


def bandwidths(reach: RecordScale) -> list[float]:
    """[Hz] that the rows of a record resolve."""
    return [f for f in BANDWIDTHS if 2.0 * math.pi * f * reach.tick < MOST_PHASE]


def _fastest(reach: RecordScale) -> float:
    return MOST_PHASE / (2.0 * math.pi * reach.tick)


@register
class ServoDelay(ServoEffect):
    """A transport delay between command and position: of the servo, or of its telemetry."""

    kind: Literal["platform.delay"] = "platform.delay"
    delay: float = quantity("s", "Transport delay", ge=0.0)
    equation = "x(t) = x_cmd(t - delay)"
    reference = "pure transport delay"
    resembles = ("platform.lag",)
    adds = {"delay": servo.DELAY}

    @classmethod
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        h = reach.tick
        most = max(40.0 * h, 0.5)
        starts = [h * n for n in (1.0, 2.0, 4.0, 8.0, 16.0, 32.0) if h * n < most]
        yield candidate(cls, {"delay": starts}, bounds={"delay": (0.0, most)})


@register
class ServoDrive(ServoEffect):
    """A position controller that works against dry friction and a load, with a limited force."""

    kind: Literal["platform.drive"] = "platform.drive"
    bandwidth: float = quantity(
        "Hz", "Natural frequency of the moving mass on the controller's gain", gt=0.0, ratio=True
    )
    damping_ratio: float = quantity(
        "-", "Damping ratio", default=0.7, ge=0.0, search=(0.05, 20.0), ratio=True
    )
    friction: float = quantity(
        "m", "Following error at which the axis stops, by dry friction", default=0.0, ge=0.0
    )
    offset: float = quantity("m", "Droop under a load", default=0.0)
    acceleration_limit: float | None = quantity(
        "m/s^2",
        "Force limit over the moving mass; none by default",
        default=None,
        gt=0.0,
        ratio=True,
    )
    integral_time: float | None = quantity(
        "s", "Integral time of the controller; none by default", default=None, gt=0.0, ratio=True
    )
    static: float | None = quantity(
        "-", "Ratio of static to dry friction; 1 by default", default=None, ge=1.0
    )
    feed_forward: float = quantity(
        "-", "Share of the command's speed that is fed forward", default=0.0, search=(0.0, 2.0)
    )
    equation = (
        "x'' = sat(w^2 (x_cmd - x + q), acceleration_limit) + 2 damping_ratio w (feed_forward "
        "x_cmd' - x') - w^2 friction sgn(x') + w^2 offset, q' = (x_cmd - x)/integral_time"
    )
    reference = "position controller against Coulomb friction"
    resembles = ("platform.lag", "platform.backlash", "platform.friction", "platform.mode")

    def apply(self, p: Any) -> None:
        p[servo.BANDWIDTH], p[servo.ZETA] = 2.0 * math.pi * self.bandwidth, self.damping_ratio
        p[servo.FRICTION], p[servo.LOAD] = self.friction, self.offset
        p[servo.STATIC] = self.friction * (1.0 if self.static is None else self.static)
        p[servo.AHEAD] = self.feed_forward
        if self.acceleration_limit is not None:
            p[servo.ACCELERATION] = self.acceleration_limit
        if self.integral_time is not None:
            p[servo.INTEGRAL] = self.integral_time

    @classmethod
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        found, x = bandwidths(reach), reach.travel
        if not found:
            return
        ends = {"bandwidth": (0.05, _fastest(reach))}
        yield candidate(cls, {"bandwidth": found}, bounds=ends)
        base = ("platform.drive:bandwidth",)
        yield candidate(cls, {"damping_ratio": [0.3, 1.0, 3.0]}, needs=base)
        yield candidate(
            cls,
            {"friction": [0.002 * x, 0.01 * x, 0.05 * x]},
            bounds={"friction": (0.0, 0.5 * x)},
            needs=base,
        )
        yield candidate(cls, {"feed_forward": [0.5]}, needs=base)
        most = max(reach.acceleration, reach.speed**2 / x)
        yield candidate(
            cls,
            {"acceleration_limit": [most, 0.3 * most, 0.1 * most]},
            bounds={"acceleration_limit": (1e-3 * most, 100.0 * most)},
            needs=base,
        )
        yield candidate(
            cls,
            {"integral_time": [0.05, 0.3, 2.0]},
            bounds={"integral_time": (5.0 * reach.tick, 100.0 * max(reach.duration, 1.0))},
            needs=base,
        )
        yield candidate(
            cls,
            {"static": [1.3]},
            bounds={"static": (1.0, 10.0)},
            needs=("platform.drive:friction",),
        )


@register
class ServoPoles(ServoEffect):
    """Two poles in series, as of a hydraulic drive: the valve, and the cylinder that its flow
    fills.
    """

    kind: Literal["platform.poles"] = "platform.poles"
    first: float = quantity("s", "Larger time constant", gt=0.0, ratio=True)
    second: float = quantity("s", "Smaller time constant", default=0.0, ge=0.0, ratio=True)
    equation = "first r' = x_cmd - r, second x' = r - x"
    reference = "H. E. Merritt, Hydraulic Control Systems, 1967"
    resembles = ("platform.lag", "platform.delay")

    def apply(self, p: Any) -> None:
        p[servo.POLE], p[servo.SECOND_POLE] = self.first, self.second

    @classmethod
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        times = [1.0 / (2.0 * math.pi * f) for f in bandwidths(reach)]
        if not times:
            return
        ends = (0.1 * reach.tick, 5.0)
        yield candidate(cls, {"first": times}, bounds={"first": ends})
        yield candidate(
            cls,
            {"second": [times[-1], times[len(times) // 2]]},
            bounds={"second": ends},
            needs=("platform.poles:first",),
        )


@register
class ServoPlay(ServoEffect):
    """Play that is taken up at each reversal."""

    kind: Literal["platform.backlash"] = "platform.backlash"
    width: float = quantity("m", "Total width of the play", ge=0.0)
    equation = "x = min(max(x, x_cmd - width/2), x_cmd + width/2)"
    reference = "play operator"
    resembles = ("platform.drive",)
    adds = {"width": servo.PLAY}
    sought = {"width": Sought((0.003, 0.01, 0.05), (0.0, 0.5), lambda reach: reach.travel)}


@register
class ServoScale(ServoEffect):
    """The motion is scaled."""

    kind: Literal["platform.scale"] = "platform.scale"
    factor: float = quantity("-", "Ratio of actual to commanded motion", search=(-0.5, 2.0))
    equation = "x = factor x_cmd"
    reference = "geometric calibration error"
    multiplies = {"factor": (servo.SCALE,)}
    sought = {"factor": Sought((1.0,))}


@register
class ServoOffset(ServoEffect):
    """The axis stands off its command by a constant: the droop of a controller without integral
    action under a load, or another zero.
    """

    kind: Literal["platform.offset"] = "platform.offset"
    offset: float = quantity("m", "Position at a command of zero")
    equation = "x += offset"
    reference = "droop under a load, or zero of the encoder"
    resembles = ("platform.drive",)
    adds = {"offset": servo.OFFSET}
    sought = {"offset": Sought((0.0,), (-1.0, 1.0), lambda reach: reach.travel)}


@register
class ServoSpeedLimit(ServoEffect):
    """The axis follows its command no faster than a limit: of its motor, or of the flow of oil."""

    kind: Literal["platform.speed_limit"] = "platform.speed_limit"
    speed: float = quantity("m/s", "Maximum speed", gt=0.0, ratio=True)
    equation = "|x'| <= speed"
    reference = "actuator rate limit"
    vanishes = True
    sought = {"speed": Sought((0.9, 0.5, 0.2), (1e-3, 1.5), lambda reach: reach.speed)}

    def apply(self, p: Any) -> None:
        p[servo.SPEED] = min(p[servo.SPEED], self.speed)
