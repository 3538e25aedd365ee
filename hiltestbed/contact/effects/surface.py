"""Where and how the surfaces touch: friction, adhesion, touch offset, backlash, misalignment."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field, Strict

from hiltestbed.contact.effects.law import ContactEffect
from hiltestbed.effects.departure import quantity
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.contact.parameters import ContactParameters
    from hiltestbed.scenario.like import ScenarioLike

Tilt = Annotated[
    tuple[Annotated[float, Field(ge=-45.0, le=45.0)], ...],
    Strict(False),
    Field(min_length=2, max_length=2),
]


@register
class ContactSurfaceFriction(ContactEffect):
    """The coefficient of friction between the surfaces differs from the nominal one."""

    kind: Literal["contact.surface_friction"] = "contact.surface_friction"
    coefficient: float = quantity(
        "-", "True coefficient of friction", ge=0.0, le=10.0, search=(0.0, 1.0)
    )
    equation = "F_t = coefficient |F| v_t/sqrt(v_t^2 + (1e-4)^2)"
    reference = "Coulomb, regularised"
    resembles = ("sensor.crosstalk", "contact.misalignment")

    def apply(self, p: ContactParameters) -> None:
        p.friction = self.coefficient

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        if scales.slides:
            yield candidate(cls, {"coefficient": [0.02, 0.1, 0.3]}, linear="coefficient")


@register
class ContactAdhesion(ContactEffect):
    """Adhesion: the surfaces pull on each other as they separate."""

    kind: Literal["contact.adhesion"] = "contact.adhesion"
    force: float = quantity("N", "Largest pulling force", ge=0.0, search=(0.0, 300.0))
    equation = "F may fall to -force while x > 0"
    reference = "magnet or latch pull"
    resembles = ("contact.damping",)
    repeats = True

    def apply(self, p: ContactParameters) -> None:
        p.adhesion += self.force

    def unfit(self, scenario: ScenarioLike) -> str | None:
        if scenario.mechanism.captured:
            return (
                f"acts where a contact ends, and a mechanism of kind "
                f"{scenario.mechanism.kind} never separates; take it out"
            )
        return None

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        if not scales.captured:
            yield cls.by_force(scales)


@register
class ContactTouchOffset(ContactEffect):
    """The mechanisms touch at a larger (or smaller) insertion than in the nominal rig."""

    kind: Literal["contact.touch_offset"] = "contact.touch_offset"
    offset: float = quantity(
        "m",
        "Distance along the insertion by which the touch comes later; negative: earlier",
        search=(-2e-3, 2e-3),
    )
    equation = "x = pz - offset"
    reference = "position of the surface"
    resembles = ("contact.preload", "platform.scale")
    repeats = True
    jumps = "offset"

    def apply(self, p: ContactParameters) -> None:
        p.offset += self.offset

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        yield candidate(
            cls, {"offset": [q * scales.depth for q in (-0.3, -0.1, -0.02, 0.02, 0.1, 0.3)]}
        )


@register
class ContactBacklash(ContactEffect):
    """Backlash in a captured mechanism: no elastic force within the play."""

    kind: Literal["contact.backlash"] = "contact.backlash"
    width: float = quantity("m", "Total play, from stop to stop", ge=0.0, search=(0.0, 5e-3))
    equation = (
        "x = pz - (width/2) sgn(pz) where |pz| > width/2, else 0; with elastic dry "
        "friction the play moves along with the slider"
    )
    reference = "backlash of a joint"
    resembles = ("platform.backlash",)
    repeats = True

    def apply(self, p: ContactParameters) -> None:
        p.play += self.width

    def unfit(self, scenario: ScenarioLike) -> str | None:
        if not (scenario.mechanism.captured or scenario.mechanism.latch):
            return (
                f"needs a latched mechanism (got {scenario.mechanism.kind!r} without a "
                f"latch); allowed: kind latched, or a latch"
            )
        return None

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        if scales.captured:
            x = scales.depth
            yield candidate(
                cls,
                {"width": [0.02 * x, 0.1 * x, 0.3 * x, 0.8 * x]},
                bounds={"width": (0.0, 2.0 * x)},
            )


@register
class ContactMisalignment(ContactEffect):
    """The passive port is tilted, and the contact force with it."""

    kind: Literal["contact.misalignment"] = "contact.misalignment"
    angles_deg: Tilt = quantity("deg", "Tilt of the port about x and about y", search=(-8.0, 8.0))
    equation = "surface normal n = R_y R_x e_z"
    reference = "mounting error"
    resembles = ("sensor.crosstalk", "contact.surface_friction")
    repeats = True

    def apply(self, p: ContactParameters) -> None:
        p.tilt_x += math.radians(self.angles_deg[0])
        p.tilt_y += math.radians(self.angles_deg[1])

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        # from none, both angles are differentiated; from a tilt, its own direction is
        starts = [(0.0, 0.0), (2.0, 2.0), (-2.0, -2.0)]
        yield candidate(cls, {"angles_deg.0": [0.0], "angles_deg.1": [0.0]}, starts=starts)
