"""Full physical simulation: the bodies themselves move, and no numerical model is in the loop.

The two spacecraft stand in the hall as articles with real mass, unloaded from gravity on air bearings or on cables. What a loop commands,
measures, compensates falls away: the relative pose is what it is. An article's mass and inertia are those of its spacecraft, mechanism
included, and what carries it comes on top; the attached mechanisms are therefore left without mass of their own
(:meth:`PhysicalFacility.lighten`).

W is the world of every facility, z along the insertion, but level: y is up and gravity acts along -y.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from hiltestbed.bound import GIVEN, Call
from hiltestbed.errors import InputError
from hiltestbed.frames import Array, twist_between
from hiltestbed.jit import njit
from hiltestbed.platform.facilities.drives import UPRIGHT, relative
from hiltestbed.platform.facilities.facility import MOUNT, MOUNT_HOME, NOMINAL, TOOL_HOME, Facility, Response, add_carrier
from hiltestbed.platform.facilities.inverse_dynamics import joint_forces
from hiltestbed.platform.facilities.kinematics import Axis, Kinematics
from hiltestbed.platform.facilities.motion import move, packed, place, scratch, tool_pose, tool_twist, unpack
from hiltestbed.platform.facilities.tree import between, compose, inverse_pose

GRAVITY = 9.81  # [m/s^2], along -y of W
WEIGHTLESS = 1e-6  # [kg], [kg m^2] of a mechanism whose mass is counted with its article
NEAR = 1e-7  # [m], [rad] by how much a start may miss what the articles can do
SIDES = ("chaser", "target")


@dataclass(frozen=True)
class Article:
    """A spacecraft as it stands in the hall.

    Attributes:
        mass: [kg]. inertia: (3, 3) about the centre of mass, body axes [kg m^2]. port: (7,) pose of its port in the body.
    """

    mass: float
    inertia: Array
    port: Array


@njit(cache=True)
def _read(integers, numbers, room, qpos, qvel, limit, place_A, motion_A, place_P, motion_P, pose, twist, diverged):
    tree, w = unpack(integers, numbers, room)
    lost = False
    r, arm = np.empty(3), np.empty(3)
    for i in range(qpos.shape[0]):
        if diverged[i]:
            continue
        worst = 0.0
        for k in range(qvel.shape[1]):
            worst = max(worst, abs(qvel[i, k])) if math.isfinite(qvel[i, k]) else math.inf
        for k in range(qpos.shape[1]):
            worst = worst if math.isfinite(qpos[i, k]) else math.inf
        if not worst < limit:
            diverged[i] = True
            lost = True
            continue
        place(tree, qpos[i], w)
        move(tree, qvel[i], w)
        tool_pose(tree, w, 0, place_A[i])
        tool_twist(tree, w, 0, motion_A[i])
        tool_pose(tree, w, 1, place_P[i])
        tool_twist(tree, w, 1, motion_P[i])
        relative(place_A[i], motion_A[i], place_P[i], motion_P[i], r, arm, pose[i], twist[i])
    return lost


class Bodies:
    """`n` pairs of articles; all arrays are updated in place.

    Attributes, at t_k:
        pose, twist: (n, 7), (n, 6) of A relative to P, in P. place_A, motion_A, place_P, motion_P: of both in W.
    """

    def __init__(self, model: mujoco.MjModel, kinematics: Kinematics, n: int, step: float) -> None:
        self.model, self.kinematics, self.step = model, kinematics, step
        self.pose, self.twist = np.tile(UPRIGHT, (n, 1)), np.zeros((n, 6))
        self.place_A, self.motion_A = np.tile(UPRIGHT, (n, 1)), np.zeros((n, 6))
        self.place_P, self.motion_P = np.tile(UPRIGHT, (n, 1)), np.zeros((n, 6))
        self._seen = Call(
            _read, *packed(kinematics.tree.towards_tools()), GIVEN, GIVEN, GIVEN, self.place_A, self.motion_A, self.place_P, self.motion_P,
            self.pose, self.twist, GIVEN,
        )  # fmt: skip

    def push(self, qpos: Array, qvel: Array, applied: Array) -> None:
        """Write what bearings and cables do to the articles into the generalised forces ``applied`` (n, nv), before a step."""
        raise NotImplementedError

    def rest(self, qpos: Array, qvel: Array) -> None:
        """Put what carries the articles into the state of the start."""

    def settle(self, pose: Array, twist: Array, qpos: Array, qvel: Array) -> None:
        """The start: the target at rest with P at W's origin, A at ``pose`` (n, 7) moving with ``twist`` (n, 6).

        Raises:
            InputError: a start that the articles cannot take, or not move out of.
        """
        for i in range(len(pose)):
            q, left = self.kinematics.nearest(np.array([pose[i], UPRIGHT]))
            if not left < NEAR:
                raise InputError(f"the start cannot be: {missed(self.kinematics.poses(q)[0], pose[i])}")
            qpos[i] = q
            twists = np.array([twist[i], np.zeros(6)])
            qvel[i] = self.kinematics.rates(q, twists)
            slip = self.kinematics.twists(q, qvel[i])[0] - twist[i]
            if not np.abs(slip).max() < NEAR:
                k = int(np.argmax(np.abs(slip)))
                raise InputError(f"the start cannot be: the articles do not move {axis_of(k)} (asked for {twist[i, k]:.4g}); allowed is 0")
        self.rest(qpos, qvel)

    def observe(self, qpos: Array, qvel: Array, limit: float, diverged: NDArray[np.bool_]) -> bool:
        """Read poses and twists; True where a run has just left ``limit`` [m/s, rad/s], which ``diverged`` (n,) then names."""
        return self.observing(qpos, qvel, limit, diverged)()

    def observing(self, qpos: Array, qvel: Array, limit: float, diverged: NDArray[np.bool_]) -> Callable[[], bool]:
        """:meth:`observe` of arrays that stay."""
        return self._seen.on(qpos, qvel, limit, diverged)

    def momentum(self, qpos: Array, qvel: Array, run: int = 0) -> Array:
        """``(6,)`` linear momentum [kg m/s] and moment of momentum about W's origin [kg m^2/s] of all that moves."""
        tree, w = self.kinematics.tree, scratch(self.kinematics.tree)
        place(tree, np.ascontiguousarray(qpos[run]), w)
        out, nothing = np.empty(self.model.nv), np.zeros(3)
        # Velocities as if they were accelerations from rest: the loads are then the momenta.
        joint_forces(tree, np.zeros(self.model.nv), np.ascontiguousarray(qvel[run]), nothing, w, out)
        return w.loads[0].copy()

    def state(self) -> dict[str, NDArray[Any]]:
        """The arrays that make up the state between two ticks."""
        return {}


class PhysicalFacility(Facility):
    """A hall in which two articles move by themselves."""

    physical: ClassVar[bool] = True
    moves_passive: ClassVar[bool] = True
    articles: dict[str, Article]

    def stand(self, chaser: Article, target: Article) -> PhysicalFacility:
        """Put the spacecraft into the hall: before anything else is asked of it."""
        self.articles = {"chaser": chaser, "target": target}
        return self

    @property
    def axes(self) -> tuple[Axis, ...]:
        return ()  # nothing is driven

    def place_of(self, side: str) -> Array:
        """``(7,)`` pose of an article's body in W at home, where A stands at P."""
        return inverse_pose(self.articles[side].port)

    def fit(self, spec: mujoco.MjSpec, side: str, extra_mass: float, extra_inertia: Array) -> None:
        """Give an article's body its spacecraft's mass and inertia, and those of what rides with it [kg, kg m^2]."""
        article, body = self.articles[side], spec.body(side)
        inertia = article.inertia + extra_inertia
        body.mass = article.mass + extra_mass
        body.ipos, body.inertia = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
        body.fullinertia = [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]

    def add_ports(self, spec: mujoco.MjSpec) -> None:
        """The mount on the chaser, the passive side's carrier on the target."""
        mount = between(self.place_of("chaser"), MOUNT_HOME)
        spec.body("chaser").add_site(name=MOUNT, pos=mount[:3], quat=[mount[6], *mount[3:6]])
        add_carrier(spec.body("target"), self.articles["target"].port)

    @staticmethod
    def lighten(spec: mujoco.MjSpec, prefix: str) -> None:
        """Take the mass of an attached mechanism out: it is part of its spacecraft's."""
        for body in spec.bodies:
            if body.name.startswith(prefix):
                body.mass, body.inertia, body.explicitinertial = WEIGHTLESS, [WEIGHTLESS] * 3, True

    def kinematics(self, model: mujoco.MjModel, tool: str = MOUNT) -> Kinematics:
        return Kinematics(model, [tool, NOMINAL], ())

    @abstractmethod
    def bodies(self, model: mujoco.MjModel, settings: Sequence[Any], step: float, tool: str = MOUNT) -> Bodies:
        """What moves and what carries it, for runs whose ``settings`` may differ in numbers; ``step`` [s] of the physics."""

    def drives(self, *_: Any, **__: Any) -> Any:
        raise InputError(f"rig.platform.kind {self.kind} drives nothing: its bodies move by themselves")

    def response(self, rate: float, feed: bool) -> Response:
        """There is no command to follow."""
        return Response((math.inf,) * 6, (1.0,) * 6, 0.0, followed=True)

    def problems(self, rate: float) -> Iterator[tuple[tuple[str | int, ...], str]]:
        return iter(())

    def complaints(self, pose: Array, tool: Array = TOOL_HOME) -> list[str]:
        goal = np.array([compose(np.asarray(pose, dtype=float), inverse_pose(tool)), UPRIGHT])
        q, left = self.bare.nearest(goal)
        return [] if left < NEAR else [missed(self.bare.poses(q)[0], goal[0])]


def missed(reached: Array, pose: Array) -> str:
    """In words, the axis along or about which ``reached`` (7,) is furthest from ``pose`` (7,)."""
    gap = np.empty(6)
    twist_between(reached, pose, 1.0, gap)
    k = int(np.argmax(np.abs(gap)))
    return f"the articles do not go {axis_of(k)} (A would be {gap[k]:.4g} off); allowed is 0"


def axis_of(k: int) -> str:
    """The k-th of six motions in words."""
    return f"{'along' if k < 3 else 'about'} {'xyz'[k % 3]}"
