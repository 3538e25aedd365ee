"""Directions in which a contact can act: the insertion, the normal of the first touch with the
probe's lever arm, the axes of a latch.

A direction is a row J that maps the relative twist q' of A's origin to x' = J q'. A force F along
it accelerates the relative motion by M^-1 J^T F, with the relative mobility M^-1 at A, so that x
has the effective mass 1/(J M^-1 J^T).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hiltestbed.compiled.jit import interpreted
from hiltestbed.contact.law import Pair, acting_law, in_series
from hiltestbed.contact.parameters import ContactParameters
from hiltestbed.contact.touch import BEYOND, INSERTION, STOPS, Impact, Meeting, first_touch
from hiltestbed.contact.wrench import LATCH_RADIUS
from hiltestbed.frames import Array, pose_step
from hiltestbed.signals import AXES

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


def insertion(impact: Impact) -> Direction:
    """Along z at P's origin."""
    pulls = impact.mechanism.captured
    return Direction("along z", INSERTION, impact.mass, *acting_along_z(impact), pulls=pulls)


def acting_along_z(impact: Impact) -> Pair:
    """Stiffness [N/m] and damping [N s/m] with which a contact along the insertion acts, effects
    included, with the mount in series: of all contacts and parts of a centred touch that pushes
    along z, of the first rule's contact on any other surface, of the latch once captured.
    """
    mechanism = impact.mechanism
    touch = None if mechanism.flat else first_touch(impact.centred())
    if touch is not None and np.abs(touch.row - INSERTION).max() <= ALIKE:
        found = touch.stiffness, touch.damping
    else:
        law = impact.laws[-1 if mechanism.captured else 0]
        found = acting_law(law, impact.mass, abs(impact.approach.velocity[2]))
    mount = mechanism.mount
    return found if mount is None else in_series(found, (mount.stiffness[2], mount.damping[2]))


def directions(impact: Impact) -> list[Direction]:
    """The insertion, then every other direction in which the contact acts.

    Only the insertion is given if the mechanism has moving parts or native pairs: the first touch
    then does not follow from the pose alone, and the mechanism's own springs are in series with its
    latches.
    """
    mechanism, inverse = impact.mechanism, impact.mobility
    if mechanism.captured:
        return _modes(impact.laws[-1], inverse, "")
    found = [insertion(impact)]
    touch = first_touch(impact) if impact.sides.rigid else None
    if touch is not None and np.abs(touch.row - INSERTION).max() <= ALIKE:
        found = [replace(found[0], first=True)]
    elif touch is not None:
        row, stiffness, damping = touch[:3]
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
    if mechanism.latch is not None:
        found += _modes(impact.laws[-1], inverse, ", latched")
    return found


def _modes(latch: ContactParameters, inverse: Array, when: str) -> list[Direction]:
    """The modes K phi = w^2 M phi of a latch's six springs, each named after the axis with most of
    its energy, to whose displacement its numbers refer: J = phi^T K/(phi^T K phi).
    """
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


def time_of_touch(impact: Impact, duration: float) -> float | None:
    """Time [s] of the last of :data:`STOPS` instants before the first touch of the uniform
    approach, whether or not the run ends before it; None if it does not follow from the pose alone,
    or if nothing touches up to :data:`BEYOND` after the nominal touch or, for an approach that does
    not lead there, within the run's ``duration`` [s].
    """
    sides = impact.sides
    if not sides.rigid or not sides.geometry.count:
        return None
    meeting, start = Meeting(sides), impact.start
    pose, end = start[:7].copy(), duration
    ahead = impact.approach.velocity[2]
    if ahead > 0.0:  # beyond BEYOND after the nominal touch no first touch is possible
        end = (impact.approach.gap + BEYOND) / ahead
    times = np.linspace(0.0, end, STOPS)
    # where depths are distances, nothing touches before they are covered
    speed = float(np.linalg.norm(start[7:10]))
    straight, free = sides.exact and speed > 0.0 and not start[10:].any(), 0.0
    for k, t in enumerate(times):
        if t < free:
            continue
        interpreted(pose_step)(start[:7], start[7:], float(t), pose)
        depth = meeting.deepest(pose)
        if depth > 0.0:
            return float(times[k - 1]) if k else 0.0
        if straight:
            free = t - depth / speed
    return None
