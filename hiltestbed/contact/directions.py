"""Along what a contact can act: the insertion, the normal of the first touch with the probe's lever, and the axes of what is latched.

A direction is a row J of the relative twist q' of A's origin, x' = J q'. A force F along it moves both bodies by M^-1 J^T F, M^-1 being
their relative mobility at A, so that x has the mass 1/(J M^-1 J^T).
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
STOPS, BEYOND = 400, 0.05  # on the way to the first touch, and how far beyond the nominal one [m]
ALIKE = 1e-6  # of a direction's components, by which two are one


@dataclass(frozen=True)
class Direction:
    """One way in which a contact acts.

    Attributes:
        name: in words. row: (6,) J. mass: [kg], [kg m^2]. stiffness, damping: along it [N/m, N m/rad], [N s/m, N m s/rad].
        turns: whether it is a turn. pulls: whether the contact pulls as well as pushes. slant: whether it is the normal of a surface that
        lies askew to the insertion. first: whether the approach makes its first contact along it.
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
    return Direction("along z", INSERTION, effective_mass(scenario), contact.stiffness, contact.damping, pulls=scenario.mechanism.captured)


def directions(scenario: Scenario) -> list[Direction]:
    """The insertion, then every other direction in which the contact of a scenario acts.

    Where parts move or MuJoCo finds the contacts, the first touch does not follow from the pose alone, and what holds in the end has
    springs of the mechanism before it: the insertion alone is told.
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
        found.append(Direction("along the normal of the first touch", row, mass, stiffness, damping, slant=slant, first=True))
    return found + (_modes(scenario, inverse, ", latched") if mechanism.latch is not None else [])


def _modes(scenario: Scenario, inverse: Array, when: str) -> list[Direction]:
    """In what a latch swings: the modes phi of its six springs K between both bodies, K phi = w^2 M phi, named by the axis that has most
    of the energy, of whose shift or turn mass, stiffness and damping are. All six springs have one ratio of c to k, so that a mode is one
    direction, J = phi^T K/(phi^T K phi)."""
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
        found.append(Direction(name, springs * phi / stiffness, stiffness / float(square), stiffness, damping, axis >= 3, pulls=True))
    return found


class _Meeting:
    """How deep the surfaces of a mechanism that stands still are in each other, from the pose of A in P."""

    def __init__(self, sides: Sides) -> None:
        self._index, self._values = sides.geometry
        count = sides.geometry.count
        self._p = np.ones((count, PARAMETERS))
        self._p[:, LEVER], self._p[:, OFFSET] = 0.5, 0.0
        self.frames, self._motions, self._work = np.zeros((2, 7)), np.zeros((2, 6)), np.empty((9, 7))
        self.frames[1, 6] = 1.0
        self.depth, self._rate = np.empty(count), np.empty(count)
        self.point, self.normal, self._slip = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros((count, 3))

    def deepest(self, pose: Array) -> float:
        """[m] of A at ``pose`` (7,), below 0 while apart; where is in ``depth``, ``point`` and ``normal``."""
        self.frames[0] = pose
        meet_all(
            self._index, self._values, self._p, self.frames, self._motions, self._work, self.depth, self._rate, self.point, self.normal,
            self._slip,
        )  # fmt: skip
        return float(self.depth.max())


def time_of_touch(scenario: Scenario) -> float | None:
    """[s] to the last instant before the first touch of the uniform approach, looked at :data:`STOPS` times, whether or not the run ends
    before it; None where the pose alone does not tell, or nothing is met: a few centimetres beyond the nominal touch, or, of an approach
    that does not lead there, within the run."""
    sides = sides_of(scenario.mechanism)
    if not sides.rigid or not sides.geometry.count:
        return None
    meeting, start = _Meeting(sides), approach_state(scenario)
    pose, end = start[:7].copy(), scenario.duration
    ahead = scenario.approach.velocity[2]
    if ahead > 0.0:  # beyond the nominal touch there is no more to meet than a few centimetres off the axis
        end = (scenario.approach.gap + BEYOND) / ahead
    times = np.linspace(0.0, end, STOPS)
    for k, t in enumerate(times):
        pose_step(start[:7], start[7:], float(t), pose)
        if meeting.deepest(pose) > 0.0:
            return float(times[k - 1]) if k else 0.0
    return None


def first_touch(scenario: Scenario) -> tuple[Array, float, float] | None:
    """J of the first contact that the approach, straight along the insertion, makes, and its stiffness and damping; None where the pose
    alone does not tell, or nothing is met within the approach's gap beyond the nominal touch."""
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
