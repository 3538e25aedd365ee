"""A recording file, and what is drawn in it: shapes, poses, and the contact force as an arrow."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from hiltestbed.frames import Array
from hiltestbed.viewer import colors
from hiltestbed.viewer.solids import Solid

ARROW_LENGTH = 0.6  # [m] of the largest force, at most
ARROW_RADIUS = 0.02  # [m]
GLASS = 0.3  # opacity of a body: the force on it is drawn inside it
LABEL_GAP = 0.03  # [m] from the tip of an arrow to its label
LABEL_FROM = 0.02  # of the largest force; smaller arrows have no label


@contextmanager
def recording_file(
    path: Path, identity: str, blueprint: rrb.Blueprint
) -> Iterator[rr.RecordingStream]:
    """A recording that is written to ``path``, with its layout, at the end of the block.

    It is collected in memory: rerun's own writer of files is a thread that is waited for, for ever
    where the disk became full.

    Raises:
        OSError: the file could not be written.
    """
    with rr.RecordingStream("hiltestbed", recording_id=identity, send_properties=False) as stream:
        memory = stream.memory_recording()
        stream.send_blueprint(blueprint, make_active=False, make_default=True)
        yield stream
        content = memory.drain_as_bytes()
    try:
        path.write_bytes(content)
    except OSError as error:
        raise OSError(
            error.errno,
            f"the recording could not be written ({error.strerror}); is the disk full?",
            str(path),
        ) from None


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


def force_scale(peak: float, length: float = ARROW_LENGTH) -> float:
    """[m/N] such that ``peak`` [N] is within ``length`` [m] and a metre is a round number of N."""
    if not peak > 0.0:
        return 1e-3
    least = peak / length
    decade = 10.0 ** np.floor(np.log10(least))
    round_numbers = decade * np.array([1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0])
    return 1.0 / float(round_numbers[round_numbers >= least * (1.0 - 1e-9)][0])


def force_origin(wrench: Array, pose: Array) -> Array:
    """``(frames, 3)`` point of action of ``wrench`` (frames, 6): the point of its line of action
    nearest to A, or A if that is further away than the longest arrow.

    The line of action of a force f with the torque t about the origin passes through f x t/f^2; a
    pure couple shifts it off the contact.
    """
    force, torque, a = wrench[:, :3], wrench[:, 3:], pose[:, :3]
    square = np.maximum(np.einsum("ij,ij->i", force, force), 1e-12)[:, None]
    line = np.cross(force, torque) / square
    point = line + force * np.einsum("ij,ij->i", a - line, force)[:, None] / square
    near = np.linalg.norm(point - a, axis=1) < ARROW_LENGTH
    return np.where(near[:, None], point, a)


def send_force(
    rec: rr.RecordingStream,
    path: str,
    time: rr.TimeColumn,
    wrench: Array,
    pose: Array,
    contact: NDArray[np.bool_],
    scale: float,
) -> None:
    """The force on the passive side as an arrow at its point of action, ``scale`` [m/N], with its
    magnitude at the tip. No arrow out of contact, where the sensor may still feel the payload that
    it carries.

    Args:
        wrench: ``(frames, 6)``. pose: ``(frames, 7)`` of A in P. contact: ``(frames,)`` bool.
    """
    force = np.linalg.norm(wrench[:, :3], axis=1)
    acts = contact & (force > 0.0)
    vectors, origins = scale * wrench[acts, :3], force_origin(wrench, pose)[acts]
    rec.log(
        path, rr.Arrows3D.from_fields(colors=[colors.PHYSICAL], radii=[ARROW_RADIUS]), static=True
    )
    rec.send_columns(
        path,
        indexes=[time],
        columns=rr.Arrows3D.columns(vectors=vectors, origins=origins).partition(acts.astype(int)),
    )
    labelled = acts & (force > LABEL_FROM * force.max(initial=0.0))
    beyond = 1.0 + LABEL_GAP / (scale * force[labelled, None])
    tips = origins[labelled[acts]] + beyond * scale * wrench[labelled, :3]
    points = rr.Points3D.columns(positions=tips, labels=[f"{f:.0f} N" for f in force[labelled]])
    rec.log(
        f"{path}/size",
        rr.Points3D.from_fields(colors=[colors.PHYSICAL], radii=[0.001], show_labels=True),
        static=True,
    )
    rec.send_columns(f"{path}/size", indexes=[time], columns=points.partition(labelled.astype(int)))
