"""Along what a contact can act: the insertion, the normal of the first touch with the probe's lever, and the axes of what is latched.

A direction is a row J of the relative twist q' of A's origin, x' = J q'. A force F along it moves both bodies by M^-1 J^T F, M^-1 being
their relative mobility at A, so that x has the mass 1/(J M^-1 J^T).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hiltestbed.contact.parameters import LEVER, OFFSET, PARAMETERS, believed_contacts
from hiltestbed.contact.sides import sides_of
from hiltestbed.contact.wrench import LATCH_RADIUS, meet_all
from hiltestbed.frames import Array
from hiltestbed.numerical_model.bodies import approach_state, effective_mass, mobility

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario

AXES = ("x", "y", "z", "rx", "ry", "rz")
INSERTION = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
ALIKE = 1e-6  # of a direction's components, by which two are one


@dataclass(frozen=True)
class Direction:
    """One way in which a contact acts.

    Attributes:
        name: in words. row: (6,) J. mass: [kg], [kg m^2]. stiffness, damping: along it [N/m, N m/rad], [N s/m, N m s/rad].
        turns: whether it is a turn. pulls: whether the contact pulls as well as pushes. slant: whether it is the normal of a surface that
        lies askew to the insertion.
    """

    name: str
    row: Array
    mass: float
    stiffness: float
    damping: float
    turns: bool = False
    pulls: bool = False
    slant: bool = False


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
    if touch is not None and np.abs(touch[0] - INSERTION).max() > ALIKE:
        row, stiffness, damping = touch
        mass, slant = 1.0 / float(row @ inverse @ row), bool(np.abs(row[:2]).max() > ALIKE)
        found.append(Direction("along the normal of the first touch", row, mass, stiffness, damping, slant=slant))
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


def first_touch(scenario: Scenario) -> tuple[Array, float, float] | None:
    """J of the first contact that the approach, straight along the insertion, makes, and its stiffness and damping; None where the pose
    alone does not tell, or nothing is met within the approach's gap beyond the nominal touch."""
    sides = sides_of(scenario.mechanism)
    if not sides.rigid or not sides.geometry.count:
        return None
    index, values = sides.geometry
    count = sides.geometry.count
    p = np.ones((count, PARAMETERS))
    p[:, LEVER], p[:, OFFSET] = 0.5, 0.0
    frames, motions, work = np.zeros((2, 7)), np.zeros((2, 6)), np.empty((9, 7))
    frames[0], frames[1, 6] = approach_state(scenario)[:7], 1.0
    depth, rate = np.empty(count), np.empty(count)
    point, normal, slip = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros((count, 3))

    def deepest(z: float) -> float:
        frames[0, 2] = z
        meet_all(index, values, p, frames, motions, work, depth, rate, point, normal, slip)
        return float(depth.max())

    start, end = -abs(scenario.approach.gap), abs(scenario.approach.gap) + 0.05
    stops = np.linspace(start, end, 400)
    met = next((k for k, z in enumerate(stops) if deepest(float(z)) > 0.0), 0)
    if met == 0:
        return None
    low, high = float(stops[met - 1]), float(stops[met])
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if deepest(middle) > 0.0 else (middle, high)
    c = int(np.argmax(depth)) if deepest(high) > 0.0 else 0
    push, arm = normal[c], point[c] - frames[0, :3]
    row = np.concatenate([push, np.cross(arm, push)])
    row = -row if row[2] < 0.0 else row
    law = scenario.mechanism.contacts()[sides.rules[c]]
    return row, law.stiffness, law.damping
