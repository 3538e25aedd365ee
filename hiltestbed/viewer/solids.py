"""Triangle meshes of MuJoCo's geoms; edges of boxes and cylinders are bevelled, to be seen."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from hiltestbed.frames import Array

SEGMENTS = 48  # around an axis of revolution
BEVEL = 0.008  # [m] bevel of an edge, at most a quarter of the smallest half size
PLANE = 4.0  # [m] half side with which an infinite plane is drawn


@dataclass(frozen=True)
class Solid:
    """A surface: ``vertices``, unit ``normals`` (v, 3), ``triangles`` (t, 3), ``colors`` (v, 4)."""

    vertices: Array
    normals: Array
    triangles: NDArray[np.uint32]
    colors: NDArray[np.uint8]

    def moved(self, position: Array, rotation: Array) -> Solid:
        """The same solid at ``position`` (3,), rotated by ``rotation`` (3, 3)."""
        return Solid(
            self.vertices @ rotation.T + position,
            self.normals @ rotation.T,
            self.triangles,
            self.colors,
        )

    @staticmethod
    def joined(solids: list[Solid]) -> Solid:
        """Several meshes merged into one."""
        first = np.cumsum([0] + [len(s.vertices) for s in solids[:-1]]).astype(np.uint32)
        return Solid(
            np.concatenate([s.vertices for s in solids]),
            np.concatenate([s.normals for s in solids]),
            np.concatenate([s.triangles + n for s, n in zip(solids, first, strict=True)]),
            np.concatenate([s.colors for s in solids]),
        )


def solid(vertices: Array, normals: Array, triangles: NDArray[np.integer], rgba: Array) -> Solid:
    """A mesh in one colour ``rgba`` (4,) 0..1."""
    colors = np.tile(np.round(255.0 * np.asarray(rgba)).astype(np.uint8), (len(vertices), 1))
    return Solid(
        np.asarray(vertices, float), np.asarray(normals, float), triangles.astype(np.uint32), colors
    )


def box(half: Array, rgba: Array) -> Solid:
    """A box with half sizes ``half`` (3,) [m]; the normals are interpolated over its bevels."""
    half = np.asarray(half, dtype=float)
    bevel = min(BEVEL, 0.25 * half.min())
    signs = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    vertices, normals = [], []
    for axis in range(3):
        inset = np.full(3, bevel)
        inset[axis] = 0.0
        vertices.append(signs * (half - inset))
        normals.append(signs * np.eye(3)[axis])
    corners = np.concatenate(vertices)
    triangles = ConvexHull(corners).simplices.copy()
    a, b, c = (corners[triangles[:, i]] for i in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) < 0.0
    triangles[inward] = triangles[inward][:, ::-1]
    return solid(corners, np.concatenate(normals), triangles, rgba)


def revolved(profile: Array, rgba: Array) -> Solid:
    """A surface of revolution about z from ``profile`` (p, 4): r, z [m] and normal, upwards."""
    angle = np.linspace(0.0, 2.0 * np.pi, SEGMENTS + 1)
    c, s = np.cos(angle), np.sin(angle)
    rings = len(profile)
    r, z, nr, nz = (np.broadcast_to(column[:, None], (rings, SEGMENTS + 1)) for column in profile.T)
    vertices = np.stack([r * c, r * s, z], axis=-1).reshape(-1, 3)
    normals = np.stack([nr * c, nr * s, nz], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(rings - 1), np.arange(SEGMENTS), indexing="ij")
    low = (i * (SEGMENTS + 1) + j).ravel()
    high = low + SEGMENTS + 1
    triangles = np.concatenate(
        [np.stack([low, low + 1, high + 1], -1), np.stack([low, high + 1, high], -1)]
    )
    return solid(vertices, normals, triangles, rgba)


def cylinder(radius: float, half: float, rgba: Array) -> Solid:
    """About z, of half length ``half`` [m]."""
    b = min(BEVEL, 0.25 * min(radius, half))
    lower = [[0.0, -half, 0.0, -1.0], [radius - b, -half, 0.0, -1.0], [radius, b - half, 1.0, 0.0]]
    return revolved(np.array(lower + [[r, -z, nr, -nz] for r, z, nr, nz in reversed(lower)]), rgba)


def capsule(radius: float, half: float, rgba: Array) -> Solid:
    """About z, ``half`` [m]: half the distance of its ends' centres; 0: a sphere."""
    a = np.linspace(-0.5 * np.pi, 0.0, SEGMENTS // 4 + 1)
    lower = np.stack([radius * np.cos(a), radius * np.sin(a) - half, np.cos(a), np.sin(a)], axis=-1)
    return revolved(np.concatenate([lower, (lower * [1.0, -1.0, 1.0, -1.0])[::-1]]), rgba)


def ellipsoid(half: Array, rgba: Array) -> Solid:
    """Of half axes ``half`` (3,) [m]."""
    ball = capsule(1.0, 0.0, rgba)
    normals = ball.normals / half
    return Solid(
        ball.vertices * half,
        normals / np.linalg.norm(normals, axis=1, keepdims=True),
        ball.triangles,
        ball.colors,
    )


def arrow(vector: Array, radius: float, rgba: Array) -> Solid:
    """A shaft and a head along ``vector`` (3,) [m] from the origin."""
    length = float(np.linalg.norm(vector))
    head = min(0.4 * length, 5.0 * radius)
    neck = length - head
    slope = np.hypot(head, 2.5 * radius)
    side = (head / slope, 2.5 * radius / slope)
    profile = [
        [0.0, 0.0, 0.0, -1.0],
        [radius, 0.0, 0.0, -1.0],
        [radius, 0.0, 1.0, 0.0],
        [radius, neck, 1.0, 0.0],
        [radius, neck, 0.0, -1.0],
        [2.5 * radius, neck, 0.0, -1.0],
        [2.5 * radius, neck, *side],
        [0.0, length, *side],
    ]
    return revolved(np.array(profile), rgba).moved(np.zeros(3), along(vector))


def along(vector: Array) -> Array:
    """A rotation (3, 3) that turns z along ``vector`` (3,)."""
    z = np.asarray(vector) / np.linalg.norm(vector)
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [0.0, 0.0, 1.0], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def geom_solid(m: mujoco.MjModel, geom: int) -> Solid:
    """The geom in its own frame, in the colour of its material."""
    size, kind, rgba = m.geom_size[geom], mujoco.mjtGeom(m.geom_type[geom]), geom_rgba(m, geom)
    match kind:
        case mujoco.mjtGeom.mjGEOM_BOX:
            return box(size, rgba)
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            return cylinder(size[0], size[1], rgba)
        case mujoco.mjtGeom.mjGEOM_CAPSULE:
            return capsule(size[0], size[1], rgba)
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            return capsule(size[0], 0.0, rgba)
        case mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            return ellipsoid(size, rgba)
        case mujoco.mjtGeom.mjGEOM_PLANE:
            half = np.where(size[:2] > 0.0, size[:2], PLANE)
            return box(np.array([*half, 1e-3]), rgba)
        case mujoco.mjtGeom.mjGEOM_MESH:
            return _mesh(m, int(m.geom_dataid[geom]), rgba)
    raise ValueError(f"geom {m.geom(geom).name or geom}: a {kind.name} cannot be drawn")


def geom_rgba(m: mujoco.MjModel, geom: int) -> Array:
    """``(4,)`` 0..1: of the material, unless the geom has a colour of its own."""
    material = m.geom_matid[geom]
    own = not np.allclose(m.geom_rgba[geom], [0.5, 0.5, 0.5, 1.0])
    return np.asarray(
        m.geom_rgba[geom] if own or material < 0 else m.mat_rgba[material], dtype=float
    )


def _mesh(m: mujoco.MjModel, mesh: int, rgba: Array) -> Solid:
    """A mesh with a vertex per corner of a face: normals of adjacent faces may differ."""
    faces = slice(m.mesh_faceadr[mesh], m.mesh_faceadr[mesh] + m.mesh_facenum[mesh])
    vertices = m.mesh_vert[m.mesh_vertadr[mesh] + m.mesh_face[faces].ravel()]
    normals = m.mesh_normal[m.mesh_normaladr[mesh] + m.mesh_facenormal[faces].ravel()]
    return solid(vertices, normals, np.arange(len(vertices)).reshape(-1, 3), rgba)
