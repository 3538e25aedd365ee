"""The shipped mechanisms, and the user's own. Most have a description file beside their MJCF:
classes of geom pairs that may touch, and phases of capture.
"""

from __future__ import annotations

from collections.abc import Hashable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator

from hiltestbed.config.models import models_folder
from hiltestbed.config.validation import ModelFile
from hiltestbed.contact import description
from hiltestbed.contact.active_ring import ActiveRing
from hiltestbed.contact.description import Phase, Rule, Touching
from hiltestbed.contact.settings import Contact, Mechanism
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from mujoco import MjSpec


class _Shipped(Mechanism):
    """Base of the mechanisms whose ``folder`` in ``models`` holds active.xml and passive.xml."""

    folder: ClassVar[str] = ""

    def files(self) -> tuple[Path, Path]:
        folder = models_folder() / self.folder
        return folder / "active.xml", folder / "passive.xml"


class Described(_Shipped):
    """Base of those whose folder also holds mechanism.yaml."""

    contact: Contact = Field(
        # never used: the validator below fills it in
        default_factory=lambda: Contact(stiffness=1.0),
        description="Stiffness, damping and friction of the first class of pairs; what is omitted: "
        "as in the mechanism's own description",
    )

    @model_validator(mode="before")
    @classmethod
    def _first_class(cls, data: Any) -> Any:
        """What ``contact`` leaves out is that of the first class of pairs."""
        if not isinstance(data, dict) or not isinstance(given := data.get("contact", {}), dict):
            return data
        return {**data, "contact": cls._own_contact(data) | given}

    @classmethod
    def _own_contact(cls, data: dict[str, Any]) -> dict[str, Any]:
        """The numbers of the first class of pairs."""
        return _numbers(cls.described().contact[0]).model_dump()

    @classmethod
    def described(cls) -> description.MechanismFile:
        """The content of mechanism.yaml. Raises InputError."""
        file = models_folder() / cls.folder / "mechanism.yaml"
        return description.read(file, file.stat().st_mtime_ns if file.is_file() else 0)

    def touching(self) -> tuple[Touching, ...]:
        """Classes of geom pairs that may touch."""
        return tuple(self.described().contact)

    def rules(self) -> tuple[Rule, ...]:
        return tuple(Rule(t.active, t.passive, t.reach) for t in self.touching())

    def contacts(self) -> tuple[Contact, ...]:
        return (self.contact, *(_numbers(t) for t in self.touching()[1:]))

    def phases(self) -> tuple[Phase, ...]:
        return tuple(self.described().phases)


def _numbers(touching: Touching) -> Contact:
    return Contact(
        stiffness=touching.stiffness, damping=touching.damping, friction=touching.friction
    )


@register
class Bumper(_Shipped):
    """A flat bumper: a ball on the active side touches a plate on the passive side."""

    kind: Literal["bumper"] = "bumper"
    folder: ClassVar[str] = "bumper"
    flat: ClassVar[bool] = True


@register
class Latched(_Shipped):
    """A mechanism captured from the start: springs and dampers on all six axes hold A at P, in
    tension as well as compression.
    """

    kind: Literal["latched"] = "latched"
    folder: ClassVar[str] = "bumper"
    captured: ClassVar[bool] = True


@register
class IdssRing(Described):
    """An androgynous ring with three guide petals per side, after the International Docking System
    Standard: soft capture by latches, attenuation, hard capture.
    """

    kind: Literal["idss_ring"] = "idss_ring"
    folder: ClassVar[str] = "idss_ring"
    active_ring: ActiveRing | None = Field(
        default=None,
        description="Six actuators with force feedback that carry the ring; null: springs and "
        "dampers",
    )

    def actuated(self) -> ActiveRing | None:
        return self.active_ring

    def sides(self) -> tuple[MjSpec, MjSpec]:
        active, passive = super().sides()
        if self.active_ring is not None:
            from hiltestbed.contact.legs import stand_on_legs

            stand_on_legs(active, self.active_ring)
        return active, passive

    def phases(self) -> tuple[Phase, ...]:
        return super().phases() if self.active_ring is None else tuple(self.described().actuated)

    def shape(self) -> Hashable:
        ring = self.active_ring
        return super().shape(), ring and ring.model_dump_json()


@register
class KinematicCoupling(Described):
    """Three balls that seat in three radial V-grooves: six contacts for six axes; latches draw them
    together, then hold.
    """

    kind: Literal["kinematic_coupling"] = "kinematic_coupling"
    folder: ClassVar[str] = "kinematic_coupling"


@register
class MarmanGripper(Described):
    """A gripper whose three jaws close on the interface ring of a launch adapter, as in satellite
    servicing.
    """

    kind: Literal["marman_gripper"] = "marman_gripper"
    folder: ClassVar[str] = "marman_gripper"


@register
class Mjcf(Described):
    """The user's own mechanism: two MJCF files with the sites A and P, geoms of any kind, and
    moving parts.

    Without ``pairs`` every geom whose contype and conaffinity are not both 0 may touch, with the
    stiffness of ``contact``.
    """

    kind: Literal["mjcf"] = "mjcf"
    active: ModelFile = Field(
        description="MJCF of the active side, with the site A, its +z along the insertion"
    )
    passive: ModelFile = Field(
        description="MJCF of the passive side, with the site P, its +z along the insertion"
    )
    pairs: Annotated[tuple[Touching, ...], Field(strict=False)] = Field(
        default=(),
        description="Classes of geom pairs that may touch, each with its stiffness, damping and "
        "friction",
    )
    capture: Annotated[tuple[Phase, ...], Field(strict=False)] = Field(
        default=(), description="Phases of capture, in order"
    )

    @classmethod
    def _own_contact(cls, data: dict[str, Any]) -> dict[str, Any]:
        pairs = data.get("pairs")
        first = pairs[0] if isinstance(pairs, (list, tuple)) and pairs else {}
        if isinstance(first, Touching):
            first = first.model_dump()
        return {k: first[k] for k in Contact.model_fields if isinstance(first, dict) and k in first}

    def files(self) -> tuple[Path, Path]:
        return Path(self.active), Path(self.passive)

    def touching(self) -> tuple[Touching, ...]:
        return self.pairs

    def rules(self) -> tuple[Rule, ...]:
        return super().rules() or (Rule(),)

    def contacts(self) -> tuple[Contact, ...]:
        return super().contacts() if self.pairs else (self.contact,)

    def phases(self) -> tuple[Phase, ...]:
        return self.capture


@register
class ProbeCone(_Shipped):
    """A probe with a ball at its tip, and a cone with a socket at its apex, in which latches may
    capture the probe.
    """

    kind: Literal["probe_cone"] = "probe_cone"
    folder: ClassVar[str] = "probe_cone"
    latches: ClassVar[bool] = True


@register
class ProbeDrogue(Described):
    """A probe whose head is on a compliant rod, and a drogue in whose socket the head's latches
    catch; the rod is then retracted.
    """

    kind: Literal["probe_drogue"] = "probe_drogue"
    folder: ClassVar[str] = "probe_drogue"
