"""Recognises a triangle mesh of a surface of revolution, and recovers its profile.

The vertices of such a mesh lie on rings about the axis, and every triangle spans two neighbouring
rings (or one ring and the axis). Vertices on one ring share (rho, z), and the triangles determine
which rings are neighbours, so the profile's polyline follows uniquely. Its points lie on the curve
from which the mesh was made: collinear points become one segment, points on a circle one arc.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hiltestbed.contact.surfaces.profile import Element, compile_profile
from hiltestbed.frames import Array

Faces = NDArray[np.int_]
TOLERANCE = 2e-6  # of the mesh's size: float32 vertices, or text with six decimals of a metre
FEWEST_SEGMENTS = 24  # per revolution; a mesh with fewer is treated as a polyhedron
# largest angle between two edges of one arc: excludes an octagon, admits a quarter turn in three
# edges
SHARPEST_TURN = math.radians(31.0)
FEWEST_ON_ARC = 4  # points; three always lie on a circle


@dataclass(frozen=True)
class Revolution:
    """A surface of revolution.

    Attributes:
        profile: for :func:`hiltestbed.contact.surfaces.profile.profile_distance`, in the frame of
            the mesh.
        loops: the chains of elements of the profile, in (rho, z).
    """

    profile: Array
    loops: list[list[Element]]


def recognise(vertices: Array, faces: Faces, tolerance: float = TOLERANCE) -> Revolution | None:
    """The surface of revolution whose mesh has the ``vertices`` (nv, 3) [m] and ``faces`` (nf, 3);
    None if it is not such a mesh.

    ``tolerance`` is relative to the largest extent of the mesh's bounding box. The triangles'
    normals point outwards.
    """
    vertices, faces = np.asarray(vertices, dtype=float), np.asarray(faces, dtype=int)
    if len(faces) < FEWEST_SEGMENTS:
        return None
    size = float(np.ptp(vertices[faces].reshape(-1, 3), axis=0).max())
    for origin, axis in _axes(vertices, faces):
        found = _about(vertices, faces, origin, axis, tolerance * size)
        if found is not None:
            return found
    return None


def _axes(vertices: Array, faces: Faces) -> list[tuple[Array, Array]]:
    """Candidate axes: of the frame through its origin; of frame and inertia at the centroid."""
    corners = vertices[faces]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    if area.sum() <= 0.0:
        return []
    centre = np.average(corners.mean(axis=1), axis=0, weights=area)
    arms = corners - centre
    total = arms.sum(axis=1)
    moments = np.einsum("f,fki,fkj->ij", area, arms, arms) + np.einsum(
        "f,fi,fj->ij", area, total, total
    )
    principal = np.linalg.eigh(moments)[1].T
    frame = np.eye(3)[[2, 0, 1]]
    return (
        [(np.zeros(3), a) for a in frame]
        + [(centre, a) for a in frame]
        + [(centre, a) for a in principal]
    )


def _about(
    vertices: Array, faces: Faces, origin: Array, axis: Array, tolerance: float
) -> Revolution | None:
    arms = vertices - origin
    z = arms @ axis
    across = arms - z[:, None] * axis
    rho = np.linalg.norm(across, axis=1)
    ring, rings = _group(rho, z, tolerance)
    if ring is None:
        return None
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side /= np.linalg.norm(side)
    azimuth = np.arctan2(across @ np.cross(axis, side), across @ side)
    edges = _edges(faces, ring, rings, azimuth, tolerance)
    if edges is None:
        return None
    chains = _chains(edges)
    if chains is None:
        return None
    loops = [_fit(rings[c], tolerance) for c in chains]
    return Revolution(compile_profile(loops, origin, axis), loops)


def _group(rho: Array, z: Array, tolerance: float) -> tuple[NDArray[np.int_] | None, Array]:
    """The ring (nv,) of each vertex, and (rho, z) of the rings; None if they are too many."""
    ring = np.full(len(rho), -1, dtype=int)
    rings: list[tuple[float, float]] = []
    order = np.lexsort((rho, z))
    points = np.stack([rho, z], axis=1)
    most = len(rho) // FEWEST_SEGMENTS + 3
    # Along z a new band begins at a gap; within a band along rho.
    for band in np.split(order, np.flatnonzero(np.diff(z[order]) > 2.0 * tolerance) + 1):
        band = band[np.argsort(rho[band], kind="stable")]
        for members in np.split(band, np.flatnonzero(np.diff(rho[band]) > 2.0 * tolerance) + 1):
            if len(rings) > most or np.ptp(points[members], axis=0).max() > 4.0 * tolerance:
                return None, np.empty((0, 2))
            ring[members] = len(rings)
            r, h = points[members].mean(axis=0)
            rings.append((0.0 if r < 2.0 * tolerance else float(r), float(h)))
    return ring, np.array(rings)


def _edges(
    faces: Faces, ring: NDArray[np.int_], rings: Array, azimuth: Array, tolerance: float
) -> list[tuple[int, int]] | None:
    """The profile's edges (a, b), outward on the left; None if not all bands go round once."""
    turned: dict[tuple[int, int], list[float]] = {}
    on_axis = rings[:, 0] == 0.0
    for face in faces:
        for k in range(3):
            p, q, r = face[k], face[(k + 1) % 3], face[(k + 2) % 3]
            a, b = int(ring[p]), int(ring[r])
            if ring[q] != a or b == a or on_axis[a]:
                continue
            span = float((azimuth[q] - azimuth[p] + math.pi) % (2.0 * math.pi) - math.pi)
            if abs(span) > 2.1 * math.pi / FEWEST_SEGMENTS:
                return None
            # Counter-clockwise along ring a with the triangle on its left: seen from the axis, the
            # outward side is left of b -> a.
            key = (b, a) if span > 0.0 else (a, b)
            turned.setdefault(key, [0.0, 0.0])[0 if key[0] == a else 1] += abs(span)
            break
        else:
            seen = ring[face]
            if len(set(seen.tolist())) == 3 or (
                len(set(seen.tolist())) == 1 and not on_axis[seen[0]]
            ):
                return None  # across three rings, or a cap without a point on the axis
    for (a, b), spans in turned.items():
        for end, span in zip((a, b), spans, strict=True):
            if not on_axis[end] and abs(span - 2.0 * math.pi) > 1e-3:
                return None
    return list(turned) or None


def _chains(edges: list[tuple[int, int]]) -> list[list[int]] | None:
    """Rings along each chain, a closed one ends with its first; None if they branch."""
    after = dict(edges)
    if len(after) != len(edges) or len(set(after.values())) != len(edges):
        return None
    starts = [a for a in after if a not in set(after.values())]
    chains = []
    while after:
        at = starts.pop() if starts else next(iter(after))
        chain = [at]
        while at in after:
            at = after.pop(at)
            chain.append(at)
        chains.append(chain)
    return chains


def _fit(points: Array, tolerance: float) -> list[Element]:
    """Segments and arcs through ``points`` (n, 2); a closed polyline ends with its first."""
    closed = bool(np.all(points[0] == points[-1]))
    if closed:
        points = _from_a_corner(points, tolerance)
    elements: list[Element] = []
    start = 0
    while start < len(points) - 1:
        a, stop = points[start], start + FEWEST_ON_ARC  # of the longest arc
        circle = longer = _circle(points[start:stop], tolerance) if stop <= len(points) else None
        while longer is not None and stop < len(points):
            longer = _circle(points[start : stop + 1], tolerance)
            circle, stop = (circle, stop) if longer is None else (longer, stop + 1)
        if circle is None:  # else of the longest line
            stop = start + 2
            while stop < len(points) and _off_line(points[start : stop + 1]) <= tolerance:
                stop += 1
        b = points[stop - 1]
        ends = (float(a[0]), float(a[1])), (float(b[0]), float(b[1]))
        if circle is None:
            elements.append(Element(*ends))
        else:
            arm, step = a - circle[:2], points[start + 1] - circle[:2]
            clockwise = bool(arm[0] * step[1] - arm[1] * step[0] < 0.0)
            centre = (float(circle[0]), float(circle[1]))
            elements.append(Element(*ends, centre, clockwise=clockwise))
        start = stop - 1
    return elements


def _from_a_corner(points: Array, tolerance: float) -> Array:
    """The closed polyline, started at a corner between elements if there is one."""
    ring = points[:-1]
    for i in range(len(ring)):
        turned = np.roll(ring, -i, axis=0)
        around = np.concatenate([turned[-(FEWEST_ON_ARC - 1) :], turned[:FEWEST_ON_ARC]])
        through = any(
            _circle(around[k : k + FEWEST_ON_ARC], tolerance) is not None
            for k in range(1, FEWEST_ON_ARC - 1)
        )
        middle = FEWEST_ON_ARC - 1
        if not through and _off_line(around[middle - 1 : middle + 2]) > tolerance:
            return np.concatenate([turned, turned[:1]])
    return points


def _off_line(points: Array) -> float:
    t = points[-1] - points[0]
    length = float(np.linalg.norm(t))
    if length == 0.0:
        return math.inf
    return (
        float(
            np.abs(
                (points[:, 0] - points[0, 0]) * t[1] - (points[:, 1] - points[0, 1]) * t[0]
            ).max()
        )
        / length
    )


def _circle(points: Array, tolerance: float) -> Array | None:
    """Centre and radius (3,) of the circle through the points, one way round; None if there is
    none: from the algebraic fit (Kasa), Gauss-Newton on the distances; a centre nearly on the axis
    is put on it.
    """
    edges = np.diff(points, axis=0)
    turns = np.arctan2(
        edges[:-1, 0] * edges[1:, 1] - edges[:-1, 1] * edges[1:, 0],
        np.einsum("ij,ij->i", edges[:-1], edges[1:]),
    )
    if (
        np.abs(turns).max() > SHARPEST_TURN
        or np.ptp(np.sign(turns)) != 0.0
        or abs(turns.sum()) > 2.0 * math.pi
    ):
        return None
    if _off_line(points) <= 2.0 * tolerance:
        return None
    origin = points.mean(axis=0)
    p = points - origin
    solved = np.linalg.lstsq(
        np.column_stack([2.0 * p, np.ones(len(p))]), (p * p).sum(axis=1), rcond=None
    )[0]
    circle = np.array(
        [solved[0], solved[1], math.sqrt(max(solved[2] + solved[0] ** 2 + solved[1] ** 2, 0.0))]
    )
    circle = _refined(p, circle, fixed=False)
    if abs(circle[0] + origin[0]) <= tolerance:
        circle[0] = -origin[0]
        circle = _refined(p, circle, fixed=True)
    if np.abs(np.linalg.norm(p - circle[:2], axis=1) - circle[2]).max() > tolerance:
        return None
    return circle + np.array([origin[0], origin[1], 0.0])


def _refined(points: Array, circle: Array, fixed: bool) -> Array:
    for _ in range(3):
        away = points - circle[:2]
        length = np.linalg.norm(away, axis=1)
        slope = np.column_stack([away / length[:, None], np.ones(len(points))])
        if fixed:
            slope[:, 0] = 0.0
        circle = circle + np.linalg.lstsq(slope, length - circle[2], rcond=None)[0]
    return circle
