"""A run as a rerun recording: read this first. Scene, motion, signals and layout in one file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from hiltestbed.analysis.assessment import (
    DELAYS,
    ESTIMATES,
    assess,
    delays_of,
    estimates_of,
    figures_of,
)
from hiltestbed.numerical_model.model import NumericalModel
from hiltestbed.run_folder.result import Run
from hiltestbed.signals import RunTrace
from hiltestbed.viewer import spacecraft
from hiltestbed.viewer.blueprint import ShownRun, layout
from hiltestbed.viewer.drawing import force_scale, recording_file, send_force
from hiltestbed.viewer.plots import send_signals
from hiltestbed.viewer.rig import CONTACT_FORCE, RigScene

# [Hz] frame rates out of contact and in contact, which lasts a few hundredths of a second
FREE, CONTACT = 60.0, 240.0
FORCE_PART = 0.6  # of a spacecraft's height, at most: the largest force drawn on it


def write_recording(path: Path, run: Run) -> None:
    """Write ``run`` as a recording with its layout.

    Bodies and forces are drawn at selected frames (:func:`frame_rows`); signals are
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
    identity = f"{run.summary['name']}-{run.summary['scenario_sha256'][:12]}"
    with recording_file(path, identity, layout(facts)) as rec:
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
    time, craft = rr.TimeColumn("time", duration=trace.t[rows]), run.scenario.spacecraft
    spacecraft.draw(rec, craft)
    model = NumericalModel([run.scenario])
    poses = spacecraft.body_poses(model, rows, trace["pose_cmd"], trace["wrench_comp"])
    scale = force_scale(_peak(trace), FORCE_PART * min(spacecraft.heights(craft)))
    spacecraft.move(rec, time, craft, poses, trace["wrench_comp"][rows], scale)


def _peak(trace: RunTrace) -> float:
    """[N] the largest force that acted."""
    force = np.linalg.norm(_felt(trace)[:, :3], axis=1)
    return float(force[np.isfinite(force)].max(initial=0.0))


def _felt(trace: RunTrace) -> NDArray[np.float64]:
    """(rows, 6) the contact wrench; with real devices, which do not measure it, the sensor's."""
    return trace["wrench_meas"] if np.isnan(trace["wrench_true"]).all() else trace["wrench_true"]


def frame_rows(trace: RunTrace, rate: float) -> NDArray[np.intp]:
    """Rows at FREE, in contact at CONTACT, first, last, the largest force; finite poses only."""
    ticks = len(trace.t)
    drawn = np.zeros(ticks, dtype=bool)
    drawn[_every(ticks, rate / FREE)] = True
    close = _every(ticks, rate / CONTACT)
    drawn[close[trace.contact[close]]] = True
    drawn[[0, -1]] = True
    force = np.linalg.norm(trace["wrench_true"][:, :3], axis=1)
    if trace.contact.any():
        drawn[int(np.argmax(np.where(np.isfinite(force), force, 0.0)))] = True
    return np.flatnonzero(
        drawn
        & np.isfinite(trace["pose_act"]).all(axis=1)
        & np.isfinite(trace["pose_cmd"]).all(axis=1)
    )


def _every(ticks: int, step: float) -> NDArray[np.intp]:
    """Every ``step``-th row; ``step`` need not be an integer."""
    return np.unique(
        np.round(np.arange(0.0, ticks, max(step, 1.0))).astype(np.intp).clip(max=ticks - 1)
    )


def figures(run: Run) -> str:
    """Markdown: description of the run, its figures, and the identified values."""
    summary, scenario = run.summary, run.scenario
    lines = [f"# {summary['name']}", "", scenario.description or "", ""]
    lines += _table(("figure", "value", "meaning"), figures_of(summary))
    if summary["status"] != "completed":
        lines += ["", f"**{summary['status']}**: {summary['stop_reason']}"]
    lines += ["", *(f"**Warning:** {warning}." for warning in assess(summary).warnings)]
    lines += ["", *_table(DELAYS, delays_of(summary)), ""]
    return "\n".join([*lines, *_table(ESTIMATES, estimates_of(summary))])


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """A Markdown table, numbers to the right of a first column of words; nothing without rows."""
    lines = [f"| {' | '.join(row)} |" for row in (header, *rows)]
    return [lines[0], "|---|" + "---:|" * (len(header) - 1), *lines[1:]] if rows else []
