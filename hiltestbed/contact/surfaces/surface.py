"""One surface of any kind, and what touches it: a ball's centre, or the axis of a rod."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hiltestbed.contact.surfaces import mesh, profile, shapes
from hiltestbed.contact.surfaces.mesh import Tree, mesh_distance
from hiltestbed.contact.surfaces.profile import COLUMNS, TURNED, profile_distance
from hiltestbed.contact.surfaces.revolution import recognise
from hiltestbed.contact.surfaces.shapes import shape_distance
from hiltestbed.contact.surfaces.soundness import Finding, examine
from hiltestbed.frames import Array

MESH = 7  # beside the kinds of :mod:`shapes`, which are MuJoCo's
PLACES = 33  # on a segment from which a minimum is searched


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
def segment_distance(surface, start, end, reach, normal, nearest):
    """Least signed distance [m] of the points of a segment from ``start`` (3,) to ``end`` (3,).

    ``normal`` (3,) becomes the surface's outward normal at that point, which is written to ``nearest`` (3,). Only a distance below
    ``reach`` is refined; where there is none a bound from below is returned, not less than ``reach``. The distance changes no faster
    than the place, so what is far is passed in long strides; a minimum lies where its slope along the segment changes sign.
    """
    length = 0.0
    for j in range(3):
        length += (end[j] - start[j]) ** 2
    length = math.sqrt(length)
    best, at, bound = math.inf, 0.0, math.inf
    stride = 1.0 / (PLACES - 1)
    t0 = 0.0
    d0, g0 = _along(surface, start, end, t0, reach, normal, nearest)
    if d0 < reach:
        best, at = d0, 0.0
    while t0 < 1.0:
        if d0 - length * stride > reach:  # nothing below reach before t0 + (d0 - reach)/length
            t1 = min(t0 + (d0 - reach) / length, 1.0)
            bound = min(bound, reach)
        else:
            t1 = min(t0 + stride, 1.0)
        d1, g1 = _along(surface, start, end, t1, reach, normal, nearest)
        if d1 < reach and d1 < best:
            best, at = d1, t1
        if g0 < 0.0 < g1 and 0.5 * (d0 + d1 - (t1 - t0) * length) < min(best, reach):
            t, d = _turning(surface, start, end, t0, t1, g0, g1, reach, normal, nearest)
            if d < reach and d < best:
                best, at = d, t
        t0, d0, g0 = t1, d1, g1
    if best == math.inf:
        return max(reach, min(d0, bound))
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
