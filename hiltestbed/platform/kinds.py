"""The motion platforms that a scenario may name: each is defined by its settings class, and no
other code refers to it by name.

Every parameter of a drive is a key with unit, default and source. The source [recalled] marks an
order of magnitude from memory, not a figure that was looked up. Needs only pydantic.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import Field, Strict

from hiltestbed.config.validation import NotNegative, Positive, Problem, Strictly
from hiltestbed.plugins import Registry, kind_of

if TYPE_CHECKING:
    from hiltestbed.scenario.like import ScenarioLike as Scenario


class Platform(Strictly):
    """The motion platform of a scenario: base of every kind.

    A user's kind derives from it, gives ``kind`` as a literal and a method ``facility()``, which
    returns a :class:`hiltestbed.platform.facilities.facility.Facility` and raises InputError for a
    model that does not suit; the facilities of the shipped kinds are in
    :mod:`hiltestbed.platform.build`.

    Attributes:
        tracking: servo: moved by its drives; ideal: the pose reaches the command exactly, one tick
            later; free: nothing is commanded.
        physical: whether freely moving bodies replace the numerical model.
    """

    PARTS: ClassVar[tuple[str, ...]] = ("docstring", "facility")
    physical: ClassVar[bool] = False
    # whether its facility gives the joints' limits; else all are in the scenario's safety section
    states_limits: ClassVar[bool] = True
    # parts of a pose that this rig cannot move, and that a record may lack
    still: ClassVar[tuple[str, ...]] = ()
    carries_upper: ClassVar[bool] = False  # whether an upper platform may carry the passive side
    # whether the start is checked on the facility's model; else by its settings alone
    start_needs_model: ClassVar[bool] = True
    # fields that describe its drives, which have no effect on a prescribed platform
    drives: ClassVar[tuple[str, ...]] = ()

    kind: str
    if TYPE_CHECKING:  # a field of every kind, with choices of its own
        tracking: Any
        response: Any

    @property
    def prescribed(self) -> bool:
        """Whether the pose is prescribed, without mass; else drives or bodies are simulated."""
        return getattr(self, "tracking", "free") in ("ideal", "response")

    def idle(self, scenario: Scenario) -> Iterator[Problem]:
        tracking = getattr(self, "tracking", "free")
        if tracking == "response":
            why = (
                "tracking is response, in which rig.platform.response replaces drives and "
                "controller; put delay and bandwidth there (response.delay, response.bandwidth), "
                "or take tracking servo"
            )
            yield from (((name,), why) for name in self.drives)
        elif tracking == "ideal":
            why = (
                "tracking is ideal, in which the pose reaches the command exactly; take "
                "tracking servo or response"
            )
            yield from (((name,), why) for name in (*self.drives, "response"))
        elif tracking == "servo":
            simulated = "tracking is servo, in which the drives themselves are simulated"
            yield ("response",), f"{simulated}; take tracking response"

    def problems(self, scenario: Scenario) -> Iterator[Problem]:
        """What a scenario requires that these settings exclude. Paths: in the scenario."""
        command = getattr(self, "command", None)
        for path, message in command.problems(scenario.rate) if command else ():
            yield ("rig", "platform", "command", *path), message

    def start_problems(self, scenario: Scenario) -> Iterable[Problem]:
        """What else than the facility's own model says against the start. Paths: in the
        scenario.
        """
        return ()

    def reference(self) -> dict[str, Any]:
        """The platform of a reference run without rig errors: the same, with exact tracking."""
        return self.model_dump(mode="json") | {"tracking": "ideal"}

    def cure(self, lost: float) -> tuple[str, dict[str, Any]]:
        """The usual compensation of the lags of this kind of rig: in words, and as a scenario's
        compensation.

        Args:
            lost: damping [N s/m] that the lags of sensor and platform remove from the contact, for
                methods designed from it.
        """
        lead = {"force": {"kind": "phase_lead"}, "motion": {"kind": "feedforward"}}
        return "phase lead of the force", lead

    @classmethod
    def contest(cls) -> Mapping[str, Mapping[str, Any]]:
        """Name to `rig.platform` of each of its variants that takes part in `bench facilities`; by
        default one, with default settings.

        A kind with required settings takes part only if it overrides this method and gives them.
        """
        kind, fields = kind_of(cls), cls.model_fields.items()
        needs = any(field.is_required() and name != "kind" for name, field in fields)
        return {} if kind is None or needs else {kind: {"kind": kind}}

    # how this kind of rig distorts a contact, in two or three sentences
    distorts: ClassVar[str] = ""


PLATFORMS: Registry[Platform] = Registry(
    "platform", Platform, ("hiltestbed.platform.shipped.pss33", "hiltestbed.platform.shipped")
)


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

    def idle(self, scenario: Scenario) -> Iterator[Problem]:
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
