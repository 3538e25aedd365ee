"""The two spacecraft of the numerical model in 3-D.

Their poses are not in the trace. They are recomputed with one step per frame, under the mean of the
wrench that drove the numerical model during the frame. This preserves the impulse, so the
velocities after a contact are those of the run. The chaser is then placed by the relative pose of
the run, so that the relative pose of the two ports is exact.
"""

from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from hiltestbed.frames import Array, pose_between, pose_compose, rotation_matrix
from hiltestbed.numerical_model.bodies import inertia_matrix, port_pose
from hiltestbed.numerical_model.kernels import CHASER, TARGET
from hiltestbed.numerical_model.model import NumericalModel
from hiltestbed.scenario.spacecraft import Body, Spacecraft
from hiltestbed.viewer import colors
from hiltestbed.viewer.drawing import GLASS, log_solid, send_poses
from hiltestbed.viewer.solids import Solid, along, box, cylinder

ROOT = "spacecraft"
NAMES = {CHASER: "chaser", TARGET: "target"}
BODY = {CHASER: (0.80, 0.64, 0.28, 1.0), TARGET: (0.72, 0.75, 0.80, 1.0)}
PORT = {CHASER: (0.86, 0.20, 0.16, 1.0), TARGET: (0.10, 0.48, 0.62, 1.0)}
IDENTITY = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])  # a pose
PANEL = (0.12, 0.20, 0.46, 1.0)


def body_poses(
    model: NumericalModel, rows: NDArray[np.intp], pose_cmd: Array, wrench: Array
) -> Array:
    """``(2, frames, 7)`` poses of chaser and target in the inertial frame, at the rows
    ``(frames,)`` of the run of a ``model`` at its start, which is advanced.

    ``pose_cmd`` (ticks, 7) and the ``wrench`` (ticks, 6) that drove the numerical model: row k is
    the state after the wrench of row k.
    """
    tick = model.tick
    total = np.concatenate([np.zeros((1, 6)), np.cumsum(wrench, axis=0)])
    out, done = np.empty((2, len(rows), 7)), 0
    for f, row in enumerate(rows):
        ticks = int(row) + 1 - done
        model.tick = ticks * tick
        model.advance(((total[row + 1] - total[done]) / ticks)[None])
        done += ticks
        out[TARGET, f] = model.centres()[0, TARGET]
    ports, chaser_A, at_P, at_A = model.port[0], np.empty(7), np.empty(7), np.empty(7)
    pose_between(ports[CHASER], IDENTITY, chaser_A)
    for f, row in enumerate(rows):
        pose_compose(out[TARGET, f], ports[TARGET], at_P)
        pose_compose(at_P, pose_cmd[row], at_A)
        pose_compose(at_A, chaser_A, out[CHASER, f])
    return out


def cuboid(body: Body) -> tuple[Array, Array]:
    """Half sizes ``(3,)`` [m] and axes ``(3, 3)`` of the cuboid of equal mass and inertia."""
    moments, axes = np.linalg.eigh(inertia_matrix(body.inertia))
    order = [int(np.argmax(np.abs(axes[i]))) for i in range(3)]
    if sorted(order) == [0, 1, 2]:  # each principal axis is assigned to the nearest body axis
        moments, axes = moments[order], axes[:, order]
    axes = axes * np.where(np.diag(axes) < 0.0, -1.0, 1.0)
    if np.linalg.det(axes) < 0.0:
        axes[:, 2] *= -1.0
    return np.sqrt(np.maximum(1.5 / body.mass * (moments.sum() - 2.0 * moments), 1e-4)), axes


def heights(craft: Spacecraft) -> tuple[float, float]:
    """[m] extent of the target upward from its port, and of the chaser downward from its port."""
    up, down = (
        float(np.linalg.norm(body.port.position) + cuboid(body)[0].max())
        for body in (craft.target, craft.chaser)
    )
    return up, down


def draw(rec: rr.RecordingStream, craft: Spacecraft) -> None:
    """Both bodies as cuboids of equal mass and inertia, with a port on a boom and two panels."""
    rec.log(ROOT, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for i, body in ((CHASER, craft.chaser), (TARGET, craft.target)):
        half, axes = cuboid(body)
        port, width = port_pose(body)[:3], 0.3 * float(half.min())
        glass = [
            box(half, np.array(BODY[i])).moved(np.zeros(3), axes),
            _tube(np.zeros(3), 0.85 * port, width, np.array(PORT[i])),
        ]
        log_solid(rec, f"{ROOT}/{NAMES[i]}/body", Solid.joined(glass), GLASS)
        solids = [_tube(0.85 * port, port, 1.2 * width, np.array(PORT[i]))]
        for side in (-1.0, 1.0):
            root, panel = side * (half[0] + 0.25), [1.1 * half[1] + 0.3, 0.012, 0.45 * half[2]]
            middle = axes @ [root + side * panel[0], 0.0, 0.0]
            solids.append(box(np.array(panel), np.array(PANEL)).moved(middle, axes))
            inner, outer = (axes @ [x, 0.0, 0.0] for x in (0.99 * side * half[0], root))
            solids.append(_tube(inner, outer, 0.03, np.array(BODY[TARGET])))
        log_solid(rec, f"{ROOT}/{NAMES[i]}/panels", Solid.joined(solids))


def _tube(start: Array, end: Array, radius: float, rgba: Array) -> Solid:
    """A tube from ``start`` to ``end``."""
    way = np.asarray(end) - start
    length = max(float(np.linalg.norm(way)), 1e-3)
    rotation = along(way if np.any(way) else np.array([0.0, 0.0, 1.0]))
    return cylinder(radius, 0.5 * length, rgba).moved(0.5 * (np.asarray(end) + start), rotation)


def move(
    rec: rr.RecordingStream,
    time: rr.TimeColumn,
    craft: Spacecraft,
    poses: Array,
    wrench: Array,
    scale: float,
) -> None:
    """Poses ``(2, frames, 7)`` at the frames, and the force that drove the numerical model, equal
    and opposite on both bodies.
    """
    for i, name in NAMES.items():
        send_poses(rec, f"{ROOT}/{name}", time, poses[i])
    attitude = rotation_matrix(poses[TARGET, :, 3:])
    port = port_pose(craft.target)
    origin = poses[TARGET, :, :3] + attitude @ port[:3]
    force = np.einsum("fij,fj->fi", attitude @ rotation_matrix(port[3:]), wrench[:, :3])
    acts = np.linalg.norm(force, axis=1) > 0.0
    vectors = scale * np.stack([force, -force], axis=1)[acts]
    origins = np.repeat(origin[acts, None], 2, axis=1)
    path = f"{ROOT}/force"
    style = rr.Arrows3D.from_fields(colors=[colors.USED], radii=[0.01 * sum(heights(craft))])
    rec.log(path, style, static=True)
    columns = rr.Arrows3D.columns(vectors=vectors.reshape(-1, 3), origins=origins.reshape(-1, 3))
    rec.send_columns(path, indexes=[time], columns=columns.partition(2 * acts.astype(int)))
