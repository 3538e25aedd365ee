"""A surface of any kind, and its distance from a point (a ball's centre) or a segment (the axis of
a rod).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.jit import njit
from hiltestbed.contact.surfaces import mesh, profile, shapes
from hiltestbed.contact.surfaces.mesh import Tree, mesh_beyond, mesh_distance
from hiltestbed.contact.surfaces.profile import COLUMNS, TURNED, between, profile_distance
from hiltestbed.contact.surfaces.revolution import recognise
from hiltestbed.contact.surfaces.shapes import shape_distance
from hiltestbed.contact.surfaces.soundness import Finding, examine
from hiltestbed.frames import Array

MESH = 7  # number of this kind of surface, in addition to those of :mod:`shapes`, as in MuJoCo
# largest distance from the hull of a convex mesh, over its size: the digits of an STL or OBJ file
CONVEX = 1e-5
HALVINGS = 5  # largest number of times that a segment is halved in the search for minima
PARTS = 2**HALVINGS


class Surface(NamedTuple):
    """A surface in the frame of its geom: one of MuJoCo's geoms (``kind``, ``sizes`` (3,)), a
    profile or a tree of triangles.
    """

    kind: int
    sizes: Array
    profile: Array
    tree: Tree


def of_geom(kind: int, sizes: Array) -> Surface:
    """A plane, sphere, capsule, ellipsoid, cylinder or box, with MuJoCo's number and sizes."""
    return Surface(kind, shapes.sized(kind, sizes), np.empty((0, COLUMNS)), mesh.no_tree())


def of_mesh(vertices: Array, faces: NDArray[np.int_]) -> tuple[Surface | None, list[Finding]]:
    """The surface of a mesh, exact for a mesh of revolution, and its faults; None if the mesh is
    not usable.
    """
    findings = examine(vertices, faces)
    if not all(f.usable for f in findings):
        return None, findings
    turned = recognise(vertices, faces)
    if turned is not None:
        return Surface(TURNED, np.zeros(3), turned.profile, mesh.no_tree()), findings
    return Surface(MESH, np.zeros(3), np.empty((0, COLUMNS)), mesh.plant(vertices, faces)), findings


def hollow(vertices: Array, faces: NDArray[np.int_]) -> float | None:
    """Largest distance [m] of a mesh from its convex hull; None for a convex mesh.

    The distance is that of the centres of the faces: a face is on the hull if its centre is. It is
    infinite for a mesh that is not closed or not usable otherwise.
    """
    from scipy.spatial import ConvexHull, QhullError

    if not all(f.usable for f in examine(vertices, faces)):
        return math.inf
    try:
        hull = ConvexHull(vertices)
    except QhullError:
        return math.inf
    size, middle = float(np.ptp(vertices, axis=0).max()), vertices.mean(axis=0)
    # a little larger than the hull: the distance of a point on a mesh has no direction
    around = middle + (1.0 + CONVEX) * (vertices - middle)
    tree, normal = mesh.plant(around, hull.simplices.astype(int)), np.empty(3)
    centres = vertices[faces].mean(axis=1)
    deepest = max(abs(mesh_distance(tree, centre, size, normal)) for centre in centres)
    return deepest if deepest > 2.0 * CONVEX * size else None


def bounds(surface: Surface) -> tuple[Array, float]:
    """Centre (3,) and radius [m] of a bounding sphere of the surface; infinite for a plane."""
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
    """Distance [m] of ``point`` (3,) from the surface, negative inside; ``normal`` (3,) becomes the
    outward normal.

    For a mesh farther than ``reach`` [m] on either side a lower bound, at least ``reach``, is
    returned, without a normal; ``reach`` must be at least the radius of the body that touches plus
    its largest penetration. Other surfaces are exact everywhere.
    """
    if surface.kind == TURNED:
        return profile_distance(surface.profile, point, normal)
    if surface.kind == MESH:
        return mesh_distance(surface.tree, point, reach, normal)
    return shape_distance(surface.kind, surface.sizes, point, normal)


@njit(cache=True)
def segment_beyond(surface, start, end, reach):
    """A lower bound of the distance [m] of a segment from ``start`` (3,) to ``end`` (3,), at a
    fraction of the cost of the distance.

    At least ``reach`` if the segment is certainly farther, -inf if undecided. For a mesh of
    revolution see :func:`hiltestbed.contact.surfaces.profile.beyond`.
    """
    if surface.kind == MESH:
        return mesh_beyond(surface.tree, start, end, reach)
    return -math.inf


@njit(cache=True)
def segment_distance(surface, start, end, reach, normal, nearest):
    """Least signed distance [m] of the points of a segment from ``start`` (3,) to ``end`` (3,).

    ``normal`` (3,) becomes the surface's outward normal at that point, which is written to
    ``nearest`` (3,). Only a distance below ``reach`` is searched for; otherwise a lower bound, at
    least ``reach``, is returned. An interval that may contain a smaller distance than the best so
    far (:func:`hiltestbed.contact.surfaces.profile.between`) is halved, down to 1/PARTS of the
    segment; there a minimum is located where the slope along the segment changes sign.
    """
    length = math.sqrt(
        (end[0] - start[0]) ** 2 + (end[1] - start[1]) ** 2 + (end[2] - start[2]) ** 2
    )
    d1, g1 = _along(surface, start, end, 1.0, reach, normal, nearest)
    d0, g0 = _along(surface, start, end, 0.0, reach, normal, nearest)
    best, at, bound = (d0, 0.0, d0) if d0 <= d1 else (d1, 1.0, d1)
    # right ends of the intervals that are still to be searched, the nearest last
    ends = np.empty((HALVINGS + 1, 3))
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
    """Distance of the point at ``t`` (0 to 1) of the segment, and its derivative with respect to
    t.
    """
    for j in range(3):
        place[j] = start[j] + t * (end[j] - start[j])
    d = signed_distance(surface, place, reach, normal)
    slope = 0.0
    for j in range(3):
        slope += normal[j] * (end[j] - start[j])
    return d, slope


@njit(cache=True)
def _turning(surface, start, end, low, high, slope_low, slope_high, reach, normal, place):
    """Where the slope changes sign between ``low`` and ``high``: the Illinois method, with a
    bisection in every fourth step.
    """
    t, d, side = low, math.inf, 0
    for k in range(80):
        t = (
            0.5 * (low + high)
            if k % 4 == 3
            else (low * slope_high - high * slope_low) / (slope_high - slope_low)
        )
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
