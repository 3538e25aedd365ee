"""The page of the benchmark of diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hiltestbed.report.page import Report, new_figure
from tests.equipment.diagnosis.summary import reliability_plot, rig_of

RATES = {
    "named_rate": "one hidden effect, named (alone or in a set of three)",
    "pair_rate": "two hidden effects, both named",
    "false_alarm_rate": "healthy rigs with a false alarm",
    "foreign_unknown_rate": "effects outside the vocabulary, judged unknown with the right link",
    "abstention_rate": "one or two hidden effects, judged unknown",
    "interval_coverage": "true parameters within their 95 % intervals",
    "gain_ratio": "gain on held-out runs over the true model's gain (median)",
}


def diagnosis_report(records: Sequence[dict[str, Any]], summary: dict[str, Any]) -> Report:
    """Rates, the confusion matrix, the smallest detectable effects."""
    report = Report("Diagnosis of hidden effects")
    report.lead(
        f"{summary['done']} sets of measured data from an independent rig, with hidden effects or "
        f"without: {sum(g['right'] for g in summary['groups'])} were judged correctly."
    )
    rows = [
        [text, "-" if summary[name] is None else f"{summary[name]:.3f}"]
        for name, text in RATES.items()
    ]
    report.table(["figure", "value"], rows, "Sets of a bumper, effects of full size.")
    if summary["done"] < summary["planned"]:
        report.text(
            f"{summary['done']} of {summary['planned']} sets, in random order, were done in the "
            f"given time."
        )
    rows = [
        [g["rig"], g["kind"], g["sets"], g["right"], f"{g['low']:.2f} to {g['high']:.2f}"]
        + [g["misnamed"]]
        + [f"{g[cpu]:.0f}" for cpu in ("cpu_median", "cpu_longest")]
        for g in summary["groups"]
    ]
    columns = ["rig", "hidden", "sets", "correct", "95 % interval of the share"]
    columns += ["names what was not hidden", "CPU s, median", "longest"]
    report.table(columns, rows, "Each kind of set on each kind of rig.")
    report.figure(
        _strengths(records),
        "Single effects: strength of each relative to the noise of its link, and whether it was "
        "named.",
    )
    if summary["reliability"]:
        report.figure(
            reliability_plot(summary["reliability"]),
            "Calibration of the stated probabilities, with 95 % intervals.",
        )
    called = [
        [hidden, name, count]
        for hidden, names in summary["confusion"].items()
        for name, count in names.items()
    ]
    report.table(
        ["hidden", "named", "sets"], called, "The names that each hidden effect was given."
    )
    small = [
        [name, f"{found['strength']:.2g}", _sizes(found)]
        for name, found in summary["smallest_found"].items()
    ]
    columns = ["effect", "rms over noise", "parameters"]
    report.table(columns, small, "The smallest size at which each effect was named.")
    wrong = []
    for r in records:
        if not r["right"]:
            names = _names(r["hidden"]), r["verdict"], _names(r["causes"], "effect")
            wrong.append([r["seed"], f"{r['kind']}, {rig_of(r)}", *names])
    caption = "All sets that were judged wrongly, or whose effect was not found."
    report.table(["seed", "kind", "hidden", "verdict", "named"], wrong, caption)
    return report


def _sizes(found: dict[str, Any]) -> str:
    return ", ".join(
        f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}"
        for k, v in found.items()
        if k != "strength"
    )


def _names(entries: Sequence[dict[str, Any]], key: str = "kind") -> str:
    return " + ".join(e[key] for e in entries) or "-"


def _strengths(records: Sequence[dict[str, Any]]):
    figure, axes = new_figure(8.0, 3.2)
    singles = [r for r in records if r["kind"] == "single"]
    for right, colour, row in ((True, "tab:green", 1.0), (False, "tab:red", 0.0)):
        x = [max(r["strengths"][0], 1e-3) for r in singles if r["right"] is right]
        axes.semilogx(x, row + 0.25 * np.sin(np.arange(len(x)) * 2.4), "o", color=colour, alpha=0.6)
    axes.set_yticks([0.0, 1.0], ["missed", "named"])
    axes.set_ylim(-0.5, 1.5)
    axes.set_xlabel("rms of the change in the records over the noise")
    return figure
