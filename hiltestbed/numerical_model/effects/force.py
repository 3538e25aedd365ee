"""A force on the bodies that the numerical model does not know of: what a guide, a screw, a bearing or gravity does."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from hiltestbed.effects.base import Effect, quantity
from hiltestbed.effects.search import Candidate, DrivenAxis, Scales, candidate
from hiltestbed.numerical_model.parameters import RESISTED, Resistance
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.numerical_model.parameters import DynamicsParameters

Resisted = Literal["chaser", "target", "both"]
STAMP = "stamp"  # [s] part of a variant: how much later than believed the log reads a position that follows from its force
STRIBECK_SPEED = 1e-3  # [m/s] unless given: some tenths of a millimetre to a few millimetres a second are measured of greased guides
FASTER = 10.0  # times the friction that a regression gives, as far as a search goes


@register
class DynamicsForce(Effect):
    """A force resists the motion along an axis: viscous and dry friction, an offset."""

    kind: Literal["dynamics.force"] = "dynamics.force"
    viscous: float = quantity("N s/m", "Viscous friction", default=0.0, ge=0.0, search=(0.0, 1e5))
    coulomb: float = quantity("N", "Dry friction while it moves", default=0.0, ge=0.0, search=(0.0, 1e5))
    offset: float = quantity("N", "Force against the positive direction, whatever the speed", default=0.0, search=(-1e5, 1e5))
    viscous_asymmetry: float = quantity(
        "-", "Part by which viscous friction is less in the positive direction and more in the negative", default=0.0, ge=-1.0, le=1.0,
        search=(-1.0, 1.0),
    )  # fmt: skip
    coulomb_back: float | None = quantity(
        "N", "Dry friction in the negative direction; left out: that of the positive one", default=None, ge=0.0
    )
    static: float | None = quantity(
        "N",
        "Dry friction at rest in the positive direction, in the other as much above motion; left out: none above",
        default=None,
        ge=0.0,
    )
    stribeck_speed: float | None = quantity(
        "m/s", "Speed over which dry friction falls from rest to motion; left out: 0.001", default=None, gt=0.0
    )
    axis: Literal["x", "y", "z"] = Field(
        default="z", description="Axis along which it acts: of P for the motion of A relative to P, inertial for one body"
    )
    body: Resisted = Field(
        default="both", description="Motion that it resists: of A relative to P (both, equal and opposite), or of one body"
    )
    link = "dynamics"
    equation = (
        "R = offset + viscous (1 - viscous_asymmetry sgn v) v + (coulomb + (static - coulomb) exp(-(v/stribeck_speed)^2)) sgn(v), "
        "sgn(0) what holds it, from -1 to 1; the mean over a tick of a motion that the other forces, held, drive"
    )
    reference = "C. Canudas de Wit et al., IEEE Trans. Autom. Control 40, 1995; with an offset A. Janot, M. Gautier, M. Brunot, 2019"
    resembles = ("dynamics.mass", "dynamics.appendage")
    repeats = True
    leading = "coulomb"

    def apply(self, p: DynamicsParameters) -> None:
        p.stamp += float(self.variant.get(STAMP, 0.0))
        rise = 0.0 if self.static is None else self.static - self.coulomb
        law = Resistance(
            body=RESISTED.index(self.body),
            axis="xyz".index(self.axis),
            offset=self.offset,
            viscous=self.viscous * (1.0 - self.viscous_asymmetry),
            viscous_back=self.viscous * (1.0 + self.viscous_asymmetry),
            coulomb=self.coulomb,
            coulomb_back=self.coulomb if self.coulomb_back is None else self.coulomb_back,
            rise=rise,
            stribeck=self.stribeck_speed or STRIBECK_SPEED,
        )
        if law.acts:
            p.forces.append(law)

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        """Along a driven axis: with friction that is the same in both directions, and with friction that is not."""
        if scales.driven is not None:  # of vehicles that fly freely no force but that of the contact is sought
            yield cls._of_driven_axis(scales.driven)
            yield cls._of_driven_axis(scales.driven, viscous_asymmetry=[0.0])

    @classmethod
    def _of_driven_axis(cls, given: DrivenAxis, **more: Sequence[float]) -> Candidate:
        """From where a regression of the force on the motion starts; the row to which a position belongs is not known."""
        most = FASTER * max(abs(given.offset), given.coulomb, given.viscous * given.fastest, 1e-6)
        names = {"viscous": [given.viscous], "coulomb": [given.coulomb], "offset": [given.offset], **more, STAMP: [given.stamp]}
        bounds = {
            "viscous": (0.0, most / given.fastest), "coulomb": (0.0, most), "offset": (-most, most),
            STAMP: (given.stamp - given.stamps, given.stamp + given.stamps),
        }  # fmt: skip
        return candidate(cls, names, bounds=bounds, axis="z", body="both")
