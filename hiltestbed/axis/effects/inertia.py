"""A drive moves another mass than believed, or with another force."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from hiltestbed.axis import law
from hiltestbed.axis.effects.base import BodyEffect, DamperEffect, DriveEffect, RecordScale
from hiltestbed.effects.departure import quantity
from hiltestbed.effects.search import Candidate, candidate
from hiltestbed.plugins import register

INERTIA = (
    0.05  # most that the inertia of a rod adds to the largest force of a damper, in the search
)
FACTORS = [0.5, 1.0, 2.0]  # from which a factor is sought; the law is linear in it


@register
class AxisMass(BodyEffect):
    """The moved mass or inertia differs from the nominal one."""

    kind: Literal["dynamics.mass"] = "dynamics.mass"
    factor: float = quantity(
        "-", "True mass over nominal mass", gt=0.0, search=(0.01, 100.0), ratio=True
    )
    axes = ("drive", "arm")
    equation = "m -> factor m, and the inertia with it"
    reference = "Newton"
    resembles = ("dynamics.gain",)
    same = ("dynamics.gain",)

    def apply(self, p: law.AxisLaw) -> None:
        p.numbers[law.MASS] *= self.factor

    def apply_to_arm(self, p: law.ArmNumbers) -> None:
        p.bodies[self.body or ""] = self.factor * p.bodies[self.body or ""]

    @classmethod
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        yield candidate(cls, {"factor": FACTORS})


@register
class AxisGain(DriveEffect):
    """The drive gives another force per unit of its input than its nominal constant says."""

    kind: Literal["dynamics.gain"] = "dynamics.gain"
    factor: float = quantity(
        "-", "True drive constant over the nominal one", gt=0.0, search=(0.01, 100.0), ratio=True
    )
    equation = "force = factor gain u"
    reference = "torque constant of a motor with its gear"
    resembles = ("dynamics.mass",)

    def apply(self, p: law.AxisLaw) -> None:
        p.numbers[law.GAIN] *= self.factor

    @classmethod
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        # where nothing resists nominally, it is a factor on mass and resistance together
        if reach.resists:
            yield candidate(cls, {"factor": FACTORS})


@register
class AxisMovedMass(DamperEffect):
    """The parts of a damper that move have a mass, whose inertia the force sensor reads."""

    kind: Literal["contact.moved_mass"] = "contact.moved_mass"
    mass: float = quantity("kg", "Mass between the motion and the sensor", ge=0.0)
    equation = "F += mass x''"
    reference = "Newton"

    def apply(self, p: law.AxisLaw) -> None:
        p.numbers[law.MASS] += self.mass

    @classmethod
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        most = INERTIA * reach.force / max(reach.acceleration, 1e-12)
        yield candidate(cls, {"mass": [0.1 * most]}, bounds={"mass": (0.0, most)})
