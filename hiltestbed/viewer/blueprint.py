"""The layout of a recording: the scene on the left, the signals of the contact on the right."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from hiltestbed.analysis.metrics import energy_generated
from hiltestbed.frames import Array
from hiltestbed.numerical_model.bodies import approach_state
from hiltestbed.platform.settings import Rig
from hiltestbed.report.curves import span_of_contact
from hiltestbed.run_folder.result import Run
from hiltestbed.signals import AXES, RunTrace
from hiltestbed.viewer import plots, rig, spacecraft

Point = tuple[float, float, float]

# position of the camera, and the point that it looks at
SIX_AXES: tuple[Point, Point] = (1.45, -2.75, 0.2), (0.0, 0.0, -0.45)
NINE_AXES: tuple[Point, Point] = (5.0, -2.8, 1.7), (0.0, 0.0, 0.75)
CLOSE: tuple[Point, Point] = (0.42, -0.76, -0.2), (0.0, 0.0, 0.01)
BACKGROUND = (22, 26, 33)
BEFORE, AFTER = 0.15, 0.35  # [s] shown around the first contact, at least
MARGIN = 0.06  # of the span, above and below
# largest spans, in ticks of one power of ten, for which a contact plot labels them; beyond, the
# next power
UPWARD, ACROSS = 6.0, 4.5
SHOWN = 10.0  # [s] playback time of the window, in slow motion if it is shorter


@dataclass(frozen=True)
class ShownRun:
    """The data of a run that the layout depends on: ``force_scale`` [m/N] of the arrows."""

    run: Run
    trace: RunTrace
    force_scale: float

    @property
    def window(self) -> tuple[float, float]:
        """[s] around the contacts; the whole run if the ports do not touch."""
        start, end = float(self.trace.t[0]), float(self.trace.t[-1])
        touching = self.trace.t[self.trace.contact]
        if not len(touching):
            return start, end
        first, last = float(touching[0]), float(touching[-1])
        span = last - first
        return max(first - max(BEFORE, 0.5 * span), 0.0), min(last + max(AFTER, span), end)

    @property
    def shown(self) -> tuple[float, float]:
        """[s] that the plots show."""
        span = span_of_contact(self.trace.t, self.trace.contact)
        return readable(*span, ACROSS) if self.trace.contact.any() else span


def layout(facts: ShownRun) -> rrb.Blueprint:
    """The initial layout, which plays the contact in slow motion."""
    start, end = facts.window
    return rrb.Blueprint(
        rrb.Horizontal(_scenes(facts), _signals(facts), column_shares=[1.0, 1.0]),
        rrb.TimePanel(
            timeline="time",
            playback_speed=min(1.0, float(f"{(end - start) / SHOWN:.1g}")) if end > start else 1.0,
            loop_mode=rrb.components.LoopMode.Selection,
            time_selection=rrb.components.AbsoluteTimeRange(
                min=round(1e9 * start), max=round(1e9 * end)
            ),
            state="collapsed",
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _scenes(facts: ShownRun) -> rrb.Vertical:
    return rrb.Vertical(
        rig_view(facts.run.scenario.rig, "The rig", facts.force_scale),
        rrb.Horizontal(
            _scene("At the contact", rig.AT_P, *CLOSE, contents=[f"/{rig.ROOT}/**"]),
            _spacecraft(facts),
        ),
        row_shares=[1.7, 1.0],
    )


def rig_view(own: Rig, name: str, force_scale: float) -> rrb.Spatial3DView:
    """The rig from between the columns of its frame; ``force_scale`` [m/N] of the arrow."""
    eye, target = NINE_AXES if own.upper.kind != "fixed" else SIX_AXES
    contents = [f"/{rig.ROOT}/**", *(f"- /{name}" for name in rig.PORT_NAMES)]
    title = f"{name} (force arrow: 1 m is {1.0 / force_scale:g} N)"
    return _scene(title, rig.ROOT, eye, target, contents)


def _spacecraft(facts: ShownRun) -> rrb.Spatial3DView:
    up, down = spacecraft.heights(facts.run.scenario.spacecraft)
    down += facts.run.scenario.approach.gap
    middle, away = 0.5 * (up - down), 1.3 * (up + down)
    eye = (0.55 * away, -0.82 * away, middle + 0.18 * away)
    return _scene(
        "The two spacecraft of the numerical model", spacecraft.ROOT, eye, target=(0.0, 0.0, middle)
    )


def _scene(
    name: str, origin: str, eye: Point, target: Point, contents: Sequence[str] = ("$origin/**",)
) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        name=name,
        origin=origin,
        contents=list(contents),
        background=BACKGROUND,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=eye, look_target=target, eye_up=(0.0, 0.0, 1.0)
        ),
        spatial_information=rrb.SpatialInformation(
            target_frame=f"tf#/{origin}", show_axes=False, show_bounding_box=False
        ),
    )


def _signals(facts: ShownRun) -> rrb.Tabs:
    return rrb.Tabs(
        _contact(facts),
        _six(facts, "Pose", ("position_mm", "Position", "mm"), ("attitude_deg", "Attitude", "deg")),
        _six(facts, "Wrench", ("force", "Force", "N"), ("torque", "Torque", "N m")),
        _estimates(facts),
        rrb.Vertical(
            *(
                _plot(facts, path, title)
                for unit, path, _, _, title in plots.JOINTS
                if unit in facts.trace.joints
            ),
            _plot(
                facts, "platform/tracking_error_mm", "Tracking error: reached minus desired [mm]"
            ),
            name="Platform",
        ),
        rrb.TextDocumentView(name="Figures", origin="figures"),
        active_tab=0,
    )


def _contact(facts: ShownRun) -> rrb.Vertical:
    """The insertion; beside it stiffness and damping if they are known, else lateral forces."""
    trace = facts.trace
    if facts.run.summary["identification"]["z"]["stiffness_true"] is not None:
        beside = [
            _plot(facts, "stiffness/z", "Stiffness, z [N/m]", _estimate_range(facts, "stiffness")),
            _plot(facts, "damping/z", "Damping, z [N s/m]", _estimate_range(facts, "damping")),
        ]
    else:
        across = (_range(facts, _forces(trace, j)) for j in range(2))
        beside = [
            _plot(facts, f"force/{axis}", f"Contact force, {axis} [N]", r)
            for axis, r in zip("xy", across, strict=True)
        ]
    less = trace["wrench_meas"][:, :3] - trace["wrench_true"][:, :3]
    positions = 1e3 * np.stack([trace["pose_cmd"][:, 2], trace["pose_act"][:, 2]], axis=-1)
    energy = energy_generated(
        trace, approach_state(facts.run.scenario.approach), facts.run.scenario.tick
    )
    left = rrb.Vertical(
        _plot(facts, "position_mm/z", "Insertion, z [mm]", _range(facts, positions)),
        _plot(facts, "force/z", "Contact force, z [N]", _range(facts, _forces(trace, 2))),
        _plot(facts, "force_error", "Measured minus physical force [N]", _range(facts, less)),
    )
    phases = rrb.StateTimelineView(
        name="Contact phase", origin=plots.PHASE, time_view=_time_axis(facts)
    )
    right = rrb.Vertical(
        *beside,
        _plot(facts, "energy_generated", "Energy made by the rig [J]", _range(facts, energy)),
    )
    return rrb.Vertical(rrb.Horizontal(left, right), phases, row_shares=[8.0, 1.0], name="Contact")


def _forces(trace: RunTrace, axis: int) -> Array:
    """``(ticks, 3)`` physical, measured, used."""
    return np.stack(
        [trace[f"wrench_{kind}"][:, axis] for kind in ("true", "meas", "comp")], axis=-1
    )


def _six(facts: ShownRun, name: str, *quantities: tuple[str, str, str]) -> rrb.Horizontal:
    columns = [
        rrb.Vertical(
            *(_plot(facts, f"{path}/{axis}", f"{title} {axis} [{unit}]") for axis in "xyz")
        )
        for path, title, unit in quantities
    ]
    return rrb.Horizontal(*columns, name=name)


def _estimates(facts: ShownRun) -> rrb.Horizontal:
    """The axes that have an estimate or a true value."""
    columns = []
    for path, title in (("stiffness", "Stiffness"), ("damping", "Damping")):
        known = np.any(np.isfinite(facts.trace[f"{path}_est"]), axis=0).tolist()
        truth = facts.run.summary["identification"]
        axes = [
            axis
            for j, axis in enumerate(AXES)
            if known[j] or truth[axis][f"{path}_true"] is not None
        ]
        columns.append(
            rrb.Vertical(
                *(_plot(facts, f"{path}/{axis}", f"{title} {axis}") for axis in axes or ["z"])
            )
        )
    return rrb.Horizontal(*columns, name="Identified")


def _time_axis(facts: ShownRun) -> rrb.TimeAxis:
    start, end = (rr.encodings.TimeRangeBoundary.absolute(seconds=t) for t in facts.shown)
    return rrb.TimeAxis(view_range=rr.encodings.TimeRange(start=start, end=end))


def _plot(
    facts: ShownRun, path: str, name: str, y_range: tuple[float, float] | None = None
) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        name=name,
        origin=f"{plots.ROOT}/{path}",
        axis_x=_time_axis(facts),
        axis_y=rrb.ScalarAxis(range=y_range) if y_range else None,
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop),
    )


def _range(facts: ShownRun, values: Array) -> tuple[float, float] | None:
    """Range of values ``(ticks, ...)`` in the window; None: none, and the viewer chooses."""
    start, end = facts.shown
    shown = values[(facts.trace.t >= start) & (facts.trace.t <= end)]
    shown = shown[np.isfinite(shown)]
    return readable(float(shown.min()), float(shown.max())) if len(shown) else None


def _estimate_range(facts: ShownRun, name: str) -> tuple[float, float] | None:
    """Range of later estimates and the true value: the first of a contact may be far off."""
    values: Array = facts.trace[f"{name}_est"][:, 2]
    values = values[np.isfinite(values)]
    truth = facts.run.summary["identification"]["z"][f"{name}_true"]
    shown = [*np.percentile(values, [5.0, 95.0])] if len(values) else []
    shown += [truth] if truth is not None else []
    if not shown:
        return None
    low, high = min(shown), max(shown)
    margin = max(0.25 * (high - low), 0.02 * abs(high), 1e-9)
    return readable(low - margin, high + margin)


def readable(low: float, high: float, most: float = UPWARD) -> tuple[float, float]:
    """The range from ``low`` to ``high`` with a margin, widened at the nearer end until two
    multiples of the labelled step lie in it: the viewer places ticks only at powers of ten.
    """
    span = high - low
    if not span > 0.0:
        span = max(abs(high), 1e-9)
    low, high = low - MARGIN * span, high + MARGIN * span
    step = 10.0 ** math.floor(math.log10(high - low))
    if high - low > most * step:
        step *= 10.0
    while ticks(low, high, step) < 2:
        below, above = (math.ceil(low / step) - 1) * step, (math.floor(high / step) + 1) * step
        if low - below < above - high:
            low = below - MARGIN * step
        else:
            high = above + MARGIN * step
    return low, high


def ticks(low: float, high: float, step: float) -> int:
    """How many multiples of ``step`` lie between ``low`` and ``high``."""
    return max(0, math.floor(high / step) - math.ceil(low / step) + 1)
