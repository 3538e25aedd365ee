"""Distance from a surface of revolution, exact in azimuth and along its profile.

The profile lies in the half plane (rho, z) about the axis: straight segments and circular arcs,
each with its outward normal. The nearest point of a surface of revolution lies in the half plane of
the query point, which reduces the distance to two dimensions. At a corner the sign comes from the
sum of the adjacent outward normals (the pseudo-normal of Baerentzen and Aanaes, IEEE TVCG 11(3),
2005, in the plane).

A profile is one array (1 + m, COLUMNS): row 0 holds a point on the axis, the axis, and a unit
vector across it; each further row one element.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array

SEGMENT, ARC = 0.0, 1.0
# Columns of an element: kind; its two ends; for a segment the direction, the outward normal and the
# length; for an arc the centre, the direction from the centre to its middle, radius, cosine of half
# the sweep, and +1 if the outward normal points away from the centre, else -1; the pseudo-normals
# at both ends.
KIND, A, B, U, V, SIZE, COS_HALF, SIDE, NORMAL_A, NORMAL_B = 0, 1, 3, 5, 7, 9, 10, 11, 12, 14
COLUMNS = NORMAL_B + 2
TURNED = 100  # number of this kind of surface, distinct from MuJoCo's geom types
SAMPLES = 12  # largest number of samples along a rod to show that it does not touch
TOUCHING = 1e-13  # [m] distance below which the direction to a corner is undefined


@dataclass(frozen=True)
class Element:
    """An element of a profile from ``a`` to ``b``, (rho, z) [m], with the outward side on the left
    of its direction.

    Attributes:
        centre: of an arc; None: a straight segment. clockwise: sense of the arc.
    """

    a: tuple[float, float]
    b: tuple[float, float]
    centre: tuple[float, float] | None = None
    clockwise: bool = False

    def sweep(self) -> tuple[float, float]:
        """Of an arc: angle of its start about the centre, and from there to its end [rad]."""
        assert self.centre is not None
        (rho, z), full = self.centre, 2.0 * math.pi
        start, end = (math.atan2(p[1] - z, p[0] - rho) for p in (self.a, self.b))
        if self.clockwise:
            return start, -((start - end) % full or full)
        return start, (end - start) % full or full


def compile_profile(loops: list[list[Element]], origin: Array, axis: Array) -> Array:
    """``(1 + m, COLUMNS)`` profile of chains of elements about the ``axis`` (3,) through ``origin``
    (3,) [m].

    In a chain each element begins where the previous one ends; a chain that ends at its start is
    closed.
    """
    rows = [_head(origin, axis)]
    for loop in loops:
        compiled = [_row(e) for e in loop]
        _join(loop, compiled)
        rows += compiled
    return np.array(rows)


def _head(origin: Array, axis: Array) -> Array:
    row = np.zeros(COLUMNS)
    axis = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    row[0:3], row[3:6], row[6:9] = origin, axis, across / np.linalg.norm(across)
    return row


def _row(e: Element) -> Array:
    row = np.zeros(COLUMNS)
    a, b = np.array(e.a), np.array(e.b)
    row[A : A + 2], row[B : B + 2] = a, b
    if e.centre is None:
        t = (b - a) / np.linalg.norm(b - a)
        row[KIND] = SEGMENT
        row[U : U + 2] = t
        row[V : V + 2] = (-t[1], t[0])
        row[SIZE] = np.linalg.norm(b - a)
        return row
    centre = np.array(e.centre)
    start, sweep = e.sweep()
    middle = start + 0.5 * sweep
    radius = 0.5 * (np.linalg.norm(a - centre) + np.linalg.norm(b - centre))
    row[KIND], row[U : U + 2], row[V : V + 2] = ARC, centre, (math.cos(middle), math.sin(middle))
    row[SIZE] = radius
    row[COS_HALF] = math.cos(0.5 * sweep)
    row[SIDE] = 1.0 if e.clockwise else -1.0
    return row


def _end_normal(row: Array, end: Array) -> Array:
    """Outward normal of one element at one of its ends."""
    if row[KIND] == SEGMENT:
        return row[V : V + 2]
    away = end - row[U : U + 2]
    return row[SIDE] * away / np.linalg.norm(away)


def _join(loop: list[Element], rows: list[Array]) -> None:
    """Pseudo-normals at the ends; on the axis the neighbour is the element's own mirror image."""
    for i, (e, row) in enumerate(zip(loop, rows, strict=True)):
        for end, at, neighbour, its_end in (
            (e.a, NORMAL_A, i - 1, B),
            (e.b, NORMAL_B, (i + 1) % len(rows), A),
        ):
            normal = _end_normal(row, np.array(end)).copy()
            other = rows[neighbour]
            if end[0] == 0.0:
                normal[0] = 0.0
            elif np.allclose(other[its_end : its_end + 2], end, rtol=0.0, atol=0.0):
                normal += _end_normal(other, np.array(end))
            length = np.linalg.norm(normal)
            row[at : at + 2] = (
                normal / length if length > 1e-12 else _end_normal(row, np.array(end))
            )


@njit(cache=True)
def profile_distance(profile, point, normal):
    """Distance [m] of ``point`` (3,), negative inside; ``normal`` (3,): becomes the outward one."""
    head = profile[0]
    x, y, z = point[0] - head[0], point[1] - head[1], point[2] - head[2]
    h = x * head[3] + y * head[4] + z * head[5]
    x, y, z = x - h * head[3], y - h * head[4], z - h * head[5]
    rho = math.sqrt(x * x + y * y + z * z)
    distance, nr, nz = _in_plane(profile, rho, h)
    if rho > 1e-15:
        x, y, z = x / rho, y / rho, z / rho
    else:
        x, y, z = head[6], head[7], head[8]
    normal[0] = nr * x + nz * head[3]
    normal[1] = nr * y + nz * head[4]
    normal[2] = nr * z + nz * head[5]
    return distance


@njit(cache=True)
def between(first, second, length):
    """Lower bound of the distance on an interval of ``length`` [m] at whose ends it is ``first``
    and ``second`` [m].

    The distance is Lipschitz continuous with constant 1 (Piyavskii, USSR Comput. Math. 12(4),
    1972): it is at least the mean of both less half the length. Outside, no point of the surface is
    within the balls around the ends with these radii, so that its distance from the interval is at
    least the radius of the circle in which the balls intersect.
    """
    least = 0.5 * (first + second - length)
    if first > 0.0 and second > 0.0 and length < first + second:
        cut = (
            0.5 * (length * length + first * first - second * second) / length
            if length > 0.0
            else 0.0
        )
        if cut <= 0.0:
            least = max(least, first)
        elif cut >= length:
            least = max(least, second)
        else:
            least = max(least, math.sqrt(max(first * first - cut * cut, 0.0)))
    return least


@njit(cache=True)
def beyond(profile, start, end, reach):
    """A lower bound of the distance [m] of a segment from ``start`` (3,) to ``end`` (3,); less than
    ``reach`` if it may be nearer.

    In the half plane (rho, z) the segment is a hyperbola: rho^2 is quadratic along it.
    """
    head = profile[0]
    hx, hy, hz = head[3], head[4], head[5]
    x, y, z = start[0] - head[0], start[1] - head[1], start[2] - head[2]
    dx, dy, dz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    h, dh = x * hx + y * hy + z * hz, dx * hx + dy * hy + dz * hz
    x, y, z = x - h * hx, y - h * hy, z - h * hz
    dx, dy, dz = dx - dh * hx, dy - dh * hy, dz - dh * hz
    c, b, a = x * x + y * y + z * z, 2.0 * (x * dx + y * dy + z * dz), dx * dx + dy * dy + dz * dz
    length = math.sqrt(a + dh * dh)
    last, _, _ = _in_plane(profile, math.sqrt(max(a + b + c, 0.0)), h + dh)
    first, _, _ = _in_plane(profile, math.sqrt(c), h)
    bound, t0, t1, there = min(first, last), 0.0, 1.0, last
    for _ in range(SAMPLES):
        if bound < reach:
            break
        least = between(first, there, (t1 - t0) * length)
        if least >= reach:
            if t1 == 1.0:
                return min(bound, least)
            bound, t0, first, t1, there = min(bound, least), t1, there, 1.0, last
            continue
        t1 = 0.5 * (t0 + t1)
        there, _, _ = _in_plane(profile, math.sqrt(max(c + t1 * (b + t1 * a), 0.0)), h + t1 * dh)
        bound = min(bound, there)
    return -math.inf


@njit(cache=True)
def _in_plane(profile, rho, z):
    best, distance, nr, nz = math.inf, math.inf, 0.0, 0.0
    for i in range(1, profile.shape[0]):
        if profile[i, KIND] == SEGMENT:
            dr, dz = rho - profile[i, A], z - profile[i, A + 1]
            along = dr * profile[i, U] + dz * profile[i, U + 1]
            if 0.0 < along < profile[i, SIZE]:
                d = dr * profile[i, V] + dz * profile[i, V + 1]
                if abs(d) < best:
                    best, distance, nr, nz = abs(d), d, profile[i, V], profile[i, V + 1]
                continue
            first = along <= 0.0
        else:
            dr, dz = rho - profile[i, U], z - profile[i, U + 1]
            away = math.sqrt(dr * dr + dz * dz)
            middle = dr * profile[i, V] + dz * profile[i, V + 1]
            if middle >= away * profile[i, COS_HALF]:
                d = profile[i, SIDE] * (away - profile[i, SIZE])
                if abs(d) < best:
                    best, distance = abs(d), d
                    if away > TOUCHING:
                        nr, nz = profile[i, SIDE] * dr / away, profile[i, SIDE] * dz / away
                    else:  # at the centre of an arc all its points are equally near
                        nr = profile[i, SIDE] * profile[i, V]
                        nz = profile[i, SIDE] * profile[i, V + 1]
                continue
            first = (rho - profile[i, A]) ** 2 + (z - profile[i, A + 1]) ** 2 <= (
                rho - profile[i, B]
            ) ** 2 + (z - profile[i, B + 1]) ** 2
        at, by = (A, NORMAL_A) if first else (B, NORMAL_B)
        dr, dz = rho - profile[i, at], z - profile[i, at + 1]
        away = math.sqrt(dr * dr + dz * dz)
        if away < best:
            best = away
            outside = dr * profile[i, by] + dz * profile[i, by + 1] >= 0.0
            distance = away if outside else -away
            if away > TOUCHING:
                sign = 1.0 if outside else -1.0
                nr, nz = sign * dr / away, sign * dz / away
            else:
                nr, nz = profile[i, by], profile[i, by + 1]
    return distance, nr, nz
