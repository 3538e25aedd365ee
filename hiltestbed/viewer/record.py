"""A run as a rerun recording: read this first. Scene, motion, signals and layout in one file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from hiltestbed.run_folder.result import Run
from hiltestbed.signals import RunTrace
from hiltestbed.viewer import spacecraft
from hiltestbed.viewer.blueprint import ShownRun, layout
from hiltestbed.viewer.file import recording_file
from hiltestbed.viewer.forces import force_scale, send_force
from hiltestbed.viewer.frames import frame_rows
from hiltestbed.viewer.plots import send_signals
from hiltestbed.viewer.rig import CONTACT_FORCE, RigScene
from hiltestbed.viewer.text import figures

FORCE_PART = 0.6  # of a spacecraft's height, at most: the largest force drawn on it


def write_recording(path: Path, run: Run) -> None:
    """Write ``run`` as a recording with its layout.

    Bodies and forces are drawn at selected frames (:mod:`hiltestbed.viewer.frames`); signals are
    included for every tick.

    Raises:
        ValueError: the run has no trace.
        OSError: the file could not be written.
    """
    if run.trace is None:
        raise ValueError("a run without its trace cannot be recorded")
    trace = run.trace
    rows = frame_rows(trace, run.scenario.rate)
    facts = ShownRun(run, trace, force_scale(_peak(trace)))
    with recording_file(path, _identity(run), layout(facts)) as rec:
        rec.send_recording_name(run.scenario.name)
        rec.log(
            "figures", rr.TextDocument(figures(run), media_type=rr.MediaType.MARKDOWN), static=True
        )
        _rig(rec, run, trace, rows, facts.force_scale)
        _spacecraft(rec, run, trace, rows)
        send_signals(rec, run, trace)


def _rig(
    rec: rr.RecordingStream, run: Run, trace: RunTrace, rows: NDArray[np.intp], scale: float
) -> None:
    scene = RigScene(run.scenario)
    time, pose = rr.TimeColumn("time", duration=trace.t[rows]), trace["pose_act"][rows]
    scene.draw(rec)
    placed = scene.port_poses(rows, trace["pose_cmd"], pose)
    scene.move(rec, time, pose, placed, scene.strokes(trace, rows))
    send_force(rec, CONTACT_FORCE, time, _felt(trace)[rows], pose, trace.contact[rows], scale)


def _spacecraft(rec: rr.RecordingStream, run: Run, trace: RunTrace, rows: NDArray[np.intp]) -> None:
    time = rr.TimeColumn("time", duration=trace.t[rows])
    spacecraft.draw(rec, run.scenario)
    poses = spacecraft.body_poses(run.scenario, rows, trace["pose_cmd"], trace["wrench_comp"])
    scale = force_scale(_peak(trace), FORCE_PART * min(spacecraft.heights(run.scenario)))
    spacecraft.move(rec, time, run.scenario, poses, trace["wrench_comp"][rows], scale)


def _peak(trace: RunTrace) -> float:
    """[N] the largest force that acted."""
    force = np.linalg.norm(_felt(trace)[:, :3], axis=1)
    return float(force[np.isfinite(force)].max(initial=0.0))


def _felt(trace: RunTrace) -> NDArray[np.float64]:
    """(rows, 6) the contact wrench; in a run with real devices, which do not measure it, the
    sensor's.
    """
    return trace["wrench_meas"] if np.isnan(trace["wrench_true"]).all() else trace["wrench_true"]


def _identity(run: Run) -> str:
    """Recording id: the same for the same run."""
    return f"{run.summary['name']}-{run.summary['scenario_sha256'][:12]}"
