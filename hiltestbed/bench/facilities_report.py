"""The page of the benchmark of the facilities."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hiltestbed.report.page import Report, new_figure

LEAST = 1e-4  # smallest |ln(e/e_ref)| that is drawn


def facilities_report(records: Sequence[dict[str, Any]], summary: dict[str, Any]) -> Report:
    """Results of the same contacts on each kind of rig, and characteristics of the rigs."""
    report = Report("Facilities")
    worst = summary["worst"]
    bare = [w for w in worst if w["treatment"] == "uncompensated" and not w["passive"]]
    report.lead(
        f"{len(bare)} of {sum(w['treatment'] == 'uncompensated' for w in worst)} driven facilities "
        "add energy to a contact without compensation; the rows below give the remaining errors "
        "with the field's usual compensation and with the default."
    )
    header = [
        "facility",
        "compensation",
        "|ln(e/e_ref)|",
        "peak force error",
        "passive",
        "net damping [N s/m]",
        "largest delay [ms]",
    ]
    rows = [
        [
            w["facility"],
            w["treatment"],
            _number(w["cor_log_error"], 4),
            f"{100.0 * w['peak_force_error']:.1f} %",
            "yes" if w["passive"] else "no",
            _number(w["net_damping"], 0),
            _number(w["largest_delay"], 1, 1e3),
        ]
        for w in worst
    ]
    report.table(
        header,
        rows,
        "Largest values over the contacts; for net damping and largest delay, the smallest. For a "
        "method that adds a force of its own "
        "these two are those of the loop without it. A dash: no rebound, or no loop.",
    )
    report.figure(
        _errors(worst),
        "Error of the coefficient of restitution, the largest over the contacts; hatched: active.",
    )
    report.heading("The rigs")
    header = [
        "facility",
        "reach [m]",
        "rotation [deg]",
        "delay at 2 Hz [ms]",
        "compliance [m/N]",
        "tick / bare steps",
        "times real time",
    ]
    rows = [
        [
            r["facility"],
            _number(r["reach"], 2),
            _number(r["turn"], 0),
            _number(r["delay"], 2, 1e3),
            "-" if r["compliance"] is None else f"{r['compliance']:.2e}",
            f"{r['cost']:.2f}",
            f"{r['real_time_factor']:.2f}",
        ]
        for r in summary["rigs"]
    ]
    report.table(
        header,
        rows,
        "Reach and rotation: the smallest over the axes, from home. Delay and compliance: measured "
        "along the insertion, with feed-forward. Cost of a tick with 16 runs on one thread.",
    )
    dockings = [r for r in records if r["case"] == "docking"]
    if dockings:
        report.heading("The same docking")
        report.table(
            [
                "facility",
                "compensation",
                "outcome",
                "captured at [s]",
                "without rig [s]",
                "energy generated [J]",
            ],
            [
                [
                    r["facility"],
                    r["treatment"],
                    r["outcome"],
                    _number(r["captured_at"], 3),
                    _number(r["captured_at_reference"], 3),
                    f"{r['energy_generated']:.3g}",
                ]
                for r in dockings
            ],
            "A probe 30 mm off the axis of its cone. The reference is the contact of the free "
            "bodies with six degrees of freedom.",
        )
    report.heading("What each kind distorts")
    for rig in summary["rigs"]:
        report.text(f"{rig['facility']}: {rig['distorts']}")
    return report


def _number(value: float | None, digits: int, factor: float = 1.0) -> str:
    return "-" if value is None else f"{factor * value:.{digits}f}"


def _errors(worst: Sequence[dict[str, Any]]):
    """One group of bars per facility: uncompensated, the field's usual compensation, the
    default.
    """
    names = list(dict.fromkeys(w["facility"] for w in worst))
    figure, axes = new_figure(9.0, 3.8)
    colors = {"uncompensated": "0.55", "default": "C0", "as it is": "C2"}
    for x, name in enumerate(names):
        mine = [w for w in worst if w["facility"] == name]
        for k, w in enumerate(mine):
            at = x + (k - 0.5 * (len(mine) - 1)) * 0.26
            height = max(w["cor_log_error"] if w["cor_log_error"] is not None else 1.0, LEAST)
            axes.bar(
                at,
                height,
                0.24,
                color=colors.get(w["treatment"], "C1"),
                hatch="" if w["passive"] else "//",
                edgecolor="white",
            )
    for label, color in (
        ("uncompensated", "0.55"),
        ("field's usual compensation", "C1"),
        ("default", "C0"),
        ("no loop", "C2"),
    ):
        axes.bar(np.nan, np.nan, color=color, label=label)
    axes.set_yscale("log")
    axes.set_ylim(0.6 * LEAST, 5.0)
    axes.set_xticks(
        range(len(names)), [n.replace(", ", "\n").replace("_", "\n") for n in names], fontsize=8
    )
    axes.set_ylabel("|ln(e/e_ref)|")
    axes.legend(ncols=4, fontsize=8)
    return figure
