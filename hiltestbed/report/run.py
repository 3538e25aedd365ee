"""report.html of a run: what happened, whether the loop is passive and by what margin, what was
identified, what to do next.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hiltestbed.analysis.assessment import (
    CLOSE,
    DELAYS,
    ESTIMATES,
    NEUTRAL,
    assess,
    delays_of,
    energy_share,
    estimates_of,
    figures_of,
)
from hiltestbed.analysis.limits import in_cells
from hiltestbed.analysis.metrics import energy_generated
from hiltestbed.contact.directions import acting_along_z
from hiltestbed.contact.law import Pair
from hiltestbed.contact.sides import sides_of
from hiltestbed.frames import Array
from hiltestbed.identification.samples import GATE_SIGMA
from hiltestbed.numerical_model.bodies import approach_state
from hiltestbed.report.curves import PALETTE, POINTS, shade_contacts, span_of_contact
from hiltestbed.report.page import Report, new_figure, provenance
from hiltestbed.run_folder.folders import number
from hiltestbed.run_folder.result import Run
from hiltestbed.scenario.limits import DockingLimits
from hiltestbed.signals import RunTrace

REPORT = "report.html"
NORMAL = " normal: along the contact normal of the surfaces, which is not an axis."
STYLES = ("-", "--", ":")


def run_report(run: Run) -> Report:
    """The page of a run."""
    summary = run.summary
    judged = assess(summary)
    report = Report(f"Run {summary['name']}")
    report.lead(judged.headline)
    for warning in judged.warnings:
        report.warning(f"{warning}.")
    report.heading("What happened")
    error = number(1e3 * summary["tracking_error"], 3, "mm")
    tracking = ("largest tracking error", error, "commanded minus reached position")
    report.table(("figure", "value", "meaning"), [*figures_of(summary), tracking])
    if run.trace is not None and len(run.trace.t):
        report.figure(_signals(run.trace), "Along the insertion. Shaded: in contact.")
    report.heading("Is the loop passive?")
    report.text(_margin(acting_along_z(run.scenario.impact), summary))
    if run.trace is not None and summary["contact_duration"] and len(run.trace.t) > 1:
        caption = "Energy that the rig has made so far. For a passive rig it is never above zero."
        made = energy_generated(run.trace, approach_state(run.scenario.approach), run.scenario.tick)
        report.figure(_energy(run.trace, made, summary.get("approach_energy")), caption)
    _ledger(report, summary)
    _identified(report, run)
    _limits(report, run.scenario.limits, summary)
    report.heading("What to do next")
    report.items(judged.advice or ("Nothing: no further action is needed.",))
    report.heading("How it was made")
    rows = [("scenario", summary["scenario_sha256"][:16]), ("seed", summary["seed"])]
    report.table(
        ("what", "version, or start of the SHA-256"),
        rows + provenance(summary["versions"], summary.get("plugins", {})),
    )
    return report


def _margin(contact: Pair, summary: dict[str, Any]) -> str:
    """The energy balance of a ``contact`` in words, and the delay that the loop bears."""
    share = energy_share(summary)
    if not summary["contact_duration"]:
        return "Nothing touched, so the question does not arise."
    words = []
    if share is not None:
        verdict = (
            "made no significant energy"
            if abs(share) <= NEUTRAL
            else "made energy"
            if share > 0.0
            else "dissipated energy"
        )
        words.append(f"The rig {verdict}: {100.0 * share:+z.2f} % of the approach energy.")
    total = summary["delay_ledger"][-1]["delay"] if summary["delay_ledger"] else 0.0
    (stiffness, damping), stability = contact, summary.get("stability")
    words.append(
        f"The remaining delays add up to {1e3 * total:+.3f} ms, equivalent to a damping of "
        f"{-stiffness * total:+.4g} N s/m."
    )
    if stability:
        without = stability.get("uncompensated") or {}
        words.append(f"The loop in this contact is {stability['verdict']}.")
        if without.get("verdict") and without["verdict"] != stability["verdict"]:
            words.append(f"Without the compensation it would be {without['verdict']}.")
    elif damping > 0.0:
        bears = damping / stiffness
        words.append(
            f"The damping of the surfaces, {damping:.4g} N s/m, compensates a delay of "
            f"c/k = {1e3 * bears:.3g} ms: "
            + (
                f"{1e3 * (bears - total):.3g} ms more until the loop gains energy."
                if total < bears
                else "less than that delay."
            )
        )
    else:
        words.append(
            "The surfaces have no damping: any remaining delay makes the loop gain energy."
        )
    return " ".join(words)


def _ledger(report: Report, summary: dict[str, Any]) -> None:
    if not summary["delay_ledger"]:
        return
    caption = (
        "Effect of each delay: a delay tau acts on a contact of stiffness k like a "
        "damping of -k tau."
    )
    predicted = summary.get("cor_log_error_predicted")
    if predicted is not None:
        caption += f" Their sum predicts {predicted:+.4f} for the ln of the ratio."
    report.table(DELAYS, delays_of(summary), caption)


def _limits(report: Report, limits: DockingLimits | None, summary: dict[str, Any]) -> None:
    rows = [(*in_cells(row), number(row["share"], 3)) for row in summary.get("limits", ())]
    if limits is None or not rows:
        return
    report.heading("Against the limits")
    caption = "Share above 1: beyond the limit. Of a lowest value it is 2 less the share."
    if limits.standard:
        caption += f" Limits of {limits.standard}, and those of the scenario."
    report.table(("quantity", "value", "limit", "unit", "share"), rows, caption)


def _identified(report: Report, run: Run) -> None:
    rows = estimates_of(run.summary)
    report.heading("What was identified")
    if rows:
        caption = "k in N/m (rx, ry, rz: N m/rad), c in N s/m (N m s/rad)."
        report.table(ESTIMATES, rows, caption + NORMAL * (rows[-1][0] == "normal"))
    else:
        report.text(f"Neither stiffness nor damping was identified: {_why_not(run)}.")


def _why_not(run: Run) -> str:
    """Why nothing was identified on any axis or normal."""
    scenario, summary = run.scenario, run.summary
    mechanism, lasted = scenario.mechanism, summary["contact_duration"]
    if scenario.identification.kind == "none":
        return "identification is none"
    if not lasted:
        return "nothing touched"
    if not (mechanism.flat or mechanism.captured or sides_of(mechanism).rigid):
        return (
            "the pose does not show how far the mechanism's moving parts give way, or where its "
            "surfaces touch, before it captures"
        )
    if not (mechanism.flat or mechanism.captured or "identification_normal" in summary):
        return f"{scenario.identification.kind} identifies a plane or a latch, not a curved surface"
    noise = GATE_SIGMA * scenario.sensor.noise
    if summary["peak_force"] <= noise:
        return (
            f"the peak force, {summary['peak_force']:.3g} N, is below {GATE_SIGMA:g} standard "
            f"deviations of the sensor's noise, {noise:.3g} N"
        )
    return (
        f"no contact lasted long enough, in {lasted:.3g} s of contact altogether, beside the delay "
        "and the filters of the sensor"
    )


def _signals(trace: RunTrace):
    """Force and position along the insertion."""
    rows = _shown(trace)
    t = trace.t[rows]
    figure, axes = new_figure(9.0, 5.6, nrows=3, sharex=True)
    forces = {"physical": "wrench_true.fz", "measured": "wrench_meas.fz", "used": "wrench_comp.fz"}
    positions = {"reached": "pose_act.pz", "commanded": "pose_cmd.pz"}
    panels = (
        ("force [N]", 1.0, forces),
        ("measured minus\nphysical [N]", 1.0, {}),
        ("pz [mm]", 1e3, positions),
    )
    for axis, (label, scale, lines) in zip(axes, panels, strict=True):
        shade_contacts(axis, trace.t, trace.contact)
        for (name, column), color, style in zip(lines.items(), PALETTE, STYLES, strict=False):
            shown = scale * trace[column][rows]
            axis.plot(t, shown, color=color, linewidth=1.3, label=name, linestyle=style)
        if lines:
            axis.legend(loc="upper right", fontsize=8)
        axis.set_ylabel(label)
    less = (trace["wrench_meas.fz"] - trace["wrench_true.fz"])[rows]
    axes[1].plot(t, less, color=PALETTE[1], linewidth=1.2)
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(t[0], t[-1])
    return figure


def _shown(trace: RunTrace) -> np.ndarray:
    """The rows of the displayed span, at most as many as can be distinguished."""
    start, end = span_of_contact(trace.t, trace.contact)
    rows = np.flatnonzero((trace.t >= start) & (trace.t <= end))
    return rows[:: max(1, len(rows) // POINTS)]


def _energy(trace: RunTrace, made: Array, approach: float | None):
    """Energy that the rig had ``made`` (ticks,) [J]; ``approach``: of the approach [J]."""
    rows = _shown(trace)
    figure, axis = new_figure(9.0, 2.6)
    shade_contacts(axis, trace.t, trace.contact)
    color = PALETTE[1] if made[-1] > 0.0 else PALETTE[0]
    axis.plot(trace.t[rows], 1e3 * made[rows], color=color, linewidth=1.5)
    axis.axhline(0.0, color="#5b6b7a", linewidth=0.8)
    if approach and float(np.abs(made).max()) > 0.2 * CLOSE * approach:
        ways = (lambda mj: 0.1 * mj / approach, lambda share: 10.0 * share * approach)
        second = axis.secondary_yaxis("right", functions=ways)
        second.set_ylabel("% of the approach")
    axis.set(xlabel="time [s]", ylabel="energy [mJ]", xlim=(trace.t[rows[0]], trace.t[rows[-1]]))
    return figure
