"""Full physical simulation: the bodies themselves move, and no numerical model is in the loop.

The two spacecraft are represented in the hall by articles with real mass, supported against gravity
by air bearings or cables. There are
no commands, measurements or compensation: the relative pose follows from the physics. An article's
mass and inertia are those of its spacecraft, mechanism included, plus those of its support; the
attached mechanisms therefore have no mass of their own (:meth:`PhysicalFacility.lighten`).

W is the world of every facility, z along the insertion, which is horizontal here: y is up and
gravity acts along -y.
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

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.errors import InputError
from hiltestbed.frames import Array, twist_between
from hiltestbed.platform.divergence import has_diverged
from hiltestbed.platform.facilities.drives import UPRIGHT, PortMotion, ports_at_home, read_ports
from hiltestbed.platform.facilities.facility import (
    MOUNT,
    MOUNT_HOME,
    NOMINAL,
    TOOL_HOME,
    Facility,
    Response,
    add_carrier,
)
from hiltestbed.platform.facilities.inverse_dynamics import joint_forces
from hiltestbed.platform.facilities.kinematics import Axis, Kinematics
from hiltestbed.platform.facilities.motion import packed, place, scratch, unpack
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


@njit(cache=True)
def _read(integers, numbers, room, qpos, qvel, limit, diverged, *given):
    """Read sides; given: the fields of PortMotion."""
    tree, w = unpack(integers, numbers, room)
    lost = False
    for i in range(qpos.shape[0]):
        if diverged[i]:
            continue
        if has_diverged(qpos[i], qvel[i], limit):
            diverged[i] = True
            lost = True
            continue
        read_ports(tree, w, qpos[i], qvel[i], PortMotion(*given), i)
    return lost


class Bodies:
    """`n` pairs of articles; all arrays are updated in place.

    Attributes, at t_k:
        pose, twist: (n, 7), (n, 6) of A relative to P, in P. place_A, motion_A, place_P, motion_P:
            of both in W.
    """

    def __init__(self, model: mujoco.MjModel, kinematics: Kinematics, n: int, step: float) -> None:
        self.model, self.kinematics, self.step = model, kinematics, step
        sides = ports_at_home(n)
        self.place_A, self.motion_A, self.place_P, self.motion_P, self.pose, self.twist = sides
        self._seen = Call(_read, *packed(kinematics.tree.towards_tools()), *(GIVEN,) * 4, *sides)

    def push(self, qpos: Array, qvel: Array, applied: Array) -> None:
        """Write the forces of bearings and cables on the articles to the generalised forces
        ``applied`` (n, nv), before a step.
        """
        raise NotImplementedError

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
                raise InputError(
                    f"the start cannot be: {missed(self.kinematics.poses(q)[0], pose[i])}"
                )
            qpos[i] = q
            twists = np.array([twist[i], np.zeros(6)])
            qvel[i] = self.kinematics.rates(q, twists)
            slip = self.kinematics.twists(q, qvel[i])[0] - twist[i]
            if not np.abs(slip).max() < NEAR:
                k = int(np.argmax(np.abs(slip)))
                raise InputError(
                    f"the start cannot be: the articles do not move {axis_of(k)} (asked for "
                    f"{twist[i, k]:.4g}); allowed is 0"
                )
        self.rest(qpos, qvel)

    def observe(self, qpos: Array, qvel: Array, limit: float, diverged: NDArray[np.bool_]) -> bool:
        """Read poses and twists; returns whether a run has just exceeded ``limit`` [m/s, rad/s],
        and marks it in ``diverged`` (n,).
        """
        return self.observing(qpos, qvel, limit, diverged)()

    def observing(
        self, qpos: Array, qvel: Array, limit: float, diverged: NDArray[np.bool_]
    ) -> Callable[[], bool]:
        """:meth:`observe` bound to arrays that are reused."""
        return self._seen.on(qpos, qvel, limit, diverged)

    def momentum(self, qpos: Array, qvel: Array, run: int = 0) -> Array:
        """``(6,)`` linear momentum [kg m/s] and angular momentum about W's origin [kg m^2/s] of all
        moving bodies.
        """
        tree, w = self.kinematics.tree, scratch(self.kinematics.tree)
        place(tree, np.ascontiguousarray(qpos[run]), w)
        out, nothing = np.empty(self.model.nv), np.zeros(3)
        # With velocities in place of accelerations from rest, the inertial loads are the momenta.
        joint_forces(
            tree, np.zeros(self.model.nv), np.ascontiguousarray(qvel[run]), nothing, w, out
        )
        return w.loads[0].copy()

    def state(self) -> dict[str, NDArray[Any]]:
        """The arrays that make up the state between two ticks."""
        return {}


class PhysicalFacility(Facility):
    """A hall in which two articles move freely."""

    physical: ClassVar[bool] = True
    moves_passive: ClassVar[bool] = True
    articles: dict[str, Article]

    def stand(self, chaser: Article, target: Article) -> PhysicalFacility:
        """Place the spacecraft in the hall; must be called before any other method."""
        self.articles = {"chaser": chaser, "target": target}
        return self

    @property
    def axes(self) -> tuple[Axis, ...]:
        return ()  # nothing is driven

    def place_of(self, side: str) -> Array:
        """``(7,)`` pose of an article's body in W at home, where A coincides with P."""
        return inverse_pose(self.articles[side].port)

    def fit(self, spec: mujoco.MjSpec, side: str, extra_mass: float, extra_inertia: Array) -> None:
        """Set an article's body to its spacecraft's mass and inertia plus those of its support [kg,
        kg m^2].
        """
        article, body = self.articles[side], spec.body(side)
        inertia = article.inertia + extra_inertia
        body.mass = article.mass + extra_mass
        body.ipos, body.inertia = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
        body.fullinertia = [
            inertia[0, 0],
            inertia[1, 1],
            inertia[2, 2],
            inertia[0, 1],
            inertia[0, 2],
            inertia[1, 2],
        ]

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

    @abstractmethod
    def bodies(
        self, model: mujoco.MjModel, settings: Sequence[Any], step: float, tool: str = MOUNT
    ) -> Bodies:
        """Articles and their supports, for runs whose ``settings`` may differ in parameters;
        ``step`` [s] of the physics.
        """

    def drives(self, *_: Any, **__: Any) -> Any:
        raise InputError(f"rig.platform.kind {self.kind} drives nothing: its bodies move freely")

    def response(self, rate: float, feed: bool) -> Response:
        """A response without any lag, since there is no command to follow."""
        return Response((math.inf,) * 6, (1.0,) * 6, 0.0, followed=True)

    def problems(self, rate: float) -> Iterator[tuple[tuple[str | int, ...], str]]:
        return iter(())

    def complaints(self, pose: Array, tool: Array = TOOL_HOME) -> list[str]:
        goal = np.array([compose(np.asarray(pose, dtype=float), inverse_pose(tool)), UPRIGHT])
        q, left = self.bare.nearest(goal)
        return [] if left < NEAR else [missed(self.bare.poses(q)[0], goal[0])]


def missed(reached: Array, pose: Array) -> str:
    """Message with the axis along or about which ``reached`` (7,) is furthest from ``pose``
    (7,).
    """
    gap = np.empty(6)
    twist_between(reached, pose, 1.0, gap)
    k = int(np.argmax(np.abs(gap)))
    return f"the articles do not go {axis_of(k)} (A would be {gap[k]:.4g} off); allowed is 0"


def axis_of(k: int) -> str:
    """The k-th of six motion components in words."""
    return f"{'along' if k < 3 else 'about'} {'xyz'[k % 3]}"
