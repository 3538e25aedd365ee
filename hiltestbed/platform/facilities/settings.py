"""Settings of a facility in a scenario: every parameter of a drive as a key with unit, default and
source. Needs only pydantic.

The source [recalled] marks an order of magnitude from memory, not a figure that was looked up.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import Field, Strict

from hiltestbed.config.validation import NotNegative, Positive, Problem, Strictly
from hiltestbed.platform.kinds import Platform

if TYPE_CHECKING:
    from hiltestbed.scenario.like import ScenarioLike

Ratio = Annotated[float, Field(gt=0, le=10)]
SixPositive = Annotated[tuple[Positive, ...], Strict(False), Field(min_length=6, max_length=6)]


class CommandPath(Strictly):
    """Path of commands to a facility's drives."""

    controller_rate: Positive | None = Field(
        default=None,
        description="Rate of the facility's own controller [Hz], which interpolates between "
        "commands; null: the loop's rate",
    )
    delay_cycles: Annotated[int, Field(ge=0, le=200)] = Field(
        default=0, description="Delay of commands in the controller, in whole cycles [-]"
    )

    def cycle(self, rate: float) -> int:
        """Ticks of a controller's cycle, at the loop's rate [Hz]."""
        return 1 if self.controller_rate is None else max(1, round(rate / self.controller_rate))

    def problems(self, rate: float) -> Iterator[tuple[tuple[str | int, ...], str]]:
        """Check that the controller's cycle is a whole number of ticks."""
        if self.controller_rate is None:
            return
        ratio = rate / self.controller_rate
        if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-9 * ratio:
            near = rate / max(1, round(ratio))
            yield (
                ("controller_rate",),
                f"does not divide the loop's rate (got {self.controller_rate:g} Hz in a loop of "
                f"{rate:g} Hz = {ratio:g} ticks per cycle); "
                f"allowed is the loop's rate divided by a whole number, such as {near:g}",
            )


class Friction(Strictly):
    """Friction of a drive; all zero: none."""

    coulomb: NotNegative = Field(description="Sliding friction [N, N m]")
    stiction: NotNegative = Field(description="Break-away friction [N, N m], at least coulomb")
    stribeck_speed: Positive = Field(
        description="Speed at which the excess of the break-away friction has fallen to 1/e [m/s, "
        "rad/s]"
    )
    viscous: NotNegative = Field(description="Viscous friction [N s/m, N m s/rad]")

    def law(self) -> tuple[float, ...]:
        """Coulomb, stiction, Stribeck speed, viscous, bias speed, as in the drives' friction."""
        return self.coulomb, self.stiction, self.stribeck_speed, self.viscous, 0.0


class ResponseSettings(Strictly):
    """A response of each axis instead of simulated drives."""

    order: Literal[2, 3] = Field(default=2, description="Order of each axis [-]")
    bandwidth: Positive | SixPositive = Field(
        default=20.0, description="Natural frequency [Hz] of all axes or x, y, z, rx, ry, rz"
    )
    damping_ratio: Positive | SixPositive = Field(
        default=0.7, description="Damping ratio [-] of all axes or of each"
    )
    gain: Positive | SixPositive = Field(
        default=60.0, description="Gain of order 3 [1/s] of all axes or of each"
    )
    delay: NotNegative = Field(default=0.0, description="Pure delay [s], any length")

    def idle(self, scenario: ScenarioLike) -> Iterator[Problem]:
        if self.order == 2:
            yield ("gain",), "the response's order is 2, which has no gain; take order 3"


class Driven(Platform):
    """A platform of this package that follows commands."""

    PARTS: ClassVar[tuple[str, ...]] = ("docstring",)

    tracking: Literal["servo", "response", "ideal"] = Field(
        default="servo",
        description="Tracking. servo: dynamics with simulated drives; response: a second- or "
        "third-order response with a delay instead; "
        "ideal: the pose reaches the command exactly, one tick later",
    )
    response: ResponseSettings = Field(
        default=ResponseSettings(),
        description="Response to the command; only with tracking response",
    )

    def stamp(self) -> Hashable:
        """State of the model's file, which may change; None for a shipped model."""
        return None


class Physical(Platform):
    """A hall in which the bodies move freely."""

    PARTS: ClassVar[tuple[str, ...]] = ("docstring",)
    physical: ClassVar[bool] = True
    tracking: ClassVar[str] = "free"

    def reference(self) -> dict[str, Any]:
        return {"kind": "pss33", "tracking": "ideal"}
