"""The signals of a run as plots: every tick, one entity per axis of a quantity, with all its
curves.

Lengths are in mm and angles in degrees here, for readability; the trace is in SI.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from hiltestbed.analysis.metrics import energy_generated
from hiltestbed.frames import Array, rotation_vectors
from hiltestbed.numerical_model.bodies import approach_state
from hiltestbed.run_folder.result import Run
from hiltestbed.signals import AXES, RunTrace
from hiltestbed.viewer import colors

ROOT = "signals"
XYZ = "xyz"
LINE_WIDTHS = (4.0, 1.5, 1.5)  # line widths: the reference is a wide line beneath the others
JOINTS = (  # unit in the trace, path, name of a curve, scale factor, title
    ("m", "platform/slider_mm", "slider {j} [mm]", 1e3, "Sliders of the platform [mm]"),
    ("rad", "platform/joint_deg", "joint {j} [deg]", 180.0 / np.pi, "Joints of the platform [deg]"),
)
PHASE = f"{ROOT}/contact_phase"
PHASES = {
    "approach": ("Approach", (84, 96, 116)),
    "compression": ("Closing", (255, 140, 38)),
    "restitution": ("Opening", (240, 200, 80)),
    "free": ("Apart again", (70, 130, 120)),
    "captured": ("Captured", (150, 110, 230)),
}


class Plotter:
    """Sends curves on the time base of a run."""

    def __init__(self, rec: rr.RecordingStream, t: Array) -> None:
        self.rec, self.t = rec, t
        self.time = rr.TimeColumn("time", duration=t)

    def curves(
        self,
        path: str,
        names: Sequence[str],
        palette: Sequence[tuple[int, ...]],
        values: Array,
        widths: Sequence[float] = (),
    ) -> None:
        """Curves ``values`` (ticks, curves) of one entity; wide ones show beneath narrow ones."""
        style = rr.SeriesLines(
            names=list(names), colors=list(palette), widths=list(widths) or [1.5] * len(names)
        )
        self.rec.log(f"{ROOT}/{path}", style, static=True)
        columns = rr.Scalars.columns(scalars=np.ascontiguousarray(values))
        self.rec.send_columns(f"{ROOT}/{path}", indexes=[self.time], columns=columns)


def send_signals(rec: rr.RecordingStream, run: Run, trace: RunTrace) -> None:
    """All plots of a run."""
    plotter = Plotter(rec, trace.t)
    _axes(plotter, trace)
    _estimates(plotter, run, trace)
    _platform(plotter, trace)
    energy = energy_generated(trace, approach_state(run.scenario.approach), run.scenario.tick)
    plotter.curves(
        "energy_generated", ["made by the rig [J]"], [colors.ENERGY], energy[:, None], [2.0]
    )
    send_phases(rec, run, trace)


def _axes(plotter: Plotter, trace: RunTrace) -> None:
    """Pose and wrench, axis by axis."""
    pair = np.stack([trace["pose_cmd"], trace["pose_act"]], axis=1)
    triple = np.stack([trace[f"wrench_{kind}"] for kind in ("true", "meas", "comp")], axis=-1)
    poses = ("desired", "reached"), (colors.DESIRED, colors.REACHED)
    wrenches = ("physical", "measured", "used"), (colors.PHYSICAL, colors.MEASURED, colors.USED)
    for path, unit, (names, palette), values in (
        ("position_mm", "mm", poses, np.moveaxis(1e3 * pair[..., :3], -1, 0)),
        (
            "attitude_deg",
            "deg",
            poses,
            np.moveaxis(np.degrees(rotation_vectors(pair[..., 3:])), -1, 0),
        ),
        ("force", "N", wrenches, np.moveaxis(triple[:, :3], 1, 0)),
        ("torque", "N m", wrenches, np.moveaxis(triple[:, 3:], 1, 0)),
    ):
        labels = [f"{name} [{unit}]" for name in names]
        for axis, curves in zip(XYZ, values, strict=True):
            plotter.curves(f"{path}/{axis}", labels, palette, curves, LINE_WIDTHS[: len(names)])
    less = trace["wrench_meas"][:, :3] - trace["wrench_true"][:, :3]
    plotter.curves("force_error", [f"{axis} [N]" for axis in XYZ], colors.SERIES[:3], less)


def _estimates(plotter: Plotter, run: Run, trace: RunTrace) -> None:
    """Identified stiffness and damping, with their true values if known."""
    for name, units in (("stiffness", ("N/m", "N m/rad")), ("damping", ("N s/m", "N m s/rad"))):
        for j, axis in enumerate(AXES):
            unit, values = units[j // 3], trace[f"{name}_est"][:, j]
            known = np.flatnonzero(np.isfinite(values))
            path = f"{name}/{axis}"
            if len(known):
                later, label = Plotter(plotter.rec, trace.t[known[0] :]), [f"identified [{unit}]"]
                later.curves(
                    f"{path}/identified", label, [colors.ESTIMATE], values[known[0] :, None], [2.0]
                )
            truth = run.summary["identification"][axis][f"{name}_true"]
            if truth is not None:
                ends, label = Plotter(plotter.rec, trace.t[[0, -1]]), [f"true [{unit}]"]
                ends.curves(f"{path}/true", label, [colors.TRUE], np.full((2, 1), truth))


def _platform(plotter: Plotter, trace: RunTrace) -> None:
    for unit, path, name, factor, _ in JOINTS:
        which = [j for j, u in enumerate(trace.joints) if u == unit]
        if which and "slider_act" in trace.data:
            shades = [colors.SERIES[j % len(colors.SERIES)] for j in range(len(which))]
            names = [name.format(j=j) for j in which]
            plotter.curves(path, names, shades, factor * trace["slider_act"][:, which])
    behind = np.zeros((len(trace.t), 3))  # pose_cmd[k] is the target for row k + 1
    behind[1:] = 1e3 * (trace["pose_act"][1:, :3] - trace["pose_cmd"][:-1, :3])
    plotter.curves(
        "platform/tracking_error_mm", [f"{a} [mm]" for a in XYZ], colors.SERIES[:3], behind
    )


def contact_phases(trace: RunTrace, captured_at: float | None = None) -> list[str]:
    """The phase of every tick: approach before the first touch, closing or opening in contact by
    the sign of the velocity along z, then free; captured from the time ``captured_at`` [s] at which
    the latches closed.
    """
    touched = np.logical_or.accumulate(trace.contact)
    opening = trace["twist_act"][:, 2] < 0.0
    code = np.where(trace.contact, np.where(opening, 2, 1), np.where(touched, 3, 0))
    if captured_at is not None:
        code[trace.t >= captured_at - 1e-9] = 4
    names = list(PHASES)
    return [names[c] for c in code]


def send_phases(rec: rr.RecordingStream, run: Run, trace: RunTrace) -> None:
    """The contact phase as a state: one row per change."""
    phases = np.array(contact_phases(trace, run.summary.get("captured_at")))
    rows = np.flatnonzero(np.concatenate([[True], phases[1:] != phases[:-1]]))
    labels, palette = zip(*PHASES.values(), strict=True)
    rec.log(
        PHASE,
        rr.StateConfiguration(values=list(PHASES), labels=list(labels), colors=list(palette)),
        static=True,
    )
    time = rr.TimeColumn("time", duration=trace.t[rows])
    rec.send_columns(
        PHASE, indexes=[time], columns=rr.StateChange.columns(state=list(phases[rows]))
    )
