"""The mechanism section of a scenario."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from pydantic import Field, model_validator

from hiltestbed.config.validation import NotNegative, Positive, Problem, Strictly, refuse
from hiltestbed.contact.description import Rule
from hiltestbed.plugins import OneOf, Registry, placeholder

if TYPE_CHECKING:
    from mujoco import MjSpec

    from hiltestbed.contact.active_ring import ActiveRing
    from hiltestbed.contact.description import Phase
    from hiltestbed.scenario.like import ScenarioLike


class Contact(Strictly):
    """Contact of the mechanism's surfaces: F = stiffness x + damping v; in a bumper or a cone never
    negative (no pulling).
    """

    stiffness: Positive = Field(description="Contact stiffness [N/m]")
    damping: NotNegative = Field(default=0.0, description="Contact damping [N s/m]")
    friction: Annotated[float, Field(ge=0, le=2)] = Field(
        default=0.0, description="Coulomb friction coefficient between the surfaces [-]"
    )


class Mount(Strictly):
    """Compliant mount of the passive side, between mechanism and sensor; axes x, y, z, rx, ry,
    rz.
    """

    stiffness: Annotated[tuple[Positive, ...], Field(strict=False, min_length=6, max_length=6)] = (
        Field(description="Stiffness of each axis, 3 x [N/m] and 3 x [N m/rad]")
    )
    damping: Annotated[tuple[NotNegative, ...], Field(strict=False, min_length=6, max_length=6)] = (
        Field(
            default=(0.0,) * 6, description="Damping of each axis, 3 x [N s/m] and 3 x [N m s/rad]"
        )
    )


class Latch(Strictly):
    """Condition for the latches of a probe in its cone to close: all three limits hold at once.
    From then on the mechanism can pull.
    """

    depth: Annotated[float, Field(ge=0, le=0.1)] = Field(
        default=0.004,
        description="Largest distance of the tip before the nominal touch at which the latches "
        "close [m]: pz >= -depth",
    )
    angle_deg: Annotated[float, Field(gt=0, le=30)] = Field(
        default=5.0,
        description="Largest angle between the z axes of A and P at which the latches close [deg]",
    )
    speed: Positive = Field(
        default=0.02,
        description="Highest relative speed of A's origin at which the latches close [m/s]",
    )


class Mechanism(Strictly):
    """The docking mechanism: its two sides and their contacts. Base of every kind.

    Attributes:
        captured: whether it is captured from the start. flat: whether the passive surface is the
            plane z = 0 of P.
        latches: whether a latch may close during a run.
    """

    PARTS: ClassVar[tuple[str, ...]] = ("docstring", "files")

    kind: str
    contact: Contact = Field(description="Stiffness, damping and friction of the contact")
    mount: Mount | None = Field(
        default=None,
        description="Compliant mount between the passive mechanism and the sensor; null: rigid",
    )
    latch: Latch | None = Field(
        default=None, description="Condition for the latches to close; null: no latches"
    )
    captured: ClassVar[bool] = False
    flat: ClassVar[bool] = False
    latches: ClassVar[bool] = False

    def idle(self, scenario: ScenarioLike) -> Iterable[Problem]:
        if self.captured and self.contact.friction > 0.0:
            yield (
                ("contact", "friction"),
                f"a mechanism of kind {self.kind} is captured from the start, nothing slides in "
                f"it; leave it out",
            )

    @placeholder
    def files(self) -> tuple[Path, Path]:
        """The MJCF of the active and of the passive side, with the sites A and P."""
        raise NotImplementedError

    def sides(self) -> tuple[MjSpec, MjSpec]:
        """Both sides as MJCF, with every geom and body named. Raises InputError."""
        from hiltestbed.config.part import named

        active, passive = self.files()
        return named(active), named(passive)

    def rules(self) -> tuple[Rule, ...]:
        """Which geoms may touch; by default all that MuJoCo would let collide."""
        return (Rule(),)

    def contacts(self) -> tuple[Contact, ...]:
        """Stiffness, damping and friction of each rule."""
        return (self.contact,)

    @property
    def captures(self) -> bool:
        """Whether its sides are held to each other at some time."""
        return self.captured or self.latch is not None or bool(self.phases())

    def phases(self) -> tuple[Phase, ...]:
        """The phases of capture, in order."""
        return ()

    def actuated(self) -> ActiveRing | None:
        """The legs that drive its ring, if any do."""
        return None

    def shape(self) -> Hashable:
        """What its MuJoCo model depends on apart from numbers: equal ones run in lockstep."""
        return (
            self.kind,
            *map(str, self.files()),
            self.rules(),
            tuple(p.model_dump_json() for p in self.phases()),
        )

    @model_validator(mode="after")
    def _may_latch(self) -> Mechanism:
        if self.latch is not None and not self.latches:
            able = ", ".join(kind for kind, cls in MECHANISMS.items() if cls.latches)
            refuse(
                [
                    (
                        ("latch",),
                        f"belongs to a mechanism that captures (got kind {self.kind!r}); allowed: "
                        f"null, or kind {able}",
                    )
                ]
            )
        return self


MECHANISMS: Registry[Mechanism] = Registry(
    "mechanism", Mechanism, ("hiltestbed.contact.mechanisms",)
)
AnyMechanism = Annotated[Mechanism, OneOf(MECHANISMS, default="bumper")]
