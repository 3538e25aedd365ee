"""A force on the bodies that the nominal numerical model lacks: of a guide, a screw, a bearing, or
gravity.
"""

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
# [s] parameter of a variant: how much later than nominal the log reads the position that results
# from a force
STAMP = "stamp"
# [m/s] unless given: measurements on greased guides range from some tenths of a mm/s to a few mm/s
STRIBECK_SPEED = 1e-3
FASTER = 10.0  # upper bound of a search, as a multiple of the friction that a regression gives


@register
class DynamicsForce(Effect):
    """A force that resists the motion along an axis: viscous and dry friction, and a constant
    offset.
    """

    kind: Literal["dynamics.force"] = "dynamics.force"
    viscous: float = quantity(
        "N s/m", "Coefficient of viscous friction", default=0.0, ge=0.0, search=(0.0, 1e5)
    )
    coulomb: float = quantity("N", "Dry friction in motion", default=0.0, ge=0.0, search=(0.0, 1e5))
    offset: float = quantity(
        "N", "Constant force against the positive direction", default=0.0, search=(-1e5, 1e5)
    )
    viscous_asymmetry: float = quantity(
        "-",
        "Fraction by which viscous friction is lower in the positive and higher in the negative "
        "direction",
        default=0.0,
        ge=-1.0,
        le=1.0,
        search=(-1.0, 1.0),
    )
    coulomb_back: float | None = quantity(
        "N",
        "Dry friction in motion in the negative direction; omitted: equal to coulomb",
        default=None,
        ge=0.0,
    )
    static: float | None = quantity(
        "N",
        "Static friction in the positive direction; its excess over coulomb is equal in the "
        "negative direction; omitted: no excess",
        default=None,
        ge=0.0,
    )
    stribeck_speed: float | None = quantity(
        "m/s",
        "Stribeck velocity, over which dry friction falls from static to coulomb; omitted: 0.001",
        default=None,
        gt=0.0,
    )
    axis: Literal["x", "y", "z"] = Field(
        default="z",
        description="Axis along which it acts: of P for the motion of A relative to P, inertial "
        "for one body",
    )
    body: Resisted = Field(
        default="both",
        description="Motion that it resists: of A relative to P (both, equal and opposite), or of "
        "one body",
    )
    link = "dynamics"
    equation = (
        "R = offset + viscous (1 - viscous_asymmetry sgn v) v + (coulomb + (static - coulomb) "
        "exp(-(v/stribeck_speed)^2)) sgn(v), sgn(0) what holds it, from -1 to 1; the mean over a "
        "tick of a motion that the other forces, held, drive"
    )
    reference = (
        "C. Canudas de Wit et al., IEEE Trans. Autom. Control 40, 1995; with an "
        "offset A. Janot, M. Gautier, M. Brunot, 2019"
    )
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
        """Along a driven axis: friction that is equal in both directions, and friction that is
        not.
        """
        if scales.driven is not None:  # on free-flying vehicles only the contact force acts
            yield cls._of_driven_axis(scales.driven)
            yield cls._of_driven_axis(scales.driven, viscous_asymmetry=[0.0])

    @classmethod
    def _of_driven_axis(cls, given: DrivenAxis, **more: Sequence[float]) -> Candidate:
        """Starts from a regression of the force on the motion; the time stamp of the position is
        fitted, since it is not known.
        """
        most = FASTER * max(abs(given.offset), given.coulomb, given.viscous * given.fastest, 1e-6)
        names = {
            "viscous": [given.viscous],
            "coulomb": [given.coulomb],
            "offset": [given.offset],
            **more,
            STAMP: [given.stamp],
        }
        bounds = {
            "viscous": (0.0, most / given.fastest), "coulomb": (0.0, most), "offset": (-most, most),
            STAMP: (given.stamp - given.stamps, given.stamp + given.stamps),
        }  # fmt: skip
        return candidate(cls, names, bounds=bounds, axis="z", body="both")
