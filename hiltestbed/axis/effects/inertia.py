"""Masses and inertias that a drive, an arm or a damper moves, and the force that moves them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np

from hiltestbed.axis import law
from hiltestbed.axis.effects.base import BodyEffect, DamperEffect, DriveEffect, RecordScale, Sought
from hiltestbed.effects.departure import quantity
from hiltestbed.effects.search import Candidate, candidate
from hiltestbed.frames import Array
from hiltestbed.plugins import register

REACH = 0.5  # [m] farthest that a centre of mass is sought from where it is believed
FACTORS = Sought((0.5, 1.0, 2.0))  # from which a factor is sought; the law is linear in it


def whole_mass(reach: RecordScale) -> float:
    """The mass or inertia that takes the largest force for the largest acceleration."""
    return reach.force / max(reach.acceleration, 1e-12)


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
    multiplies = {"factor": (law.MASS,)}
    sought = {"factor": FACTORS}

    def apply_to_arm(self, p: law.ArmNumbers) -> None:
        p.bodies[self.body or ""] = self.factor * p.bodies[self.body or ""]


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
    multiplies = {"factor": (law.GAIN,)}
    sought = {"factor": FACTORS}

    @classmethod
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        # where nothing resists nominally, it is a factor on mass and resistance together
        if reach.resists:
            yield from super().parts(reach)


@register
class AxisMovedMass(DamperEffect):
    """The parts of a damper that move have a mass, whose inertia the force sensor reads."""

    kind: Literal["contact.moved_mass"] = "contact.moved_mass"
    mass: float = quantity("kg", "Mass between the motion and the sensor", ge=0.0)
    equation = "F += mass x''"
    reference = "Newton"
    adds = {"mass": law.MASS}
    sought = {
        "mass": Sought(
            (0.005,),
            (0.0, 0.05),
            whole_mass,
        )
    }


@register
class ArmCentre(BodyEffect):
    """The centre of mass of a body is elsewhere than believed, as with a tool that is not in the
    model.
    """

    kind: Literal["dynamics.centre_of_mass"] = "dynamics.centre_of_mass"
    x: float = quantity("m", "Offset along x of the body's joint", default=0.0)
    y: float = quantity("m", "Offset along y of the body's joint", default=0.0)
    z: float = quantity("m", "Offset along z of the body's joint", default=0.0)
    equation = "c -> c + (x, y, z), with the same mass and inertia about the centre"
    reference = "Huygens and Steiner"
    resembles = ("dynamics.mass",)

    def apply(self, p: law.ArmNumbers) -> None:
        body = p.bodies[self.body or ""]
        mass, before = body[0], body[1:4] / body[0]
        after = before + np.array([self.x, self.y, self.z])
        more = mass * (_about(after) - _about(before))
        p.bodies[self.body or ""] = np.concatenate([[mass], mass * after, body[4:] + more])

    @classmethod
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        for name in ("x", "y", "z"):
            yield candidate(cls, {name: [0.0]}, bounds={name: (-REACH, REACH)})


def _about(c: Array) -> Array:
    """(6,) second moments xx, xy, yy, xz, yz, zz of a unit mass at ``c`` (3,) about the origin."""
    moments = c @ c * np.eye(3) - np.outer(c, c)
    return moments[(0, 0, 1, 0, 1, 2), (0, 1, 1, 2, 2, 2)]


@register
class ArmArmature(DriveEffect):
    """The rotor of a joint's motor has inertia, which the gear multiplies."""

    kind: Literal["dynamics.armature"] = "dynamics.armature"
    inertia: float = quantity("kg", "Inertia of the rotor at the joint", ge=0.0)
    axes = ("arm",)
    equation = "torque += inertia q''"
    reference = "L. Sciavicco, B. Siciliano, L. Villani, Adv. Robot. 10, 1996"
    resembles = ("dynamics.mass",)
    sought = {"inertia": Sought((0.05,), (0.0, 0.5), whole_mass)}

    def apply(self, p: law.ArmNumbers) -> None:
        p.armature[self.joint or ""] += self.inertia

    def apply_to_arm(self, p: law.ArmNumbers) -> None:
        self.apply(p)
