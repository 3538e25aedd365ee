"""Directions in which a contact can act: the insertion, the normal of the first touch with the
probe's lever arm, the axes of a latch.

A direction is a row J that maps the relative twist q' of A's origin to x' = J q'. A force F along
it accelerates the relative motion by M^-1 J^T F, with the relative mobility M^-1 at A, so that x
has the effective mass 1/(J M^-1 J^T).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hiltestbed.contact.parameters import LEVER, OFFSET, PARAMETERS, believed_contacts
from hiltestbed.contact.sides import Sides, sides_of
from hiltestbed.contact.wrench import LATCH_RADIUS, meet_all
from hiltestbed.frames import Array, pose_step
from hiltestbed.numerical_model.bodies import approach_state, effective_mass, mobility

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario

AXES = ("x", "y", "z", "rx", "ry", "rz")
INSERTION = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
# poses checked on the way to the first touch, and distance searched beyond the nominal touch [m]
STOPS, BEYOND = 400, 0.05
ALIKE = 1e-6  # largest difference between the components of two equal directions


@dataclass(frozen=True)
class Direction:
    """One direction in which a contact acts.

    Attributes:
        name: in words. row: (6,) J. mass: effective [kg], [kg m^2]. stiffness, damping: along it
            [N/m, N m/rad], [N s/m, N m s/rad].
        turns: whether it is a rotation. pulls: whether the contact pulls as well as pushes. slant:
            whether it is the normal of a surface
        inclined to the insertion. first: whether the first contact of the approach is along it.
    """

    name: str
    row: Array
    mass: float
    stiffness: float
    damping: float
    turns: bool = False
    pulls: bool = False
    slant: bool = False
    first: bool = False


def insertion(scenario: Scenario) -> Direction:
    """Along z at P's origin."""
    contact = scenario.mechanism.contact
    return Direction(
        "along z",
        INSERTION,
        effective_mass(scenario),
        contact.stiffness,
        contact.damping,
        pulls=scenario.mechanism.captured,
    )


def directions(scenario: Scenario) -> list[Direction]:
    """The insertion, then every other direction in which the contact of a scenario acts.

    Only the insertion is given if the mechanism has moving parts or native pairs: the first touch
    then does not follow from the pose alone, and the mechanism's own springs are in series with its
    latches.
    """
    mechanism, inverse = scenario.mechanism, mobility(scenario)
    if mechanism.captured:
        return _modes(scenario, inverse, "")
    found = [insertion(scenario)]
    touch = first_touch(scenario)
    if touch is not None and np.abs(touch[0] - INSERTION).max() <= ALIKE:
        found = [replace(found[0], first=True)]
    elif touch is not None:
        row, stiffness, damping = touch
        mass, slant = 1.0 / float(row @ inverse @ row), bool(np.abs(row[:2]).max() > ALIKE)
        found.append(
            Direction(
                "along the normal of the first touch",
                row,
                mass,
                stiffness,
                damping,
                slant=slant,
                first=True,
            )
        )
    return found + (_modes(scenario, inverse, ", latched") if mechanism.latch is not None else [])


def _modes(scenario: Scenario, inverse: Array, when: str) -> list[Direction]:
    """The modes phi of a latch's six springs K between both bodies, K phi = w^2 M phi. A mode is
    named after the axis with most of its energy, to whose displacement mass, stiffness and damping
    refer. The ratio c/k is equal for all six springs, so that a mode is one direction, J = phi^T
    K/(phi^T K phi).
    """
    latch = believed_contacts(scenario.mechanism)[-1]
    springs = latch.stiffness * np.array([1.0] * 3 + [LATCH_RADIUS**2] * 3)
    root = np.sqrt(springs)
    squares, shapes = np.linalg.eigh(root[:, None] * inverse * root)
    found = []
    for square, shape in zip(squares, shapes.T, strict=True):
        axis = int(np.argmax(shape**2))
        phi = shape / root * (root[axis] / shape[axis])
        stiffness = float(phi @ (springs * phi))
        name = f"{'along' if axis < 3 else 'about'} {AXES[axis][-1]}{when}"
        damping = stiffness * latch.damping / latch.stiffness
        found.append(
            Direction(
                name,
                springs * phi / stiffness,
                stiffness / float(square),
                stiffness,
                damping,
                axis >= 3,
                pulls=True,
            )
        )
    return found


class _Meeting:
    """Penetration of the surfaces of a rigid mechanism at rest, from the pose of A in P."""

    def __init__(self, sides: Sides) -> None:
        self._index, self._values = sides.geometry
        count = sides.geometry.count
        self._p = np.ones((count, PARAMETERS))
        self._p[:, LEVER], self._p[:, OFFSET] = 0.5, 0.0
        self.frames, self._motions, self._work = (
            np.zeros((2, 7)),
            np.zeros((2, 6)),
            np.empty((9, 7)),
        )
        self.frames[1, 6] = 1.0
        self.depth, self._rate = np.empty(count), np.empty(count)
        self.point, self.normal, self._slip = (
            np.zeros((count, 3)),
            np.zeros((count, 3)),
            np.zeros((count, 3)),
        )

    def deepest(self, pose: Array) -> float:
        """Largest penetration [m] with A at ``pose`` (7,), negative while apart; details in
        ``depth``, ``point`` and ``normal``.
        """
        self.frames[0] = pose
        meet_all(
            self._index,
            self._values,
            self._p,
            self.frames,
            self._motions,
            self._work,
            self.depth,
            self._rate,
            self.point,
            self.normal,
            self._slip,
        )
        return float(self.depth.max())


def time_of_touch(scenario: Scenario) -> float | None:
    """Time [s] of the last of :data:`STOPS` instants before the first touch of the uniform
    approach, whether or not the run ends before it; None if it does not follow from the pose alone,
    or if nothing touches up to :data:`BEYOND` after the nominal touch or, for an approach that does
    not lead there, within the run.
    """
    sides = sides_of(scenario.mechanism)
    if not sides.rigid or not sides.geometry.count:
        return None
    meeting, start = _Meeting(sides), approach_state(scenario)
    pose, end = start[:7].copy(), scenario.duration
    ahead = scenario.approach.velocity[2]
    if ahead > 0.0:  # beyond BEYOND after the nominal touch no first touch is possible
        end = (scenario.approach.gap + BEYOND) / ahead
    times = np.linspace(0.0, end, STOPS)
    for k, t in enumerate(times):
        pose_step(start[:7], start[7:], float(t), pose)
        if meeting.deepest(pose) > 0.0:
            return float(times[k - 1]) if k else 0.0
    return None


def first_touch(scenario: Scenario) -> tuple[Array, float, float] | None:
    """J of the first contact of an approach straight along the insertion, and its stiffness and
    damping; None if it does not follow from the pose alone, or if nothing touches up to the
    approach's gap plus :data:`BEYOND` after the nominal touch.
    """
    sides = sides_of(scenario.mechanism)
    if not sides.rigid or not sides.geometry.count:
        return None
    meeting, pose = _Meeting(sides), approach_state(scenario)[:7]

    def deepest(z: float) -> float:
        pose[2] = z
        return meeting.deepest(pose)

    start, end = -abs(scenario.approach.gap), abs(scenario.approach.gap) + BEYOND
    stops = np.linspace(start, end, STOPS)
    met = next((k for k, z in enumerate(stops) if deepest(float(z)) > 0.0), 0)
    if met == 0:
        return None
    low, high = float(stops[met - 1]), float(stops[met])
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if deepest(middle) > 0.0 else (middle, high)
    c = int(np.argmax(meeting.depth)) if deepest(high) > 0.0 else 0
    push, arm = meeting.normal[c], meeting.point[c] - meeting.frames[0, :3]
    row = np.concatenate([push, np.cross(arm, push)])
    row = -row if row[2] < 0.0 else row
    law = scenario.mechanism.contacts()[sides.rules[c]]
    return row, law.stiffness, law.damping
