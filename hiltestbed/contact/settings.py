"""The mechanism's section of a scenario."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from pydantic import Field, model_validator

from hiltestbed.plugins import OneOf, Registry, placeholder
from hiltestbed.validation import NotNegative, Positive, Problem, Strictly, refuse

if TYPE_CHECKING:
    from mujoco import MjSpec

    from hiltestbed.contact.description import Phase
    from hiltestbed.contact.sides import Rule
    from hiltestbed.scenario import Scenario


class Contact(Strictly):
    """Contact of the mechanism's surfaces: F = stiffness x + damping v, never pulling in a bumper or a cone."""

    stiffness: Positive = Field(description="Stiffness of the surfaces [N/m]")
    damping: NotNegative = Field(default=0.0, description="Damping of the surfaces [N s/m]")
    friction: Annotated[float, Field(ge=0, le=2)] = Field(default=0.0, description="Coulomb coefficient between the surfaces [-]")


class Mount(Strictly):
    """Compliance of the passive side between the mechanism and the sensor: x, y, z, rx, ry, rz."""

    stiffness: Annotated[tuple[Positive, ...], Field(strict=False, min_length=6, max_length=6)] = Field(
        description="Stiffness of each axis, 3 x [N/m] and 3 x [N m/rad]"
    )
    damping: Annotated[tuple[NotNegative, ...], Field(strict=False, min_length=6, max_length=6)] = Field(
        default=(0.0,) * 6, description="Damping of each axis, 3 x [N s/m] and 3 x [N m s/rad]"
    )


class Latch(Strictly):
    """When the latches of a probe in its cone close: all three hold at once. From then on the mechanism pulls as well as pushes."""

    depth: Annotated[float, Field(ge=0, le=0.1)] = Field(
        default=0.004, description="Distance of the tip from the nominal touch up to which the latches close [m]: pz >= -depth"
    )
    angle_deg: Annotated[float, Field(gt=0, le=30)] = Field(
        default=5.0, description="Largest angle between the axes of both sides at which the latches close [deg]"
    )
    speed: Positive = Field(default=0.02, description="Highest relative speed of A's origin at which the latches close [m/s]")


class Mechanism(Strictly):
    """The docking mechanism: what touches what. Base of every kind.

    Attributes:
        captured: whether it holds from the start. flat: whether the passive surface is the plane z = 0 of P.
        latches: whether a latch may close while it runs.
    """

    PARTS: ClassVar[tuple[str, ...]] = ("docstring", "files")

    kind: str
    contact: Contact = Field(description="Stiffness, damping and friction of the surfaces that touch")
    mount: Mount | None = Field(default=None, description="Compliance between the passive mechanism and the sensor; null: rigid")
    latch: Latch | None = Field(default=None, description="When the latches of a mechanism that captures close; null: it has none")
    captured: ClassVar[bool] = False
    flat: ClassVar[bool] = False
    latches: ClassVar[bool] = False

    def idle(self, scenario: Scenario) -> Iterable[Problem]:
        if self.captured and self.contact.friction > 0.0:
            yield ("contact", "friction"), f"a mechanism of kind {self.kind} holds from the start, nothing slides in it; leave it out"

    @placeholder
    def files(self) -> tuple[Path, Path]:
        """The MJCF of the active and of the passive side, with the sites A and P."""
        raise NotImplementedError

    def fingerprint(self) -> dict[str, str]:
        """Keys of the section that name a file of the user's, and the SHA-256 of all that the file holds."""
        return {}

    def sides(self) -> tuple[MjSpec, MjSpec]:
        """Both sides as MJCF, every geom and body with a name. Raises InputError."""
        from hiltestbed.contact.sides import named

        active, passive = self.files()
        return named(active), named(passive)

    def rules(self) -> tuple[Rule, ...]:
        """Which geoms may touch; one rule without names: those that MuJoCo would let collide."""
        from hiltestbed.contact.sides import Rule

        return (Rule(),)

    def contacts(self) -> tuple[Contact, ...]:
        """Stiffness, damping and friction of each rule."""
        return (self.contact,)

    def latch_contact(self) -> Contact:
        """Stiffness and damping of the latch."""
        return self.contact

    def phases(self) -> tuple[Phase, ...]:
        """The steps of capture, in their order."""
        return ()

    def shape(self) -> Hashable:
        """What its MuJoCo model depends on, apart from numbers: runs of one shape go in lockstep."""
        return (self.kind, *map(str, self.files()), self.rules(), tuple(p.model_dump_json() for p in self.phases()))

    @model_validator(mode="after")
    def _may_latch(self) -> Mechanism:
        if self.latch is not None and not self.latches:
            able = ", ".join(kind for kind, cls in MECHANISMS.items() if cls.latches)
            refuse([(("latch",), f"belongs to a mechanism that captures (got kind {self.kind!r}); allowed: null, or kind {able}")])
        return self


MECHANISMS: Registry[Mechanism] = Registry("mechanism", Mechanism, ("hiltestbed.contact.mechanisms",))
AnyMechanism = Annotated[Mechanism, OneOf(MECHANISMS, default="bumper")]
