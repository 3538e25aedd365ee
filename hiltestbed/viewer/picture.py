"""A run as one picture, drawn by Matplotlib without a display: the rig and the ports at three
instants, and the signals.

Triangles are drawn from back to front in an orthographic view, lit from the viewer: what pierces
another triangle may be drawn on the wrong side of it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hiltestbed.contact.composition import ACTIVE, PASSIVE
from hiltestbed.errors import HiltestbedError, InputError
from hiltestbed.frames import Array, rotation_matrix
from hiltestbed.report.curves import PALETTE, POINTS, shade_contacts
from hiltestbed.run_folder.result import Run
from hiltestbed.run_folder.store import SUMMARY, read_run
from hiltestbed.signals import JOINT, RunTrace
from hiltestbed.viewer.rig import RigScene

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AZIMUTH, ELEVATION = np.radians(60.0), np.radians(20.0)  # of the eye, about W's z axis
AMBIENT = 0.45  # brightness of a surface that is seen edge-on
MARGIN = 0.1  # around what is shown, of its size
GLASS = 0.45  # opacity of the passive mechanism: the active one is seen inside it


def write_picture(folder: str | Path, png: str | Path) -> Path:
    """Write the picture of a run folder to ``png``; returns its path.

    Raises:
        InputError: it is no run folder, or the file cannot be written. HiltestbedError: the run has
            no trace.
    """
    folder, png = Path(folder), Path(png)
    if folder.is_file() and (folder.parent / SUMMARY).is_file():
        folder = folder.parent  # its recording was given
    run = read_run(folder)
    if run.trace is None or not len(run.trace.t):
        raise HiltestbedError(f"{folder}: has no trace to draw; run the scenario again")
    if png.suffix.lower() != ".png":
        raise InputError(f"--png: is no PNG file (got {png}); write for example --png run.png")
    try:
        _figure(run, run.trace).savefig(png, dpi=110)
    except OSError as error:
        raise InputError(f"{png}: cannot be written ({error.strerror}); choose another") from None
    return png


def _figure(run: Run, trace: RunTrace):
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 8.0), layout="constrained")
    moving = JOINT.name in trace
    grid = figure.add_gridspec(2 + 2 + moving, 4)
    rows = _instants(trace)
    scene = RigScene(run.scenario)
    frames = _frames(scene, trace, rows)
    axes = figure.add_subplot(grid[:2, 0])
    _draw(axes, *frames[-1], everything=True)
    axes.set_title("rig", fontsize=10)
    span = _span([corners for corners, _, ports in frames for corners in [corners[ports]]])
    for column, (row, frame) in enumerate(zip(rows, frames, strict=True)):
        axes = figure.add_subplot(grid[:2, 1 + column])
        _draw(axes, *frame, everything=False, span=span)
        axes.set_title(f"t = {trace.t[row]:.3f} s", fontsize=10)
    panels = [
        ("force z [N]", ("wrench_true.fz", "wrench_meas.fz", "wrench_comp.fz"), 1.0),
        ("pz [mm]", ("pose_cmd.pz", "pose_act.pz"), 1e3),
    ]
    if moving:
        unit = trace.about()[f"{JOINT.name}.{trace.moving[0][0]}"]["unit"]
        names = [n for n, u in trace.moving if u == unit]
        scale, shown = (1e3, "mm") if unit == "m" else (1.0, unit)
        panels.append((f"joints [{shown}]", tuple(f"{JOINT.name}.{n}" for n in names), scale))
    thin = slice(None, None, max(1, len(trace.t) // POINTS))
    for i, (label, columns, scale) in enumerate(panels):
        axes = figure.add_subplot(grid[2 + i, :])
        shade_contacts(axes, trace.t, trace.contact)
        for j, column in enumerate(columns):
            axes.plot(
                trace.t[thin],
                scale * trace[column][thin],
                color=PALETTE[j % len(PALETTE)],
                linestyle=("-", "--", ":")[j % 3],
                label=column,
            )
        axes.set(ylabel=label, xlim=(trace.t[0], trace.t[-1]))
        axes.legend(loc="upper right", fontsize=8)
    axes.set_xlabel("time [s]; shaded: the mechanisms touch")
    figure.suptitle(f"{run.summary['name']}: {run.summary['status']}, {run.summary['outcome']}")
    return figure


def _instants(trace: RunTrace) -> NDArray[np.intp]:
    """Rows of the start, of the largest force, and of the end."""
    force = np.abs(np.nan_to_num(trace["wrench_meas.fz"]))
    peak = int(np.argmax(force)) if force.any() else len(trace.t) // 2
    return np.array([0, peak, len(trace.t) - 1])


def _frames(
    scene: RigScene, trace: RunTrace, rows: NDArray[np.intp]
) -> list[tuple[Array, Array, NDArray[np.bool_]]]:
    """Of each row: triangles (t, 3, 3) in W, colours (t, 4), which belong to the mechanisms."""
    pose = trace["pose_act"][rows]
    pose_P = scene.port_poses(rows, trace["pose_cmd"], pose)
    poses = scene.body_poses(pose, pose_P, scene.strokes(trace, rows))
    solids = scene.solids()
    out = []
    for f in range(len(rows)):
        corners, colors, ports = [], [], []
        for body, solid in solids:
            root, name = int(scene.model.body_weldid[body]), scene.model.body(body).name
            placed = solid
            if root in scene.moving:
                at = poses[scene.moving.index(root), f]
                placed = solid.moved(at[:3], rotation_matrix(at[3:]))
            rgba = placed.colors[placed.triangles[:, 0]] / 255.0
            if name.startswith(PASSIVE):
                rgba = rgba * [1.0, 1.0, 1.0, GLASS]
            corners.append(placed.vertices[placed.triangles])
            colors.append(rgba)
            ports.append(np.full(len(rgba), name.startswith((ACTIVE, PASSIVE))))
        out.append((np.concatenate(corners), np.concatenate(colors), np.concatenate(ports)))
    return out


def _view() -> Array:
    """(3, 3) rows: right (W's z axis, the insertion), up, and towards the eye, in W."""
    right = np.array([0.0, 0.0, 1.0])
    eye = np.array([np.cos(AZIMUTH), np.sin(AZIMUTH), 0.0])
    up = np.cross(eye, right)
    eye = np.cos(ELEVATION) * eye + np.sin(ELEVATION) * up - 0.25 * right
    eye /= np.linalg.norm(eye)
    right -= (right @ eye) * eye
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(eye, right), eye])


def _span(parts: list[Array]) -> tuple[Array, Array]:
    """Lower and upper corner in the picture of triangles (t, 3, 3)."""
    shown = np.concatenate(parts).reshape(-1, 3) @ _view()[:2].T
    low, high = shown.min(axis=0), shown.max(axis=0)
    edge = MARGIN * float((high - low).max())
    return low - edge, high + edge


def _draw(
    axes: Axes,
    corners: Array,
    colors: Array,
    ports: NDArray[np.bool_],
    everything: bool,
    span: tuple[Array, Array] | None = None,
) -> None:
    from matplotlib.collections import PolyCollection

    shown = np.ones(len(corners), dtype=bool) if everything else ports
    corners, colors = corners[shown], colors[shown].copy()
    view = _view()
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    facing = np.abs(normal @ view[2]) / np.where(length > 0.0, length, 1.0)
    colors[:, :3] *= (AMBIENT + (1.0 - AMBIENT) * facing)[:, None]
    order = np.argsort(corners.mean(axis=1) @ view[2])
    axes.add_collection(
        PolyCollection(
            list((corners @ view[:2].T)[order]), facecolors=colors[order], edgecolors="none"
        )
    )
    low, high = span if span is not None else _span([corners])
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xticks=[], yticks=[])
