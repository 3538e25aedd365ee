"""One surface of any kind, and what touches it: a ball's centre, or the axis of a rod."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hiltestbed.contact.surfaces import mesh, profile, shapes
from hiltestbed.contact.surfaces.mesh import Tree, mesh_beyond, mesh_distance
from hiltestbed.contact.surfaces.profile import COLUMNS, TURNED, between, profile_distance
from hiltestbed.contact.surfaces.revolution import recognise
from hiltestbed.contact.surfaces.shapes import shape_distance
from hiltestbed.contact.surfaces.soundness import Finding, examine
from hiltestbed.frames import Array
from hiltestbed.jit import njit

MESH = 7  # beside the kinds of :mod:`shapes`, which are MuJoCo's
HALVINGS = 5  # of a segment, at which ends a minimum is looked for
PARTS = 2**HALVINGS


class Surface(NamedTuple):
    """A surface in the frame of its geom: one of MuJoCo's geoms (``kind``, ``sizes`` (3,)), a profile or a tree of triangles."""

    kind: int
    sizes: Array
    profile: Array
    tree: Tree


def of_geom(kind: int, sizes: Array) -> Surface:
    """A plane, sphere, capsule, ellipsoid, cylinder or box, with MuJoCo's number and sizes."""
    return Surface(kind, shapes.sized(kind, sizes), np.empty((0, COLUMNS)), mesh.no_tree())


def of_mesh(vertices: Array, faces: NDArray[np.int_]) -> tuple[Surface | None, list[Finding]]:
    """The surface of a mesh, exact where it was turned about an axis, and what is wrong with it; None where it cannot be touched."""
    findings = examine(vertices, faces)
    if not all(f.usable for f in findings):
        return None, findings
    turned = recognise(vertices, faces)
    if turned is not None:
        return Surface(TURNED, np.zeros(3), turned.profile, mesh.no_tree()), findings
    return Surface(MESH, np.zeros(3), np.empty((0, COLUMNS)), mesh.plant(vertices, faces)), findings


def bounds(surface: Surface) -> tuple[Array, float]:
    """Centre (3,) and radius [m] of a ball that holds the surface; the radius of a plane's is infinite."""
    s = surface.sizes
    match surface.kind:
        case shapes.PLANE:
            return np.zeros(3), math.inf
        case shapes.SPHERE:
            return np.zeros(3), float(s[0])
        case shapes.CAPSULE:
            return np.zeros(3), float(s[0] + s[1])
        case shapes.CYLINDER:
            return np.zeros(3), math.hypot(s[0], s[1])
        case shapes.BOX:
            return np.zeros(3), float(np.linalg.norm(s))
        case shapes.ELLIPSOID:
            return np.zeros(3), float(s.max())
        case profile.TURNED:
            return profile.profile_bounds(surface.profile)
    corners = surface.tree.corners.reshape(-1, 3)
    centre = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    return centre, float(np.linalg.norm(corners - centre, axis=1).max())


@njit(cache=True)
def signed_distance(surface, point, reach, normal):
    """Distance [m] of ``point`` (3,) from the surface, negative inside; ``normal`` (3,) becomes the outward normal.

    From a mesh that is farther than ``reach`` [m] on either side a bound from below is returned, not less than ``reach``, and no
    normal; give no less than the radius of what touches and the deepest that it may be inside. Other surfaces are exact anywhere.
    """
    if surface.kind == TURNED:
        return profile_distance(surface.profile, point, normal)
    if surface.kind == MESH:
        return mesh_distance(surface.tree, point, reach, normal)
    return shape_distance(surface.kind, surface.sizes, point, normal)


@njit(cache=True)
def segment_beyond(surface, start, end, reach):
    """A bound from below of the distance [m] of a segment from ``start`` (3,) to ``end`` (3,), at a fraction of what the distance costs.

    No less than ``reach`` where it says that the segment is farther, -inf where it says nothing. For a mesh that was turned about an axis
    see :func:`hiltestbed.contact.surfaces.profile.beyond`.
    """
    if surface.kind == MESH:
        return mesh_beyond(surface.tree, start, end, reach)
    return -math.inf


@njit(cache=True)
def segment_distance(surface, start, end, reach, normal, nearest):
    """Least signed distance [m] of the points of a segment from ``start`` (3,) to ``end`` (3,).

    ``normal`` (3,) becomes the surface's outward normal at that point, which is written to ``nearest`` (3,). Only a distance below
    ``reach`` is searched for; where there is none a bound from below is returned, not less than ``reach``. An interval that may hold
    less than what is known (:func:`hiltestbed.contact.surfaces.profile.between`) is halved, down to a part in PARTS of the segment, in
    which a minimum lies where the slope along the segment changes sign.
    """
    length = math.sqrt((end[0] - start[0]) ** 2 + (end[1] - start[1]) ** 2 + (end[2] - start[2]) ** 2)
    d1, g1 = _along(surface, start, end, 1.0, reach, normal, nearest)
    d0, g0 = _along(surface, start, end, 0.0, reach, normal, nearest)
    best, at, bound = (d0, 0.0, d0) if d0 <= d1 else (d1, 1.0, d1)
    ends = np.empty((HALVINGS + 1, 3))  # right ends of the intervals that are still to be searched, the nearest last
    ends[0, 0], ends[0, 1], ends[0, 2] = 1.0, d1, g1
    count, t0 = 1, 0.0
    while count > 0:
        t1, d1, g1 = ends[count - 1, 0], ends[count - 1, 1], ends[count - 1, 2]
        least = between(d0, d1, (t1 - t0) * length)
        if least < min(best, reach):
            if t1 - t0 > 1.0 / PARTS:
                t = 0.5 * (t0 + t1)
                d, g = _along(surface, start, end, t, reach, normal, nearest)
                ends[count, 0], ends[count, 1], ends[count, 2] = t, d, g
                count += 1
                if d < best:
                    best, at = d, t
                continue
            if g0 < 0.0 < g1:
                t, d = _turning(surface, start, end, t0, t1, g0, g1, reach, normal, nearest)
                if d < best:
                    best, at = d, t
        else:
            bound = min(bound, least)
        t0, d0, g0 = t1, d1, g1
        count -= 1
    if best >= reach:
        return max(reach, min(best, bound))
    best, _ = _along(surface, start, end, at, reach, normal, nearest)
    return best


@njit(cache=True)
def _along(surface, start, end, t, reach, normal, place):
    """Distance of the point at ``t`` of the segment and its slope in t."""
    for j in range(3):
        place[j] = start[j] + t * (end[j] - start[j])
    d = signed_distance(surface, place, reach, normal)
    slope = 0.0
    for j in range(3):
        slope += normal[j] * (end[j] - start[j])
    return d, slope


@njit(cache=True)
def _turning(surface, start, end, low, high, slope_low, slope_high, reach, normal, place):
    """Where the slope changes sign between ``low`` and ``high``: the Illinois method, halving where it jumps."""
    t, d, side = low, math.inf, 0
    for k in range(80):
        t = 0.5 * (low + high) if k % 4 == 3 else (low * slope_high - high * slope_low) / (slope_high - slope_low)
        d, slope = _along(surface, start, end, t, reach, normal, place)
        if slope == 0.0 or high - low < 1e-15:
            break
        if slope < 0.0:
            low, slope_low = t, slope
            if side < 0:
                slope_high *= 0.5
            side = -1
        else:
            high, slope_high = t, slope
            if side > 0:
                slope_low *= 0.5
            side = 1
    return t, d
