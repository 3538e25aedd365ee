"""Faults of a triangle mesh that is used for contact."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hiltestbed.frames import Array

MOST_TRIANGLES = 200_000  # takes three seconds to prepare
FEWEST_TRIANGLES = 4
FLAT = 1e-10  # of the longest edge squared: a smaller area counts as zero
SAME_PLACE = 1e-7  # of the mesh's size: vertices closer than that are merged


@dataclass(frozen=True)
class MeshFault:
    """One fault of a mesh.

    Attributes:
        kind: too_large | too_small | not_finite | flat | open | branched | crossed | inverted.
        count: of the triangles, edges or vertices concerned. message: the fault and its remedy.
            usable: whether distances are still valid.
    """

    kind: str
    count: int
    message: str
    usable: bool = False


def welded(vertices: Array, faces: NDArray[np.int_]) -> tuple[Array, NDArray[np.int_]]:
    """The mesh with coincident vertices merged, without triangles of zero area."""
    size = float(np.ptp(vertices, axis=0).max()) or 1.0
    _, first, number = np.unique(
        np.round(vertices / (SAME_PLACE * size)).astype(np.int64),
        axis=0,
        return_index=True,
        return_inverse=True,
    )
    vertices, faces = vertices[first], number.reshape(-1)[faces]
    return vertices, faces[~_flat(vertices, faces)]


def _flat(vertices: Array, faces: NDArray[np.int_]) -> NDArray[np.bool_]:
    corners = vertices[faces]
    edges = np.roll(corners, -1, axis=1) - corners
    area = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    return area <= FLAT * (edges * edges).sum(axis=2).max(axis=1)


def volume(vertices: Array, faces: NDArray[np.int_]) -> float:
    """Signed volume [m^3] of a closed mesh: positive if the normals point outwards."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("fi,fi->", a, np.cross(b, c))) / 6.0


def examine(vertices: Array, faces: NDArray[np.int_]) -> list[MeshFault]:
    """All faults of a mesh (nv, 3) [m], (nf, 3); empty for a valid closed one."""
    vertices, faces = np.asarray(vertices, dtype=float), np.asarray(faces, dtype=int)
    if len(faces) > MOST_TRIANGLES:
        what = (
            f"{len(faces)} triangles; at most {MOST_TRIANGLES} are taken: simplify the "
            f"mesh, or split it into geoms"
        )
        return [MeshFault("too_large", len(faces), what)]
    if len(faces) < FEWEST_TRIANGLES:
        what = f"{len(faces)} triangles bound no solid; the fewest are {FEWEST_TRIANGLES}"
        return [MeshFault("too_small", len(faces), what)]
    lost = int((~np.isfinite(vertices)).any(axis=1).sum())
    if lost:
        return [MeshFault("not_finite", lost, f"{lost} vertices are not finite numbers")]
    sound, kept = welded(vertices, faces)
    findings = []
    flat = len(faces) - len(kept)
    if flat:
        what = f"{flat} triangles without area; they are left out"
        findings.append(MeshFault("flat", flat, what, usable=True))
    if len(kept) < FEWEST_TRIANGLES:
        what = f"only {len(kept)} triangles have an area"
        return [*findings, MeshFault("too_small", len(kept), what)]
    findings += _edges(kept)
    if volume(sound - sound.mean(axis=0), kept) < 0.0:
        what = (
            "the normals of all faces point inwards: the enclosed volume is negative; "
            "flip the faces"
        )
        findings.append(MeshFault("inverted", len(kept), what))
    return findings


def _edges(faces: NDArray[np.int_]) -> list[MeshFault]:
    directed = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    _, number, count = np.unique(
        np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    forward = np.bincount(
        number.reshape(-1), weights=directed[:, 0] < directed[:, 1], minlength=len(count)
    )
    faulty = {
        "open": (
            count == 1,
            "edges belong to one triangle only: the mesh is not closed, so inside and outside are "
            "undefined; close it",
        ),
        "branched": (
            count > 2,
            "edges belong to more than two triangles: surfaces branch there; make the mesh one "
            "boundary of one solid",
        ),
        "crossed": (
            (count == 2) & (forward != 1.0),
            "edges lie between triangles of opposite orientation; flip the inverted faces",
        ),
    }
    found = [(kind, int(where.sum()), what) for kind, (where, what) in faulty.items()]
    return [MeshFault(kind, n, f"{n} {what}") for kind, n, what in found if n]
