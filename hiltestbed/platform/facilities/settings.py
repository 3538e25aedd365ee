"""What a scenario says of a facility: every number of a drive as a key with unit, default and source. It needs pydantic alone.

A source in brackets, [recalled], is an order of magnitude from memory, not a figure that was looked up.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import Field, Strict

from hiltestbed.platform.kinds import Platform
from hiltestbed.plugins import placeholder
from hiltestbed.validation import NotNegative, Positive, Problem, Strictly

if TYPE_CHECKING:
    from hiltestbed.platform.facilities.facility import Facility
    from hiltestbed.scenario import Scenario

Ratio = Annotated[float, Field(gt=0, le=10)]
SixPositive = Annotated[tuple[Positive, ...], Strict(False), Field(min_length=6, max_length=6)]


class CommandPath(Strictly):
    """How commands reach a facility's drives."""

    controller_rate: Positive | None = Field(
        default=None, description="Rate of the facility's own controller [Hz], which interpolates in between; null: that of the loop"
    )
    delay_cycles: Annotated[int, Field(ge=0, le=200)] = Field(
        default=0, description="Whole cycles for which the controller holds a command back [-]"
    )

    def cycle(self, rate: float) -> int:
        """Ticks of a controller's cycle, at the loop's rate [Hz]."""
        return 1 if self.controller_rate is None else max(1, round(rate / self.controller_rate))

    def lag(self, rate: float) -> float:
        """How late the controller is [s]: a pose meant for the end of its tick arrives at the end of a cycle that begins later."""
        return (self.cycle(rate) * (self.delay_cycles + 1) - 1) / rate

    def problems(self, rate: float) -> Iterator[tuple[tuple[str | int, ...], str]]:
        """A controller's cycle is a whole number of ticks."""
        if self.controller_rate is None:
            return
        ratio = rate / self.controller_rate
        if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-9 * ratio:
            near = rate / max(1, round(ratio))
            yield (
                ("controller_rate",),
                f"does not divide the loop's rate (got {self.controller_rate:g} Hz in a loop of {rate:g} Hz = {ratio:g} passes a cycle); "
                f"allowed is the rate over a whole number, such as {near:g}",
            )


class Friction(Strictly):
    """Dry friction of a drive; all zero: none."""

    coulomb: NotNegative = Field(description="Sliding friction [N, N m]")
    stiction: NotNegative = Field(description="Break-away friction [N, N m], at least coulomb")
    stribeck_speed: Positive = Field(description="Speed at which the break-away excess has fallen to 1/e [m/s, rad/s]")
    viscous: NotNegative = Field(description="Viscous friction [N s/m, N m s/rad]")


class ResponseSettings(Strictly):
    """A response of each axis in place of simulated drives."""

    order: Literal[2, 3] = Field(default=2, description="Order of each axis [-]")
    bandwidth: Positive | SixPositive = Field(default=20.0, description="Natural frequency [Hz] of all axes or x, y, z, rx, ry, rz")
    damping_ratio: Positive | SixPositive = Field(default=0.7, description="Damping ratio [-] of all axes or of each")
    gain: Positive | SixPositive = Field(default=60.0, description="Gain of order 3 [1/s] of all axes or of each")
    delay: NotNegative = Field(default=0.0, description="Pure delay [s], any length")

    def idle(self, scenario: Scenario) -> Iterator[Problem]:
        if self.order == 2:
            yield ("gain",), "the response's order is 2, which has none; take order 3"


class Driven(Platform):
    """A platform of this package that is told where to go."""

    PARTS: ClassVar[tuple[str, ...]] = ("docstring", "build")

    tracking: Literal["servo", "response", "ideal"] = Field(
        default="servo",
        description="How it follows. servo: its dynamics under its drives; response: a second or third order with a delay in their place; "
        "ideal: the pose reaches the command exactly, one tick later",
    )
    response: ResponseSettings = Field(
        default=ResponseSettings(), description="What it answers to its command; with tracking response alone"
    )

    @placeholder
    def build(self) -> Facility:
        """The facility that these settings describe. Raises InputError for a model of the user's own that does not do."""
        raise NotImplementedError

    def facility(self) -> Facility:
        return _built(self, self.stamp())  # type: ignore[arg-type]  # frozen, thus hashable

    def stamp(self) -> Hashable:
        """What of a model may change while its settings stay: nothing of a shipped one."""
        return None


@lru_cache(maxsize=32)
def _built(settings: Driven, stamp: Hashable) -> Facility:
    return settings.build()


class Physical(Platform):
    """A hall in which bodies move by themselves."""

    PARTS: ClassVar[tuple[str, ...]] = ("docstring", "build")
    physical: ClassVar[bool] = True
    tracking: ClassVar[str] = "free"

    @placeholder
    def build(self) -> Facility:
        """The hall that these settings describe."""
        raise NotImplementedError

    def facility(self) -> Facility:
        return self.build()

    def alike(self, scenario: Scenario) -> Hashable:
        return (super().alike(scenario), scenario.spacecraft.model_dump_json())

    def reference(self) -> dict[str, Any]:
        return {"kind": "pss33", "tracking": "ideal"}
