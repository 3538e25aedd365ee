"""recording.rrd of a diagnosis: the signals of every run, measured, nominal and extended, on one
timeline; the residual of each link; the causes in words; and the rig in the run that the nominal
model predicts worst.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from hiltestbed.diagnosis.report.evidence import in_sigma
from hiltestbed.diagnosis.report.pictures import worst_channels, worst_run
from hiltestbed.diagnosis.report.sentence import TITLES, gain_sentence, verdict_sentence
from hiltestbed.diagnosis.result import Conclusion, SimulatedRun
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredRun
from hiltestbed.viewer import colors
from hiltestbed.viewer.blueprint import rig_view
from hiltestbed.viewer.drawing import force_scale, recording_file, send_force
from hiltestbed.viewer.rig import CONTACT_FORCE, RigScene

MEASURED, NOMINAL, EXTENDED = colors.MEASURED, colors.PHYSICAL, colors.USED
SIGNALS = {  # entity: group, part, factor to the unit shown, title
    "pose_cmd_z": ("pose_cmd", 2, 1e3, "Insertion commanded, z [mm]"),
    "pose_act_z": ("pose_act", 2, 1e3, "Insertion reached, z [mm]"),
    "force_z": ("wrench_meas", 2, 1.0, "Force measured, z [N]"),
    "force_x": ("wrench_meas", 0, 1.0, "Force measured, x [N]"),
    "force_y": ("wrench_meas", 1, 1.0, "Force measured, y [N]"),
}
IN_VIEW = ("pose_cmd_z", "pose_act_z", "force_z")
RESIDUAL = "residual"
FRAME_RATE = 120.0  # chosen: [Hz] of the rig's poses
# the measured curve: entities are drawn in the order of their names, and this one lies broad
# underneath
MEASURED_ENTITY = "data"


def write_diagnosis_recording(path: Path, diagnosis: Conclusion) -> None:
    """Write the recording with its layout.

    Raises:
        OSError: the file could not be written.
    """
    channels = worst_channels(diagnosis.finding.series)
    with recording_file(path, f"diagnosis-{diagnosis.name}", _layout(diagnosis, channels)) as rec:
        rec.send_recording_name(f"diagnosis of {diagnosis.name}")
        rec.log(
            "verdict",
            rr.TextDocument(_words(diagnosis), media_type=rr.MediaType.MARKDOWN),
            static=True,
        )
        for i, (run, simulated) in enumerate(
            zip(diagnosis.dataset.runs, diagnosis.simulated, strict=True)
        ):
            _signals(rec, i, run, simulated, diagnosis.finding.extends)
        _residuals(rec, diagnosis, channels)
        _rig(rec, diagnosis.dataset.runs[_first(diagnosis, channels)])


def _words(diagnosis: Conclusion) -> str:
    """Verdict, causes, gain, next experiment: Markdown."""
    lines = [f"# {TITLES[diagnosis.verdict].capitalize()}", "", verdict_sentence(diagnosis), ""]
    rows = [
        f"| {cause.effect} | {name} | {p.in_words()} | {cause.probability:.2f} |"
        for cause in diagnosis.causes
        for name, p in cause.parameters.items()
    ]
    if rows:
        lines += [
            "## Causes",
            "",
            "| effect | parameter | estimate (95 %) | probability |",
            "|---|---|---|---:|",
            *rows,
            "",
        ]
    lines += ["## Gain", "", gain_sentence(diagnosis.heldout, diagnosis.finding.names), ""]
    return "\n".join(
        [
            *lines,
            "## Next experiment",
            "",
            diagnosis.next_experiment or "Nothing remains open that another run would settle.",
        ]
    )


def _first(diagnosis: Conclusion, channels: list[str]) -> int:
    """The run that the nominal simulation predicts worst."""
    return worst_run(diagnosis.finding.series, channels[0]) if channels else 0


def _rig(rec: rr.RecordingStream, run: MeasuredRun) -> None:
    """The rig in a run, at its measured pose, or the commanded one where that is missing; the
    measured force as an arrow.
    """
    pose, force = _motion(run)
    if pose is None:
        return
    t = run.record.t
    rows = np.unique(
        np.round(np.arange(0.0, len(t), max(run.scenario.rate / FRAME_RATE, 1.0)))
        .astype(np.intp)
        .clip(max=len(t) - 1)
    )
    scene, time = RigScene(run.scenario), rr.TimeColumn("time", duration=t[rows])
    scene.draw(rec)
    scene.move(rec, time, pose[rows], scene.port_poses(rows, pose, pose[rows]))
    touching = np.zeros(len(t), dtype=bool)
    for c in run.survey.contacts:
        touching[c.start : c.end] = True
    send_force(rec, CONTACT_FORCE, time, force[rows], pose[rows], touching[rows], _scale(force))


def _motion(run: MeasuredRun) -> tuple[Array | None, Array]:
    """``(ticks, 7)`` pose of A in P, None where none was measured, and ``(ticks, 6)`` wrench, zero
    where none was.
    """
    record = run.record
    group = next((g for g in ("pose_act", "pose_cmd") if record.has(g)), None)
    force = (
        record.filled("wrench_meas") if record.has("wrench_meas") else np.zeros((record.ticks, 6))
    )
    return (record.filled(group) if group else None), force


def _scale(force: Array) -> float:
    """[m/N] of the arrow."""
    return force_scale(float(np.linalg.norm(force[:, :3], axis=1).max(initial=0.0)))


def _signals(
    rec: rr.RecordingStream, i: int, run: MeasuredRun, simulated: SimulatedRun, extends: bool
) -> None:
    record = run.record
    for entity, (group, part, factor, _) in SIGNALS.items():
        origin = f"run_{i}/{entity}"
        if group in record.data and record.valid[group][:, part].any():
            known = record.valid[group][:, part]
            _curve(
                rec,
                f"{origin}/{MEASURED_ENTITY}",
                record.t[known],
                factor * record.data[group][known, part],
                "measured",
                MEASURED,
                4.0,
            )
        for name, trace, color in (
            ("nominal", simulated.nominal, NOMINAL),
            ("extended", simulated.extended if extends else None, EXTENDED),
        ):
            if trace is not None:
                _curve(
                    rec, f"{origin}/{name}", trace.t, factor * trace[group][:, part], name, color
                )


def _residuals(rec: rr.RecordingStream, diagnosis: Conclusion, channels: list[str]) -> None:
    for s in diagnosis.finding.series:
        if s.channel not in channels:
            continue
        sides = [("nominal", in_sigma(s), NOMINAL)]
        sides += [(diagnosis.compared, in_sigma(s, True), EXTENDED)] if diagnosis.compared else []
        for name, left, color in sides:
            known = np.isfinite(left)
            _curve(
                rec,
                f"run_{s.run}/{RESIDUAL}/{_entity(s.channel)}/{name.replace(' ', '_')}",
                s.t[known],
                left[known],
                f"measured less {name}",
                color,
            )


def _curve(
    rec: rr.RecordingStream,
    path: str,
    t: Array,
    values: Array,
    name: str,
    color: tuple[int, int, int],
    width: float = 1.5,
) -> None:
    rec.log(path, rr.SeriesLines(names=[name], colors=[color], widths=[width]), static=True)
    time = rr.TimeColumn("time", duration=t)
    rec.send_columns(
        path, indexes=[time], columns=rr.Scalars.columns(scalars=np.ascontiguousarray(values))
    )


def _entity(channel: str) -> str:
    return channel.replace(".", "_")


def _layout(diagnosis: Conclusion, channels: list[str]) -> rrb.Blueprint:
    """A tab for each run, open on the run that the nominal simulation predicts worst; beside it the
    rig in that run, and the verdict.
    """
    first = _first(diagnosis, channels)
    tabs = rrb.Tabs(
        *(_run_tab(i, run, channels) for i, run in enumerate(diagnosis.dataset.runs)),
        active_tab=first,
    )
    words = rrb.TextDocumentView(name="Verdict", origin="verdict")
    run = diagnosis.dataset.runs[first]
    pose, force = _motion(run)
    if pose is None:
        beside = words
    else:
        beside = rrb.Vertical(
            rig_view(run.scenario.rig, f"The rig in {run.name}, as measured", _scale(force)),
            words,
            row_shares=[1.2, 1.0],
        )
    return rrb.Blueprint(
        rrb.Horizontal(tabs, beside, column_shares=[1.5, 1.0]),
        rrb.TimePanel(timeline="time", state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _run_tab(i: int, run: MeasuredRun, channels: list[str]) -> rrb.Vertical:
    plots = [_plot(f"run_{i}/{entity}", SIGNALS[entity][3], run) for entity in IN_VIEW]
    plots += [
        _plot(f"run_{i}/{RESIDUAL}/{_entity(c)}", f"{c}: residual of its link [sigma]", run)
        for c in channels[:2]
    ]
    return rrb.Vertical(
        *plots, name=f"{run.name}: {abs(run.scenario.approach.velocity[2]):.3g} m/s"
    )


def _plot(origin: str, name: str, run: MeasuredRun) -> rrb.TimeSeriesView:
    """Around the contacts, where there are any."""
    axis = None
    if run.survey.contacts:
        t, first, last = run.record.t, run.survey.contacts[0].start, run.survey.contacts[-1].end
        span = t[min(last, len(t) - 1)] - t[first]
        ends = max(0.0, t[first] - 0.3 * span), min(t[-1], t[min(last, len(t) - 1)] + 0.3 * span)
        low, high = (rr.encodings.TimeRangeBoundary.absolute(seconds=float(e)) for e in ends)
        axis = rrb.TimeAxis(view_range=rr.encodings.TimeRange(start=low, end=high))
    return rrb.TimeSeriesView(
        name=name,
        origin=origin,
        axis_x=axis,
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop),
    )
