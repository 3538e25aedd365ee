"""Full physical simulation: the bodies themselves move, and no numerical model is in the loop.

The two spacecraft are represented in the hall by articles with real mass, supported against gravity
by air bearings or cables. There are no commands, measurements or compensation: the relative pose
follows from the physics. An article's mass and inertia are those of its spacecraft, mechanism
included, plus those of its support; the attached mechanisms therefore have no mass of their own
(:meth:`PhysicalFacility.lighten`).

W is the world of every facility, z along the insertion, which is horizontal here: y is up and
gravity acts along -y.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from hiltestbed.compiled.jit import interpreted
from hiltestbed.errors import InputError
from hiltestbed.frames import Array, rotate_back, twist_between
from hiltestbed.platform.facilities.facility import (
    MOUNT,
    MOUNT_HOME,
    NOMINAL,
    TOOL_HOME,
    UPRIGHT,
    Facility,
    Mover,
    add_carrier,
)
from hiltestbed.platform.facilities.kinematics import Axis, Kinematics
from hiltestbed.platform.facilities.tree import between, compose, inverse_pose

WEIGHTLESS = 1e-6  # [kg], [kg m^2] of a mechanism whose mass is included in its article
NEAR = 1e-7  # [m], [rad] tolerance of a start against the articles' degrees of freedom
SIDES = ("chaser", "target")


@dataclass(frozen=True)
class Article:
    """A spacecraft represented in the hall.

    Attributes:
        mass: [kg]. inertia: (3, 3) about the centre of mass, body axes [kg m^2]. port: (7,) pose of
            its port in the body.
    """

    mass: float
    inertia: Array
    port: Array


class Bodies(Mover):
    """`n` pairs of articles. Their :meth:`push` writes the forces of bearings and cables to the
    generalised forces ``inputs`` (n, nv).
    """

    writes: ClassVar[str] = "qfrc_applied"

    @property
    def moving(self) -> list[str]:
        """The articles that move."""
        return [side for side in SIDES if self.model.body(side).jntnum[0]]

    def rest(self, qpos: Array, qvel: Array) -> None:
        """Initialise the state of the articles' supports."""

    def settle(self, pose: Array, twist: Array, qpos: Array, qvel: Array) -> None:
        """The start: the target at rest with P at W's origin, A at ``pose`` (n, 7) moving with
        ``twist`` (n, 6).

        Raises:
            InputError: a start pose or twist that the articles' degrees of freedom do not allow.
        """
        for i in range(len(pose)):
            q, left = self.kinematics.nearest(np.array([pose[i], UPRIGHT]))
            if not left < NEAR:
                why = missed(self.kinematics.poses(q)[0], pose[i])
                raise InputError(f"the start cannot be: {why}")
            qpos[i] = q
            qvel[i] = self.kinematics.rates(q, np.array([twist[i], np.zeros(6)]))
            slip = self.kinematics.twists(q, qvel[i])[0] - twist[i]
            if not np.abs(slip).max() < NEAR:
                k = int(np.argmax(np.abs(slip)))
                raise InputError(
                    f"the start cannot be: the articles do not move {axis_of(k)} (asked for "
                    f"{twist[i, k]:.4g}); allowed is 0"
                )
        self.rest(qpos, qvel)


class PhysicalFacility(Facility):
    """A hall in which two articles move freely."""

    moves_passive: ClassVar[bool] = True
    articles: dict[str, Article]

    def stand(self, chaser: Article, target: Article) -> PhysicalFacility:
        """Place the spacecraft in the hall; must be called before any other method."""
        self.articles = {"chaser": chaser, "target": target}
        return self

    @property
    def axes(self) -> tuple[Axis, ...]:
        return ()  # nothing is driven

    def moves(self, side: str) -> bool:
        """Whether an article can move."""
        return side == "chaser" or self.settings.target == "free"

    def place_of(self, side: str) -> Array:
        """``(7,)`` pose of an article's body in W at home, where A coincides with P."""
        return inverse_pose(self.articles[side].port)

    def in_body(self, side: str, vector: Array) -> Array:
        """A vector (3,) of W in the axes of an article's body at home."""
        out = np.empty(3)
        interpreted(rotate_back)(self.place_of(side)[3:7], vector, out)
        return out

    def fit(self, spec: mujoco.MjSpec, side: str, extra_mass: float, extra_inertia: Array) -> None:
        """Set an article's body to the inertia of its spacecraft and support [kg, kg m^2]."""
        article, body = self.articles[side], spec.body(side)
        inertia = article.inertia + extra_inertia
        body.mass = article.mass + extra_mass
        body.ipos, body.inertia = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
        body.fullinertia = inertia[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]

    def add_ports(self, spec: mujoco.MjSpec) -> None:
        """Add the mount to the chaser and the passive side's carrier to the target."""
        mount = between(self.place_of("chaser"), MOUNT_HOME)
        spec.body("chaser").add_site(name=MOUNT, pos=mount[:3], quat=[mount[6], *mount[3:6]])
        add_carrier(spec.body("target"), self.articles["target"].port)

    @staticmethod
    def lighten(spec: mujoco.MjSpec, prefix: str) -> None:
        """Remove the mass of an attached mechanism, which is part of its spacecraft's."""
        for body in spec.bodies:
            if body.name.startswith(prefix):
                body.mass, body.inertia, body.explicitinertial = WEIGHTLESS, [WEIGHTLESS] * 3, True

    def kinematics(self, model: mujoco.MjModel, tool: str = MOUNT) -> Kinematics:
        return Kinematics(model, [tool, NOMINAL], ())

    def bandwidth(self) -> float:
        """Infinite, since there is no command to follow."""
        return math.inf

    def complaints(self, pose: Array, tool: Array = TOOL_HOME) -> list[str]:
        goal = np.array([compose(np.asarray(pose, dtype=float), inverse_pose(tool)), UPRIGHT])
        q, left = self.bare.nearest(goal)
        return [] if left < NEAR else [missed(self.bare.poses(q)[0], goal[0])]


def missed(reached: Array, pose: Array) -> str:
    """Message with the axis on which ``reached`` (7,) is furthest from ``pose`` (7,)."""
    gap = np.empty(6)
    twist_between(reached, pose, 1.0, gap)
    k = int(np.argmax(np.abs(gap)))
    return f"the articles do not go {axis_of(k)} (A would be {gap[k]:.4g} off); allowed is 0"


def axis_of(k: int) -> str:
    """The k-th of six motion components in words."""
    return f"{'along' if k < 3 else 'about'} {'xyz'[k % 3]}"
