"""Contact geometry of a ball or rod and a surface: penetration, its rate, the contact point and the
normal.

Dimensions come from the MJCF (:mod:`hiltestbed.contact.sides`). All surfaces of a mechanism are
stored in two flat arrays, so that one compiled kernel serves every mechanism: ``index``, for each
of C candidates a row of ROW integers, then the links of the trees; ``values``, for each a row of
VALUES numbers, then profiles, triangles and boxes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.jit import njit
from hiltestbed.contact.surfaces.mesh import Tree, mesh_beyond
from hiltestbed.contact.surfaces.profile import COLUMNS, TURNED, beyond, profile_distance
from hiltestbed.contact.surfaces.surface import (
    MESH,
    Surface,
    bounds,
    segment_distance,
    signed_distance,
)
from hiltestbed.frames import Array, rotate, rotate_back

# Columns of a row of `index`: frames of the round (ball or rod) and of the surface; 1 if the
# surface is on the passive side, else -1; kind of the surface; start and length of its parts.
(
    ROUND_FRAME,
    SURFACE_FRAME,
    SIDE,
    KIND,
    PROFILE,
    PROFILE_ROWS,
    CORNERS,
    FACES,
    NORMALS,
    BOXES,
    NODES,
    LINKS,
    ROW,
) = range(13)
# Columns of a row of `values`: radius of the round, both ends of its axis in its frame, pose of the
# surface in its frame, sizes of the surface, centre of its bounding sphere, in its own frame, and
# the sphere's radius.
RADIUS, END_0, END_1, PLACE, SIZES, CENTRE, BOUND, VALUES = 0, 1, 4, 7, 14, 17, 20, 21
ACTIVE, PASSIVE, FRAMES = 0, 1, 2  # numbers of the frames A and S; those of moving parts follow
DEEPEST = 0.1  # [m] depth inside a mesh up to which the nearest point is searched


class Geometry(NamedTuple):
    """The candidates of a mechanism as flat arrays for the kernels."""

    index: NDArray[np.int64]
    values: Array

    @property
    def count(self) -> int:
        """C, the number of candidates."""
        return int(self.index[-1])


class Met(NamedTuple):
    """How each of C candidates meets, at an instant.

    Attributes:
        depth, rate: (C,) penetration [m], negative while apart, and its rate [m/s].
        point, normal, slip: (C, 3) in the frame of the surface: point of application of the force
            [m], direction of the force on the surface, and tangential velocity of the body that
            touches it [m/s].
    """

    depth: Array
    rate: Array
    point: Array
    normal: Array
    slip: Array


@njit(cache=True)
def unmet(count):
    """A :class:`Met` of ``count`` candidates that are nowhere."""
    point, normal, slip = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros((count, 3))
    return Met(np.zeros(count), np.zeros(count), point, normal, slip)


class Round(NamedTuple):
    """A ball or rod: radius [m] and ends (2, 3) of its axis [m], of a ball equal, in a frame."""

    radius: float
    ends: Array
    frame: int


class Placed(NamedTuple):
    """A surface at the pose ``place`` (7,) in the frame number ``frame``, on one of the sides."""

    surface: Surface
    place: Array
    frame: int
    passive: bool


def packed(candidates: Sequence[tuple[Round, Placed]]) -> Geometry:
    """The candidates in flat arrays; a surface that several of them share is stored once."""
    count = len(candidates)
    rows, numbers = np.zeros((count, ROW), dtype=np.int64), np.zeros((count, VALUES))
    values, links = [], []
    at, at_link = count * VALUES, count * ROW
    stored: dict[int, tuple[int, ...]] = {}
    for c, (round_, placed) in enumerate(candidates):
        surface = placed.surface
        key = id(surface)
        if key not in stored:
            parts = (
                surface.profile,
                surface.tree.corners,
                surface.tree.normals,
                surface.tree.boxes,
            )
            starts = at + np.concatenate([[0], np.cumsum([p.size for p in parts])])
            values += [p.ravel() for p in parts]
            links.append(surface.tree.links.ravel())
            stored[key] = (
                starts[0],
                len(surface.profile),
                starts[1],
                len(surface.tree.corners),
                starts[2],
                starts[3],
                len(surface.tree.boxes),
                at_link,
            )
            at, at_link = int(starts[-1]), at_link + links[-1].size
        rows[c, :KIND] = round_.frame, placed.frame, 1 if placed.passive else -1
        rows[c, KIND], rows[c, PROFILE:] = surface.kind, stored[key]
        centre, bound = bounds(surface)
        numbers[c] = np.concatenate(
            [[round_.radius], round_.ends.ravel(), placed.place, surface.sizes, centre, [bound]]
        )
    index = np.concatenate([rows.ravel(), *links, [count]]).astype(np.int64)
    return Geometry(index, np.concatenate([numbers.ravel(), *values]))


@njit(cache=True)
def _profile(index, values, c):
    first, rows = index[c * ROW + PROFILE], index[c * ROW + PROFILE_ROWS]
    return values[first : first + rows * COLUMNS].reshape((rows, COLUMNS))


@njit(cache=True)
def _surface(index, values, c):
    row = index[c * ROW : (c + 1) * ROW]
    faces, nodes = row[FACES], row[NODES]
    sizes = values[c * VALUES + SIZES : c * VALUES + SIZES + 3]
    profile = _profile(index, values, c)
    corners = values[row[CORNERS] : row[CORNERS] + 9 * faces].reshape((faces, 3, 3))
    normals = values[row[NORMALS] : row[NORMALS] + 21 * faces].reshape((faces, 7, 3))
    boxes = values[row[BOXES] : row[BOXES] + 15 * nodes].reshape((nodes, 15))
    links = index[row[LINKS] : row[LINKS] + 2 * nodes].reshape((nodes, 2))
    return Surface(row[KIND], sizes, profile, Tree(corners, normals, boxes, links))


@njit(cache=True)
def meet(geometry, c, pose, twist, law, work, met):
    """Write how candidate ``c`` of one run meets to ``met``, a :class:`Met`.

    Args:
        pose, twist: (7,), (6,) of the round's frame in the surface's.
        law: point of application of the force within the overlap, 0 at the undeformed surface, 1 at
            the tip; 1 if a ball touches, 0 if its foremost point does; and the largest distance
            [m] at which the (negative) penetration is exact. Farther apart it is only an upper
            bound, at most minus that distance, and point, normal and slip are zero.
        work: (5, 3) scratch.
    """
    index, values = geometry
    lever, blunt, ahead = law
    point, normal, slip = met.point[c], met.normal[c], met.slip[c]
    row = values[c * VALUES : (c + 1) * VALUES]
    start, end, free, nearest, v = work[0], work[1], work[2], work[3], work[4]
    ball = (
        row[END_0] == row[END_1]
        and row[END_0 + 1] == row[END_1 + 1]
        and row[END_0 + 2] == row[END_1 + 2]
    )
    radius = row[RADIUS]
    rotate(pose[3:7], row[END_0 : END_0 + 3], start)
    if ball and blunt != 1.0:
        free[0] = free[1] = 0.0
        free[2] = (1.0 - blunt) * radius
        radius *= blunt
        rotate(pose[3:7], free, free)
        for j in range(3):
            start[j] += free[j]
    for j in range(3):
        start[j] += pose[j] - row[PLACE + j]
    attitude = row[PLACE + 3 : PLACE + 7]
    rotate_back(attitude, start, start)
    if ball:
        for j in range(3):
            end[j] = start[j]
    else:
        rotate(pose[3:7], row[END_1 : END_1 + 3], end)
        for j in range(3):
            end[j] += pose[j] - row[PLACE + j]
        rotate_back(attitude, end, end)
    if row[BOUND] < math.inf:  # the bounding sphere's distance from the axis
        away, half = 0.0, 0.0
        for j in range(3):
            away += (0.5 * (start[j] + end[j]) - row[CENTRE + j]) ** 2
            if not ball:
                half += (0.5 * (end[j] - start[j])) ** 2
        near = math.sqrt(away) - row[BOUND] - math.sqrt(half) - radius
        if near > ahead:
            _apart(-near, c, met)
            return
    turned = index[c * ROW + KIND] == TURNED
    if ball:
        if turned:  # passing a tree as well would double the cost
            distance = profile_distance(_profile(index, values, c), start, free)
        else:
            distance = signed_distance(_surface(index, values, c), start, radius + DEEPEST, free)
        for j in range(3):
            nearest[j] = start[j]
    else:
        # a bound at a fraction of the cost; -inf if undecided
        distance = -math.inf
        if turned:
            distance = beyond(_profile(index, values, c), start, end, radius + ahead)
        elif index[c * ROW + KIND] == MESH:
            tree = _surface(index, values, c).tree
            distance = mesh_beyond(tree, start, end, radius + ahead)
        if distance < radius + ahead:
            distance = segment_distance(
                _surface(index, values, c), start, end, radius + ahead, free, nearest
            )
        if distance >= radius + ahead:
            _apart(radius - distance, c, met)
            return
    x = radius - distance
    rotate(attitude, free, free)
    rotate(attitude, nearest, nearest)
    for j in range(3):
        nearest[j] += row[PLACE + j]
        normal[j] = -free[j]
        point[j] = nearest[j] - free[j] * (radius - (1.0 - lever) * x)
    ax, ay, az = point[0] - pose[0], point[1] - pose[1], point[2] - pose[2]
    v[0] = twist[0] + twist[4] * az - twist[5] * ay
    v[1] = twist[1] + twist[5] * ax - twist[3] * az
    v[2] = twist[2] + twist[3] * ay - twist[4] * ax
    into = -(v[0] * free[0] + v[1] * free[1] + v[2] * free[2])
    for j in range(3):
        slip[j] = v[j] + into * free[j]
    met.depth[c], met.rate[c] = x, into


@njit(cache=True)
def _apart(bound, c, met):
    """Write a bound of the penetration; clear what may be left from another run."""
    for j in range(3):
        met.point[c, j] = met.normal[c, j] = met.slip[c, j] = 0.0
    met.depth[c], met.rate[c] = bound, 0.0


@njit(cache=True)
def arm(values, count):
    """Largest distance of a round from the origin of its frame [m]."""
    longest = 0.0
    for c in range(count):
        row = values[c * VALUES : (c + 1) * VALUES]
        for e in (END_0, END_1):
            longest = max(
                longest, row[RADIUS] + math.sqrt(row[e] ** 2 + row[e + 1] ** 2 + row[e + 2] ** 2)
            )
    return longest
