"""Distance from the analytic geoms of MuJoCo, in the geom's frame and with MuJoCo's sizes.

plane: z <= 0 is inside, unbounded. sphere: (radius). capsule, cylinder: (radius, half length) along
z. box: half sizes. ellipsoid: semi-axes. Box and cylinder by the usual decomposition into faces,
edges and corners; ellipsoid after D. Eberly, "Distance from a Point to an Ellipse, an Ellipsoid, or
a Hyperellipsoid", 2013, with Newton's method in place of bisection.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from hiltestbed.compiled.jit import njit

PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)
SPHERE = int(mujoco.mjtGeom.mjGEOM_SPHERE)
CAPSULE = int(mujoco.mjtGeom.mjGEOM_CAPSULE)
ELLIPSOID = int(mujoco.mjtGeom.mjGEOM_ELLIPSOID)
CYLINDER = int(mujoco.mjtGeom.mjGEOM_CYLINDER)
BOX = int(mujoco.mjtGeom.mjGEOM_BOX)
KINDS = (PLANE, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX)


@njit(cache=True)
def shape_distance(kind, sizes, point, normal):
    """Distance [m] of ``point`` (3,) from the surface, negative inside; ``normal`` (3,) becomes the
    outward normal.

    If several points of the surface are equally near (as from the centre of a sphere), one of them
    is taken.
    """
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
    """The nearest point is x_i = a_i^2 p_i/(t + a_i^2) with sum (a_i p_i/(t + a_i^2))^2 = 1, t >
    -min a^2.
    """
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
    """Root of the decreasing convex function sum (a_i p_i/(t + a_i^2))^2 - 1, from a ``t`` below
    it.
    """
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


def sized(kind: int, sizes: np.ndarray) -> np.ndarray:
    """The sizes (3,) of a geom for the distance: zero for a plane, whose size in MuJoCo is only for
    drawing.
    """
    return np.zeros(3) if kind == PLANE else np.array(sizes, dtype=float)
