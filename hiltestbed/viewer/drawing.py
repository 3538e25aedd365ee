"""Shapes and poses of entities in the form that rerun expects."""

from __future__ import annotations

import rerun as rr

from hiltestbed.frames import Array
from hiltestbed.viewer.solids import Solid


def send_poses(rec: rr.RecordingStream, path: str, time: rr.TimeColumn, poses: Array) -> None:
    """Poses ``(frames, 7)`` of an entity."""
    rec.send_columns(
        path,
        indexes=[time],
        columns=rr.Transform3D.columns(translation=poses[:, :3], quaternion=poses[:, 3:]),
    )


def log_solid(rec: rr.RecordingStream, path: str, shape: Solid, opacity: float = 1.0) -> None:
    """A shape in the frame of its entity."""
    mesh = rr.Mesh3D(
        vertex_positions=shape.vertices,
        vertex_normals=shape.normals,
        triangle_indices=shape.triangles,
        vertex_colors=shape.colors,
        albedo_factor=(1.0, 1.0, 1.0, opacity) if opacity < 1.0 else None,
    )
    rec.log(path, mesh, static=True)
