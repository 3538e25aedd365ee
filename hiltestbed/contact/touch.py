"""The springs and dampers with which a mechanism meets in its first touch: those of every contact
that begins there, in series with the springs of moving parts.

A contact c of stiffness k_c adds k_c J_c^T J_c (J_c: row of its normal and lever arm); parts that
give way are condensed (:mod:`hiltestbed.contact.jacobian`). A motion along the insertion z then
meets the force K z, which acts along J = K z/|K z|, with the stiffness k of K = k J^T J along z: k
= z^T K z/(J z)^2. Of one contact J is its own row and k its own stiffness; of four walls at an
angle, J is z and k is 4 k_c sin^2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiltestbed.compiled.jit import interpreted
from hiltestbed.contact import parameters as cp
from hiltestbed.contact.geometry import FRAMES, unmet
from hiltestbed.contact.law import Pair, acting_law, in_series, linear_law
from hiltestbed.contact.parameters import ContactParameters, acting_contacts, mechanism_parameters
from hiltestbed.contact.sides import Sides, sides_of
from hiltestbed.contact.wrench import LATCH_RADIUS, meet_all
from hiltestbed.frames import Array
from hiltestbed.numerical_model.bodies import approach_state, effective_mass, mobility

if TYPE_CHECKING:
    from hiltestbed.contact.settings import Mechanism
    from hiltestbed.effects.base import Effect
    from hiltestbed.scenario.spacecraft import Approach, Spacecraft


# poses checked on the way to the first touch, and distance searched beyond the nominal touch [m]
STOPS, BEYOND = 400, 0.05
BISECTIONS = 40
# [m] contacts that begin within this distance after the first belong to the same touch: above the
# bisection's resolution, below any penetration
TOGETHER = 1e-6
INSERTION = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True, eq=False)
class Impact:
    """Two vehicles on their way to the contact of their mechanism: all that its first touch depends
    on. Equal if the settings are.

    Attributes:
        effects: on the contact. approach: the initial state.
    """

    mechanism: Mechanism
    effects: tuple[Effect, ...]
    spacecraft: Spacecraft
    approach: Approach

    @cached_property
    def _key(self) -> tuple[str, ...]:
        sections = self.mechanism, self.spacecraft, self.approach, *self.effects
        return tuple(section.model_dump_json(round_trip=True) for section in sections)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Impact) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def sides(self) -> Sides:
        """The contents of the mechanism's MJCF."""
        return sides_of(self.mechanism)

    @property
    def laws(self) -> list[ContactParameters]:
        """The contact of each rule of the mechanism, and last of its latch, effects included."""
        return acting_contacts(self.mechanism, self.effects)

    @property
    def start(self) -> Array:
        """``(13,)`` initial pose of A in P and relative twist in P."""
        return approach_state(self.approach)

    @property
    def mass(self) -> float:
        """Reduced mass [kg] of both vehicles along the insertion."""
        return effective_mass(self.spacecraft)

    @property
    def mobility(self) -> Array:
        """``(6, 6)`` relative acceleration at A per wrench there."""
        return mobility(self.spacecraft)

    def centred(self) -> Impact:
        """The same from a start on the insertion axis, without a tilt."""
        straight = {"offset": (0.0, 0.0), "attitude_deg": (0.0, 0.0, 0.0)}
        return replace(self, approach=self.approach.model_copy(update=straight))


class Touch(NamedTuple):
    """The first touch.

    Attributes:
        row: (6,) J, from the twist of A's origin to the rate along the force. stiffness [N/m],
            damping [N s/m] along it. contacts: number of contacts that begin in it. fastest:
            [rad/s] of the moving parts on them, see :func:`hiltestbed.contact.jacobian.fastest`; 0
            without any.
    """

    row: Array
    stiffness: float
    damping: float
    contacts: int
    fastest: float


@lru_cache(maxsize=256)
def first_touch(impact: Impact) -> Touch | None:
    """The first touch of an approach straight along the insertion, from the initial offset and
    attitude; moving parts are at rest.

    None if nothing touches up to the approach's gap plus :data:`BEYOND` after the nominal touch, if
    the mechanism is captured, or if a part gives way behind a contact that is not linear.
    """
    if impact.mechanism.captured or _bare(impact.sides):
        return None
    meeting, pose = _meeting(impact), impact.start[:7]
    if not _reached(impact.approach, meeting, pose):
        return None
    pose[2] += TOGETHER
    meeting.deepest(pose)
    pair = meeting.pair(impact, pose[:3])
    if pair is None or not pair[0][2, 2] > 0.0:
        return None
    stiffness, damping = pair
    row = stiffness[:, 2] / np.linalg.norm(stiffness[:3, 2])
    share = float(row[2]) ** 2
    return Touch(
        row,
        float(stiffness[2, 2]) / share,
        float(damping[2, 2]) / share,
        int(np.count_nonzero(meeting.depth > 0.0)),
        meeting.fastest(),
    )


def nothing_met(impact: Impact) -> bool:
    """Whether nothing touches on the way of :func:`first_touch`."""
    if impact.mechanism.captured or _bare(impact.sides):
        return False
    return not _reached(impact.approach, _meeting(impact), impact.start[:7])


def _bare(sides: Sides) -> bool:
    """Whether no surface may touch another."""
    return sides.rigid and not sides.geometry.count


def _meeting(impact: Impact) -> Meeting | _Parts:
    sides = impact.sides
    return Meeting(sides) if sides.rigid else _Parts(impact.mechanism, impact.effects)


def _reached(approach: Approach, meeting: Meeting | _Parts, pose: Array) -> bool:
    """Whether there is a first touch along the insertion; ``pose`` (7,) is then at it."""

    def touches(z: float) -> bool:
        pose[2] = z
        return meeting.deepest(pose) > 0.0

    stops = np.linspace(-abs(approach.gap), abs(approach.gap) + BEYOND, STOPS)
    met = next((k for k, z in enumerate(stops) if touches(float(z))), 0)
    if met == 0:
        return False
    low, high = float(stops[met - 1]), float(stops[met])
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if touches(middle) else (middle, high)
    pose[2] = high
    return True


class Meeting:
    """Penetration of the surfaces of a mechanism at rest, from the pose of A in P.

    Attributes:
        frames: (F, 7) poses of A, P and moving parts in P.
    """

    def __init__(self, sides: Sides) -> None:
        count, frames = sides.geometry.count, FRAMES + len(sides.frames)
        p = np.ones((count, cp.PARAMETERS))
        p[:, cp.LEVER], p[:, cp.OFFSET] = 0.5, 0.0
        self.frames = np.zeros((frames, 7))
        self.frames[1, 6] = 1.0
        met = unmet.py_func(count)
        # a loop whose contacts MuJoCo computes alone needs no compiled kernel for them
        self._meet = interpreted(meet_all) if sides.exact else meet_all
        self.depth, self.point, self.normal = met.depth, met.point, met.normal
        self._met = sides.geometry, p, self.frames, np.zeros((frames, 6)), np.empty((9, 7)), met

    def deepest(self, pose: Array) -> float:
        """Largest penetration [m] with A at ``pose`` (7,), negative while apart."""
        self.frames[0] = pose
        self._meet(*self._met)
        return float(self.depth.max())

    def pair(self, impact: Impact, place: Array) -> tuple[Array, Array] | None:
        """(6, 6) stiffness and damping about A's origin ``place`` (3,) in the present state."""
        stiffness, damping, inverse = np.zeros((6, 6)), np.zeros((6, 6)), impact.mobility
        rules, laws = impact.sides.rules, impact.laws
        for c in np.flatnonzero(self.depth > 0.0):
            push, arm = self.normal[c], self.point[c] - place
            row = np.concatenate([push, np.cross(arm, push)])
            speed = abs(float(push @ np.asarray(impact.approach.velocity)))
            k, d = acting_law(laws[rules[c]], 1.0 / float(row @ inverse @ row), speed)
            stiffness += k * np.outer(row, row)
            damping += d * np.outer(row, row)
        return stiffness, damping

    def fastest(self) -> float:
        """[rad/s] of the moving parts in the present state: there are none."""
        return 0.0


class _Parts:
    """The same with moving parts or native pairs, in MuJoCo, the parts at rest."""

    def __init__(self, mechanism: Mechanism, effects: tuple[Effect, ...]) -> None:
        # the platform's models are made of the mechanism, so that they import its package
        from mujoco.batch import Batch

        from hiltestbed.contact.composition import structure_of
        from hiltestbed.contact.engagement import Engagement
        from hiltestbed.platform.facilities.composed import ideal_model

        made_of, dt = structure_of(mechanism, effects), 1e-3  # [s] nothing is stepped
        self._made_of = replace(made_of, mounted=False, constant=False)
        model = ideal_model(self._made_of, dt)
        self._batch = Batch(model, 1, 1)
        self._batch.reset(stage=0)
        laws = mechanism_parameters([mechanism], [effects], made_of.sides.rules).laws
        self._engagement = Engagement(self._batch, laws, self._made_of, dt, 0.0)
        at = int(model.joint("A_joint").qposadr[0])
        self._place = self._batch.bind("qpos")[:, at : at + 7]
        self._still, self._port = np.zeros((1, 6)), np.zeros((1, 7))
        self._port[0, 6] = 1.0
        self._pose = np.zeros((1, 7))

    @property
    def depth(self) -> Array:
        """Penetration [m] of each pair."""
        return self._engagement.met[0, :, 0]

    def deepest(self, pose: Array) -> float:
        """As for :class:`Meeting`."""
        self._pose[0] = pose
        self._place[0, :3], self._place[0, 3:] = pose[:3], pose[[6, 3, 4, 5]]
        self._batch.forward(stage=self._engagement.stage)
        self._engagement.update(self._pose, self._still, self._port, self._still)
        return float(self.depth.max())

    def pair(self, impact: Impact, place: Array) -> tuple[Array, Array] | None:
        """As for :class:`Meeting`."""
        from hiltestbed.contact.jacobian import pair_at

        return pair_at(self._engagement, self._batch, self._made_of, 0, place)

    def fastest(self) -> float:
        """As for :class:`Meeting`."""
        from hiltestbed.contact.jacobian import fastest

        return fastest(self._engagement, self._batch, self._made_of, 0)


def axis_truth(impact: Impact, captured: bool = False) -> list[Pair | None]:
    """Stiffness [N/m], [N m/rad] and damping of x, y, z, rx, ry, rz, effects included; None on axes
    without a linear law.

    A bumper has one along z; latches act on all six; a mount is in series with them. If a mechanism
    is captured in phases, springs of its own parts are in series as well: see
    :mod:`hiltestbed.contact.jacobian`.

    Args:
        captured: whether latches have closed during the run.
    """
    mechanism = impact.mechanism
    contact, *_, latch = impact.laws
    turning = LATCH_RADIUS**2
    if mechanism.captured or (captured and not mechanism.phases()):
        # the lateral axes stay linear: no effect changes their law
        k, c = latch.stiffness, latch.damping
        held = latch if mechanism.captured else replace(latch).after_capture()
        front: list[Pair | None] = [
            *[(k, c)] * 2,
            linear_law(held),
            *[(k * turning, c * turning)] * 3,
        ]
    else:
        front = [None, None, linear_law(contact) if mechanism.flat else None, None, None, None]
    if mechanism.mount is None:
        return front
    behind = list(zip(mechanism.mount.stiffness, mechanism.mount.damping, strict=True))
    return [None if f is None else in_series(f, b) for f, b in zip(front, behind, strict=True)]


def normal_truth(impact: Impact, at_once: int) -> Pair | None:
    """Stiffness [N/m] and damping [N s/m] along the normal of a contact, effects included: the
    contact's own while one at a time touches, otherwise those of the first touch, of all its
    contacts and of the springs of moving parts in series.

    None if several different laws or a non-linear law act, if the mount is compliant, or if more
    contacts than in the first touch acted at once.

    Args:
        at_once: largest number of contacts that touched at the same time; 0 if it is not known.
    """
    laws = {linear_law(c) for c in impact.laws[:-1]}
    if len(laws) != 1 or None in laws or impact.mechanism.mount is not None:
        return None
    if at_once <= 1 and impact.sides.rigid:
        return laws.pop()
    touch = first_touch(impact)
    if touch is None or touch.contacts < at_once:
        return None
    return touch.stiffness, touch.damping
