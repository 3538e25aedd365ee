"""A drive moves another mass than believed, or with another force."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar, Literal

from hiltestbed.axis.effects.base import AxisEffect, AxisKind, Reach
from hiltestbed.axis.law import GAIN, MASS, Law
from hiltestbed.effects.base import quantity
from hiltestbed.effects.search import Candidate, candidate
from hiltestbed.plugins import register

INERTIA = (
    0.05  # most that the inertia of a rod adds to the largest force of a damper, in the search
)
FACTORS = [0.5, 1.0, 2.0]  # from which a factor is sought; the law is linear in it


@register
class AxisMass(AxisEffect):
    """The moved mass or inertia differs from the nominal one."""

    kind: Literal["dynamics.mass"] = "dynamics.mass"
    factor: float = quantity(
        "-", "True mass over nominal mass", gt=0.0, search=(0.01, 100.0), ratio=True
    )
    link = "dynamics"
    axes: ClassVar[tuple[AxisKind, ...]] = ("drive",)
    equation = "m -> factor m"
    reference = "Newton"
    resembles = ("dynamics.gain",)
    same = ("dynamics.gain",)
    leading = "factor"

    def apply(self, p: Law) -> None:
        p.numbers[MASS] *= self.factor

    @classmethod
    def parts(cls, reach: Reach) -> Iterator[Candidate]:
        yield candidate(cls, {"factor": FACTORS})


@register
class AxisGain(AxisEffect):
    """The drive gives another force per unit of its input than its nominal constant says."""

    kind: Literal["dynamics.gain"] = "dynamics.gain"
    factor: float = quantity(
        "-", "True drive constant over the nominal one", gt=0.0, search=(0.01, 100.0), ratio=True
    )
    link = "dynamics"
    axes: ClassVar[tuple[AxisKind, ...]] = ("drive",)
    equation = "force = factor gain u"
    reference = "torque constant of a motor with its gear"
    resembles = ("dynamics.mass",)
    leading = "factor"

    def apply(self, p: Law) -> None:
        p.numbers[GAIN] *= self.factor

    @classmethod
    def parts(cls, reach: Reach) -> Iterator[Candidate]:
        # where nothing resists nominally, it is a factor on mass and resistance together
        if reach.resists:
            yield candidate(cls, {"factor": FACTORS})


@register
class AxisMovedMass(AxisEffect):
    """The parts of a damper that move have a mass, whose inertia the force sensor reads."""

    kind: Literal["contact.moved_mass"] = "contact.moved_mass"
    mass: float = quantity("kg", "Mass between the motion and the sensor", ge=0.0)
    link = "contact"
    axes: ClassVar[tuple[AxisKind, ...]] = ("damper",)
    equation = "F += mass x''"
    reference = "Newton"
    leading = "mass"

    def apply(self, p: Law) -> None:
        p.numbers[MASS] += self.mass

    @classmethod
    def parts(cls, reach: Reach) -> Iterator[Candidate]:
        most = INERTIA * reach.force / max(reach.acceleration, 1e-12)
        yield candidate(cls, {"mass": [0.1 * most]}, bounds={"mass": (0.0, most)})
