"""What the bodies and rotors of an arm of several joints are beside what their owner believes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np

from hiltestbed.axis.effects.base import BodyEffect, DriveEffect, RecordScale
from hiltestbed.axis.law import ArmNumbers
from hiltestbed.effects.departure import quantity
from hiltestbed.effects.search import Candidate, candidate
from hiltestbed.frames import Array
from hiltestbed.plugins import register

REACH = 0.5  # [m] farthest that a centre of mass is sought from where it is believed
ROTOR = 0.5  # most of the largest torque that the inertia of a rotor takes, in the search


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

    def apply(self, p: ArmNumbers) -> None:
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

    def apply(self, p: ArmNumbers) -> None:
        p.armature[self.joint or ""] += self.inertia

    def apply_to_arm(self, p: ArmNumbers) -> None:
        self.apply(p)

    @classmethod
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        most = ROTOR * reach.force / max(reach.acceleration, 1e-12)
        yield candidate(cls, {"inertia": [0.1 * most]}, bounds={"inertia": (0.0, most)})
