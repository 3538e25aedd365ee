"""Revolves a profile about the z axis into a triangle mesh whose rings lie exactly on the profile's
curve.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from hiltestbed.contact.surfaces.profile import Element
from hiltestbed.frames import Array


def polyline(loop: list[Element], arc_step: float) -> Array:
    """``(n, 2)`` points on a chain, ends included, arcs in steps of ``arc_step`` [rad] or less."""
    points = [loop[0].a]
    for e in loop:
        if e.centre is not None:
            (rho, z), (start, sweep) = e.centre, e.sweep()
            radius = math.hypot(e.a[0] - rho, e.a[1] - z)
            steps = max(math.ceil(abs(sweep) / arc_step - 1e-9), 3)
            angles = start + sweep * np.arange(1, steps) / steps
            points += [(rho + radius * math.cos(a), z + radius * math.sin(a)) for a in angles]
        points.append(e.b)
    return np.array(points)


def turn(points: Array, segments: int) -> tuple[Array, NDArray[np.int_]]:
    """Vertices (nv, 3) [m] and faces (nf, 3) of the polyline ``points`` (n, 2) of (rho, z),
    revolved about z.

    The normals are on the left of the polyline's direction. A polyline that ends at its start
    becomes a closed ring.
    """
    azimuth = 2.0 * math.pi * np.arange(segments) / segments
    circle = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    closed = bool(np.all(points[0] == points[-1]))
    vertices: list[Array] = []
    rings: list[NDArray[np.int_]] = []
    count = 0
    for rho, z in points[:-1] if closed else points:
        ring = (
            np.column_stack([rho * circle, np.full(segments, z)])
            if rho > 0.0
            else np.array([[0.0, 0.0, z]])
        )
        vertices.append(ring)
        rings.append(count + (np.arange(segments) if rho > 0.0 else np.zeros(segments, dtype=int)))
        count += len(ring)
    if closed:
        rings.append(rings[0])
    faces = [f for low, high in itertools.pairwise(rings) for f in _band(low, high)]
    return np.concatenate(vertices), np.array(faces)


def _band(low: NDArray[np.int_], high: NDArray[np.int_]) -> list[tuple[int, int, int]]:
    """Triangles between two rings of vertices; a ring on the axis is one vertex, repeated."""
    faces = []
    for k in range(len(low)):
        n = (k + 1) % len(low)
        for face in ((low[k], high[k], high[n]), (low[k], high[n], low[n])):
            if len({int(i) for i in face}) == 3:
                faces.append((int(face[0]), int(face[1]), int(face[2])))
    return faces


def obj_text(vertices: Array, faces: NDArray[np.int_], comment: str) -> str:
    """The mesh as Wavefront OBJ text, to 1e-9 m."""
    lines = [f"# {comment}"]
    lines += [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in vertices + 0.0]
    lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
    return "\n".join(lines) + "\n"


def shell(socket: float, half_angle: float, generator: float, thickness: float) -> list[Element]:
    """Profile of a funnel that opens towards -z: back, outside, rounded rim, straight inside,
    socket; outward side on the left.

    The ``socket`` is spherical with this radius [m], its bottom at the origin; the straight
    ``generator``, of this length [m] and at the ``half_angle`` [rad], is tangent to it. The shell
    is ``thickness`` [m] thick, also along the axis.
    """
    sin, cos = math.sin(half_angle), math.cos(half_angle)

    def across(distance: float, along: float) -> tuple[float, float]:
        """A point ``along`` [m] the generator, at ``distance`` [m] from the socket's centre."""
        return distance * cos + along * sin, distance * sin - socket - along * cos

    outer = socket + thickness
    back = ((outer - sin * outer) / cos, thickness)
    rim = across(socket + 0.5 * thickness, generator)
    lip, mouth, throat = across(outer, generator), across(socket, generator), across(socket, 0.0)
    return [
        Element((0.0, thickness), back),
        Element(back, lip),
        Element(lip, mouth, rim, clockwise=True),
        Element(mouth, throat),
        Element(throat, (0.0, 0.0), (0.0, -socket)),
    ]
