"""A surface of any kind, and its distance from a point (a ball's centre) or a segment (the axis of
a rod).

The analytic geoms are those of MuJoCo, in the geom's frame and with MuJoCo's sizes. plane: z <= 0
is inside, unbounded. sphere: (radius). capsule, cylinder: (radius, half length) along z. box: half
sizes. ellipsoid: semi-axes. Box and cylinder by the usual decomposition into faces, edges and
corners; ellipsoid after D. Eberly, "Distance from a Point to an Ellipse, an Ellipsoid, or a
Hyperellipsoid", 2013, with Newton's method in place of bisection.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.jit import njit
from hiltestbed.contact.surfaces import mesh, profile
from hiltestbed.contact.surfaces.mesh import Tree, mesh_distance
from hiltestbed.contact.surfaces.profile import COLUMNS, TURNED, between, profile_distance
from hiltestbed.contact.surfaces.revolution import recognise
from hiltestbed.contact.surfaces.soundness import MeshFault, examine
from hiltestbed.frames import Array

# as mujoco.mjtGeom, the second of which is a height field
PLANE, _, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH = range(8)
KINDS = (PLANE, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX)


@njit(cache=True)
def _ball(x, y, z, radius, normal):
    away = math.sqrt(x * x + y * y + z * z)
    if away > 0.0:
        normal[0], normal[1], normal[2] = x / away, y / away, z / away
    else:
        normal[0], normal[1], normal[2] = 1.0, 0.0, 0.0
    return away - radius


@njit(cache=True)
def _cylinder(sizes, point, normal):
    rho = math.sqrt(point[0] * point[0] + point[1] * point[1])
    ux, uy = (point[0] / rho, point[1] / rho) if rho > 0.0 else (1.0, 0.0)
    side, end = rho - sizes[0], abs(point[2]) - sizes[1]
    if side > 0.0 and end > 0.0:
        distance = math.sqrt(side * side + end * end)
        nr, nz = side / distance, end / distance
    elif side > end:
        distance, nr, nz = side, 1.0, 0.0
    else:
        distance, nr, nz = end, 0.0, 1.0
    normal[0], normal[1], normal[2] = nr * ux, nr * uy, math.copysign(nz, point[2])
    return distance


@njit(cache=True)
def _box(sizes, point, normal):
    deepest, face, outside = -math.inf, 0, 0.0
    for i in range(3):
        past = abs(point[i]) - sizes[i]
        if past > deepest:
            deepest, face = past, i
        normal[i] = math.copysign(past, point[i]) if past > 0.0 else 0.0
        outside += normal[i] * normal[i]
    if deepest <= 0.0:
        normal[face] = math.copysign(1.0, point[face])
        return deepest
    distance = math.sqrt(outside)
    for i in range(3):
        normal[i] /= distance
    return distance


@njit(cache=True)
def _ellipsoid(sizes, point, normal):
    """x_i = a_i^2 p_i/(t + a_i^2) is nearest, sum (a_i p_i/(t + a_i^2))^2 = 1, t > -min a^2."""
    least = 0
    for i in range(1, 3):
        if sizes[i] < sizes[least]:
            least = i
    low = -sizes[least] * sizes[least]
    t = _multiplier(sizes, point, low + sizes[least] * abs(point[least]))
    apart, level = 0.0, 0.0
    for i in range(3):
        a2 = sizes[i] * sizes[i]
        level += point[i] * point[i] / a2
        x = a2 * point[i] / (t + a2) if t + a2 > 0.0 else 0.0
        apart += (x / sizes[i]) ** 2
        normal[i] = x
    # inside, on the medial surface of the shortest axis: both directions are equally near
    if 1.0 - apart > 1e-12:
        normal[least] += math.copysign(sizes[least] * math.sqrt(1.0 - apart), point[least])
    length, distance = 0.0, 0.0
    for i in range(3):
        distance += (point[i] - normal[i]) ** 2
        normal[i] /= sizes[i] * sizes[i]
        length += normal[i] * normal[i]
    length = math.sqrt(length)
    for i in range(3):
        normal[i] /= length
    return math.copysign(math.sqrt(distance), level - 1.0)


@njit(cache=True)
def _multiplier(sizes, point, t):
    """Root of the decreasing convex sum (a_i p_i/(t + a_i^2))^2 - 1, from a ``t`` below it."""
    for _ in range(200):
        value, slope = -1.0, 0.0
        for i in range(3):
            below = t + sizes[i] * sizes[i]
            if point[i] == 0.0 or below <= 0.0:
                continue
            ratio = sizes[i] * point[i] / below
            value += ratio * ratio
            slope -= 2.0 * ratio * ratio / below
        if value <= 0.0 or slope == 0.0:
            break
        step = -value / slope
        t += step
        if step <= 1e-16 * abs(t):
            break
    return t


# largest distance from the hull of a convex mesh, over its size: the digits of an STL or OBJ file
CONVEX = 1e-5
HALVINGS = 5  # largest number of times that a segment is halved in the search for minima
PARTS = 2**HALVINGS


class Surface(NamedTuple):
    """A surface in its geom's frame: a geom (``kind``, ``sizes`` (3,)), a profile or triangles."""

    kind: int
    sizes: Array
    profile: Array = np.empty((0, COLUMNS))
    tree: Tree = mesh.NO_TREE


def of_geom(kind: int, sizes: Array) -> Surface:
    """A plane, sphere, capsule, ellipsoid, cylinder or box, with MuJoCo's number and sizes."""
    # a plane's size in MuJoCo is only for drawing
    return Surface(kind, np.zeros(3) if kind == PLANE else np.array(sizes, dtype=float))


def of_mesh(vertices: Array, faces: NDArray[np.int_]) -> tuple[Surface | None, list[MeshFault]]:
    """The surface of a mesh, exact if it is one of revolution, and its faults; None: unusable."""
    findings = examine(vertices, faces)
    if not all(f.usable for f in findings):
        return None, findings
    turned = recognise(vertices, faces)
    if turned is not None:
        return Surface(TURNED, np.zeros(3), turned.profile), findings
    return Surface(MESH, np.zeros(3), tree=mesh.plant(vertices, faces)), findings


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
    kind, s = surface.kind, surface.sizes
    if kind == TURNED:
        rows, p = surface.profile[1:], profile
        ends = np.concatenate([rows[:, p.A : p.A + 2], rows[:, p.B : p.B + 2]])
        middle = 0.5 * (ends[:, 1].min() + ends[:, 1].max())
        away = float(np.hypot(ends[:, 0], ends[:, 1] - middle).max())
        for row in rows[rows[:, p.KIND] == p.ARC]:
            away = max(away, math.hypot(row[p.U], row[p.U + 1] - middle) + row[p.SIZE])
        return surface.profile[0, 0:3] + middle * surface.profile[0, 3:6], away
    if kind == MESH:
        corners = surface.tree.corners.reshape(-1, 3)
        centre = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        return centre, float(np.linalg.norm(corners - centre, axis=1).max())
    radius = {
        PLANE: math.inf,
        SPHERE: s[0],
        CAPSULE: s[0] + s[1],
        CYLINDER: math.hypot(s[0], s[1]),
        BOX: np.linalg.norm(s),
        ELLIPSOID: s.max(),
    }
    return np.zeros(3), float(radius[kind])


@njit(cache=True)
def signed_distance(surface, point, reach, normal):
    """Distance [m] of ``point`` (3,) from the surface, negative inside; ``normal`` (3,) becomes the
    outward normal.

    For a mesh farther than ``reach`` [m] on either side a lower bound, at least ``reach``, is
    returned, without a normal; ``reach`` must be at least the radius of the body that touches plus
    its largest penetration. Other surfaces are exact everywhere; if several of their points are
    equally near (as from the centre of a sphere), one of them is taken.
    """
    kind, sizes = surface.kind, surface.sizes
    if kind == TURNED:
        return profile_distance(surface.profile, point, normal)
    if kind == MESH:
        return mesh_distance(surface.tree, point, reach, normal)
    if kind == SPHERE:
        return _ball(point[0], point[1], point[2], sizes[0], normal)
    if kind == CAPSULE:
        end = min(max(point[2], -sizes[1]), sizes[1])
        return _ball(point[0], point[1], point[2] - end, sizes[0], normal)
    if kind == CYLINDER:
        return _cylinder(sizes, point, normal)
    if kind == BOX:
        return _box(sizes, point, normal)
    if kind == ELLIPSOID:
        return _ellipsoid(sizes, point, normal)
    normal[0] = normal[1] = 0.0
    normal[2] = 1.0
    return point[2]


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
                t, d = _turning(surface, start, end, (t0, t1), (g0, g1), reach, normal, nearest)
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
    """Distance of the segment's point at ``t`` (0 to 1), and its derivative by t."""
    for j in range(3):
        place[j] = start[j] + t * (end[j] - start[j])
    d = signed_distance(surface, place, reach, normal)
    slope = 0.0
    for j in range(3):
        slope += normal[j] * (end[j] - start[j])
    return d, slope


@njit(cache=True)
def _turning(surface, start, end, ends, slopes, reach, normal, place):
    """Where the slope changes sign: the Illinois method, every fourth step a bisection."""
    (low, high), (slope_low, slope_high) = ends, slopes
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
