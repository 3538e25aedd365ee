"""Distance from a closed triangle mesh: nearest triangle by a bounding-volume tree of oriented
boxes, sign by pseudo-normals.

The sign at an edge or a corner is that of the angle-weighted pseudo-normal: J. A. Baerentzen, H.
Aanaes, "Signed distance computation using the angle weighted pseudonormal", IEEE TVCG 11(3), 2005.
Nearest point of a triangle by regions: C. Ericson, "Real-Time Collision Detection", 2005, 5.1.5.
The returned normal is along the distance, from the nearest point to the query point.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.jit import njit
from hiltestbed.contact.surfaces.soundness import welded
from hiltestbed.frames import Array

LEAF = 2  # triangles per leaf: testing one takes as long as testing seven boxes
DEEPEST = 64  # depth of the stack that traverses the tree


class Tree(NamedTuple):
    """A mesh with its tree of boxes, in the order of its leaves.

    Attributes:
        corners: (nf, 3, 3) [m]. normals: (nf, 7, 3) of the face, its edges (01, 12, 20) and its
            corners.
        boxes: (nn, 15) centre, axes (rows of a rotation) and half sizes of the box around a node,
            along the principal axes of its triangles: axis-aligned boxes would fit the long thin
            triangles of a mesh of revolution
                badly.
        links: (nn, 2) both children; for a leaf -1 minus the index of its first triangle, and their
            number.
    """

    corners: Array
    normals: Array
    boxes: Array
    links: NDArray[np.int64]


# of a surface that is not a mesh
NO_TREE = Tree(
    np.empty((0, 3, 3)), np.empty((0, 7, 3)), np.empty((0, 15)), np.empty((0, 2), dtype=np.int64)
)


def plant(vertices: Array, faces: NDArray[np.int_]) -> Tree:
    """The tree of a mesh (nv, 3) [m], (nf, 3), without triangles of zero area."""
    vertices, faces = welded(np.asarray(vertices, dtype=float), np.asarray(faces, dtype=int))
    corners = vertices[faces]
    normals = _pseudo_normals(corners, faces, len(vertices))
    order, boxes, links = _split(corners)
    return Tree(
        np.ascontiguousarray(corners[order]), np.ascontiguousarray(normals[order]), boxes, links
    )


def _pseudo_normals(corners: Array, faces: NDArray[np.int_], count: int) -> Array:
    edges = np.roll(corners, -1, axis=1) - corners
    face = np.cross(edges[:, 0], edges[:, 1])
    face /= np.linalg.norm(face, axis=1, keepdims=True)
    unit = edges / np.linalg.norm(edges, axis=2, keepdims=True)
    angle = np.arccos(np.clip(-np.einsum("fki,fki->fk", unit, np.roll(unit, 1, axis=1)), -1.0, 1.0))
    at_corner = np.zeros((count, 3))
    for k in range(3):
        np.add.at(at_corner, faces[:, k], angle[:, k, None] * face)
    pairs = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2), axis=2).reshape(-1, 2)
    number = np.unique(pairs, axis=0, return_inverse=True)[1].reshape(-1)
    at_edge = np.zeros((number.max() + 1, 3))
    np.add.at(at_edge, number, np.repeat(face, 3, axis=0))
    return np.concatenate(
        [face[:, None], at_edge[number].reshape(-1, 3, 3), at_corner[faces]], axis=1
    )


@njit(cache=True)
def _split(corners):
    """Order, boxes and links of a tree that splits at the median of the largest spread."""
    count = len(corners)
    order = np.arange(count)
    boxes, links = np.empty((2 * count, 15)), np.empty((2 * count, 2), dtype=np.int64)
    # first and last triangle, parent and which of its children
    todo = np.empty((DEEPEST, 4), dtype=np.int64)
    todo[0] = (0, count, -1, 0)
    top, nodes = 1, 0
    while top > 0:
        top -= 1
        start, end, parent, child = todo[top]
        if parent >= 0:
            links[parent, child] = nodes
        here = order[start:end].copy()
        # the box is along the principal axes of the triangles
        box, mean, moments = boxes[nodes], np.zeros(3), np.zeros((3, 3))
        for k in here:
            for c in range(3):
                mean += corners[k, c]
        mean /= 3 * len(here)
        for k in here:
            for c in range(3):
                for i in range(3):
                    for j in range(3):
                        moments[i, j] += (corners[k, c, i] - mean[i]) * (corners[k, c, j] - mean[j])
        axes = np.linalg.eigh(moments)[1]
        for j in range(3):
            box[j] = 0.0
        for i in range(3):
            low, high = math.inf, -math.inf
            for k in here:
                for c in range(3):
                    along = (
                        corners[k, c, 0] * axes[0, i]
                        + corners[k, c, 1] * axes[1, i]
                        + corners[k, c, 2] * axes[2, i]
                    )
                    low, high = min(low, along), max(high, along)
            for j in range(3):
                box[3 + 3 * i + j] = axes[j, i]
                box[j] += 0.5 * (low + high) * axes[j, i]
            box[12 + i] = 0.5 * (high - low)
        links[nodes] = (-1 - start, end - start)
        nodes += 1
        if end - start <= LEAF:
            continue
        # positions of the triangles' centres along the axes of the box
        spread = np.zeros((3, len(here)))
        for k in range(len(here)):
            for i in range(3):
                for c in range(3):
                    for j in range(3):
                        spread[i, k] += corners[here[k], c, j] * box[3 + 3 * i + j]
        widest = 0
        for i in range(1, 3):
            if np.ptp(spread[i]) > np.ptp(spread[widest]):
                widest = i
        half = (end - start) // 2
        order[start:end] = here[np.argsort(spread[widest])]
        todo[top] = (start, start + half, nodes - 1, 0)
        todo[top + 1] = (start + half, end, nodes - 1, 1)
        top += 2
    return order, boxes[:nodes].copy(), links[:nodes].copy()


@njit(cache=True)
def mesh_distance(tree, point, reach, normal):
    """Distance [m] of ``point`` (3,) from the mesh, negative inside; ``normal`` (3,) becomes the
    outward normal.

    If the mesh is farther than ``reach`` on either side, a lower bound of the distance, at least
    ``reach``, is returned, without a normal: on the axis of a cone all triangles of a band are
    equally near, and visiting them all would be slow.
    """
    best2, face, feature = reach * reach, -1, 0
    passed2 = math.inf
    fx, fy, fz = 0.0, 0.0, 0.0
    stack = np.empty(DEEPEST, dtype=np.int64)
    away2 = np.empty(DEEPEST)
    stack[0], away2[0], top = 0, 0.0, 1
    while top > 0:
        top -= 1
        node = stack[top]
        if away2[top] >= best2:
            passed2 = min(passed2, away2[top])
            continue
        first, second = tree.links[node, 0], tree.links[node, 1]
        if first < 0:
            for f in range(-1 - first, -1 - first + second):
                which, x, y, z = _on_triangle(tree.corners[f], point)
                d2 = (point[0] - x) ** 2 + (point[1] - y) ** 2 + (point[2] - z) ** 2
                if d2 < best2:
                    best2, face, feature, fx, fy, fz = d2, f, which, x, y, z
            continue
        a, b = _from_box(tree.boxes[first], point), _from_box(tree.boxes[second], point)
        if a < b:
            first, second, a, b = second, first, b, a
        stack[top], away2[top] = first, a
        stack[top + 1], away2[top + 1] = second, b
        top += 2
    if face < 0:
        normal[0] = normal[1] = normal[2] = 0.0
        return max(reach, math.sqrt(passed2))
    n = tree.normals[face, feature]
    dx, dy, dz = point[0] - fx, point[1] - fy, point[2] - fz
    flat = tree.normals[face, 0]
    if feature == 0:  # exact through zero
        distance = dx * flat[0] + dy * flat[1] + dz * flat[2]
        normal[0], normal[1], normal[2] = flat[0], flat[1], flat[2]
        return distance
    distance = math.sqrt(best2)
    sign = 1.0 if dx * n[0] + dy * n[1] + dz * n[2] >= 0.0 else -1.0
    if distance > 1e-12:
        normal[0] = sign * dx / distance
        normal[1] = sign * dy / distance
        normal[2] = sign * dz / distance
    else:
        length = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
        normal[0], normal[1], normal[2] = n[0] / length, n[1] / length, n[2] / length
    return sign * distance


@njit(cache=True)
def _from_box(box, p):
    x, y, z = p[0] - box[0], p[1] - box[1], p[2] - box[2]
    d2 = 0.0
    for i in range(3):
        past = abs(x * box[3 + 3 * i] + y * box[4 + 3 * i] + z * box[5 + 3 * i]) - box[12 + i]
        if past > 0.0:
            d2 += past * past
    return d2


@njit(cache=True)
def mesh_beyond(tree, start, end, reach):
    """A lower bound of the distance [m] of a segment from ``start`` (3,) to ``end`` (3,); -inf if
    it may be nearer than ``reach``.

    It is computed from the boxes, not from the triangles, and does not distinguish the inside from
    the outside of the mesh.
    """
    bound = math.inf
    half = 0.5 * math.sqrt(
        (end[0] - start[0]) ** 2 + (end[1] - start[1]) ** 2 + (end[2] - start[2]) ** 2
    )
    stack = np.empty(DEEPEST, dtype=np.int64)
    stack[0], top = 0, 1
    while top > 0:
        top -= 1
        node = stack[top]
        # between the projections on the axes of the box, and between the bounding spheres
        box, gaps2, away2, size2 = tree.boxes[node], 0.0, 0.0, 0.0
        for i in range(3):
            a = b = 0.0
            for j in range(3):
                a += (start[j] - box[j]) * box[3 + 3 * i + j]
                b += (end[j] - box[j]) * box[3 + 3 * i + j]
            gaps2 += max(0.0, min(a, b) - box[12 + i], -max(a, b) - box[12 + i]) ** 2
            away2 += (0.5 * (a + b)) ** 2
            size2 += box[12 + i] ** 2
        least = max(math.sqrt(gaps2), math.sqrt(away2) - math.sqrt(size2) - half)
        if least >= reach:
            bound = min(bound, least)
            continue
        if tree.links[node, 0] < 0:
            return -math.inf
        stack[top], stack[top + 1] = tree.links[node, 0], tree.links[node, 1]
        top += 2
    return bound


@njit(cache=True)
def _on_triangle(t, p):
    """Nearest feature (0 face; 1 to 3 edges 01, 12, 20; 4 to 6 corners) and point."""
    abx, aby, abz = t[1, 0] - t[0, 0], t[1, 1] - t[0, 1], t[1, 2] - t[0, 2]
    acx, acy, acz = t[2, 0] - t[0, 0], t[2, 1] - t[0, 1], t[2, 2] - t[0, 2]
    x, y, z = p[0] - t[0, 0], p[1] - t[0, 1], p[2] - t[0, 2]
    d1, d2 = abx * x + aby * y + abz * z, acx * x + acy * y + acz * z
    if d1 <= 0.0 and d2 <= 0.0:
        return 4, t[0, 0], t[0, 1], t[0, 2]
    x, y, z = p[0] - t[1, 0], p[1] - t[1, 1], p[2] - t[1, 2]
    d3, d4 = abx * x + aby * y + abz * z, acx * x + acy * y + acz * z
    if d3 >= 0.0 and d4 <= d3:
        return 5, t[1, 0], t[1, 1], t[1, 2]
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        s = d1 / (d1 - d3)
        return 1, t[0, 0] + s * abx, t[0, 1] + s * aby, t[0, 2] + s * abz
    x, y, z = p[0] - t[2, 0], p[1] - t[2, 1], p[2] - t[2, 2]
    d5, d6 = abx * x + aby * y + abz * z, acx * x + acy * y + acz * z
    if d6 >= 0.0 and d5 <= d6:
        return 6, t[2, 0], t[2, 1], t[2, 2]
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        s = d2 / (d2 - d6)
        return 3, t[0, 0] + s * acx, t[0, 1] + s * acy, t[0, 2] + s * acz
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        s = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return (
            2,
            t[1, 0] + s * (t[2, 0] - t[1, 0]),
            t[1, 1] + s * (t[2, 1] - t[1, 1]),
            t[1, 2] + s * (t[2, 2] - t[1, 2]),
        )
    scale = 1.0 / (va + vb + vc)
    s, u = vb * scale, vc * scale
    return 0, t[0, 0] + s * abx + u * acx, t[0, 1] + s * aby + u * acy, t[0, 2] + s * abz + u * acz
