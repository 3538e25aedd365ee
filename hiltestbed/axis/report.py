"""The folder of an axis's diagnosis: diagnosis.json, report.html, extended.yaml."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hiltestbed.axis.effects.base import AXIS_EFFECTS
from hiltestbed.axis.result import estimate
from hiltestbed.report.page import Report, new_figure
from hiltestbed.run_folder.store import whole_folder

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hiltestbed.axis.result import AxisFinding

DIAGNOSIS = "diagnosis.json"
MEASURED, NOMINAL, EXTENDED, GREY = "#1b2530", "#d1495b", "#0b6e99", "#8a97a3"
MOST_RUNS = 4  # in the figure over time
TITLES = {
    "no_discrepancy": "the nominal model agrees with the data",
    "named": "the causes are named",
    "ambiguous": "one of a few causes",
    "named_in_part": "causes are named, and something is left",
    "unknown": "a departure without a named cause",
    "inconclusive": "the records do not tell",
}


def write_axis_diagnosis(diagnosis: AxisFinding, path: str | Path) -> Path:
    """Write the folder and return its path.

    Raises:
        InputError: the folder cannot be written, or holds something else.
    """
    path = Path(path)
    with whole_folder(path, mark=DIAGNOSIS) as folder:
        text = json.dumps(diagnosis.to_json(), indent=2, allow_nan=False) + "\n"
        (folder / DIAGNOSIS).write_text(text, encoding="utf-8")
        (folder / "extended.yaml").write_text(extended_yaml(diagnosis), encoding="utf-8")
        page_of(diagnosis).write(folder / "report.html")
    return path


def extended_yaml(d: AxisFinding) -> str:
    """The file of the axis with the named effects: `hiltestbed diagnose` reads it again."""
    data: dict[str, Any] = d.loaded.spec.model_dump(mode="json", exclude_unset=True)
    folder = d.loaded.source.folder.resolve()
    for run, entry in zip(data["runs"], d.loaded.spec.runs, strict=True):
        run["file"] = str(folder / entry.file) if "${" not in entry.file else entry.file
    if "model" in data and "${" not in data["model"]:
        data["model"] = str(folder / data["model"])
    data["effects"] = [*data.get("effects", []), *(c.entry() for c in d.extension)]
    head = "# The axis with the effects that its diagnosis named.\n" if d.extends else ""
    if d.undetermined:
        weak = ", ".join(x.effect for x in d.undetermined)
        head += f"# Not determined by its records, and needed to predict them: {weak}.\n"
    return head + json.dumps(data, indent=2) + "\n"


def page_of(d: AxisFinding) -> Report:
    """report.html, from the verdict down."""
    report = Report(f"Diagnosis of {d.name}: {TITLES[d.verdict]}")
    report.lead(d.sentence())
    c, (_, unit) = d.conclusion, d.loaded.units()
    if c is None:
        return report
    if d.causes:
        report.heading("Causes" if len(d.causes) > 1 else "Cause")
        for cause in d.causes:
            effect = AXIS_EFFECTS[cause.effect]
            report.text(f"{cause.effect}: {effect.meaning()} {effect.equation}")
        rows = [
            (
                cause.effect + ("" if cause in d.causes else " (not determined)"),
                name,
                estimate(value, ends),
                own,
                f"{100.0 * cause.gain:.0f} %",
                f"{cause.probability:.2f}",
                ", ".join(cause.indistinguishable_from) or "nothing else",
            )
            for cause in (*d.causes, *d.undetermined)
            for name, (value, ends, own) in cause.parameters.items()
        ]
        report.table(
            (
                "effect",
                "parameter",
                "estimate (95 % interval)",
                "unit",
                "removes",
                "probability",
                "indistinguishable from",
            ),
            rows,
            "removes: share of the rms on left-out runs, beside the other causes. The intervals "
            "include the scatter between runs.",
        )
    report.heading("Measured and predicted")
    report.figure(
        over_time(d),
        "Each run, measured, nominal and extended; below it what each leaves. The model is driven "
        "by the recorded input alone.",
    )
    report.heading("Runs that were left out of the fit")
    names = [name for name, _, _ in d.model.folds()]
    report.figure(
        left_out(d), "rms of each run, predicted by a model that was fitted to the others."
    )
    rows = [
        (name, f"{k:.4g}", f"{b:.4g}", f"{a:.4g}")
        for name, k, b, a in zip(names, d.constant, c.before, c.after, strict=True)
    ]
    report.table(("run", f"constant [{unit}]", f"nominal [{unit}]", f"extended [{unit}]"), rows)
    report.heading("Hypotheses that were compared")
    report.table(
        ("causes", "log of the evidence, below the best", "named"),
        [
            (
                " + ".join(f"{x.kind} ({', '.join(x.names)})" for x in f.causes) or "nothing",
                f"{c.visited[0].evidence - f.evidence:.1f}",
                "yes" if d.causes and f.keys == c.fit.keys else "",
            )
            for f in (*c.visited[:8], *([c.null] if c.null not in c.visited[:8] else []))
        ],
        "The evidence is that of the runs that were fitted. Named is what also predicts runs that "
        "were left out, less the causes without which it predicts them as well; it may be none of "
        "these.",
    )
    if d.remarks:
        report.heading("Remarks")
        report.items(d.remarks)
    return report


def over_time(d: AxisFinding) -> Figure:
    """Measured, nominal and extended over time, and what each leaves."""
    assert d.conclusion is not None
    records = d.model.records[:MOST_RUNS]
    nominal = d.model.predicted(d.conclusion.null.of)
    extended = d.model.predicted(d.conclusion.fit.of) if d.extends else nominal
    figure, grid = new_figure(
        9.5, 3.6 * len(records), nrows=2 * len(records), ncols=1, squeeze=False
    )
    unit = d.loaded.units()[1]
    for k, (record, n, e) in enumerate(zip(records, nominal, extended, strict=False)):
        top, below = grid[2 * k, 0], grid[2 * k + 1, 0]
        top.plot(record.t, record.y, color=MEASURED, lw=2.2, alpha=0.35, label="measured")
        top.plot(record.t, n, color=NOMINAL, lw=0.9, label="nominal")
        below.plot(record.t, record.y - n, color=NOMINAL, lw=0.7)
        if d.extends:
            top.plot(record.t, e, color=EXTENDED, lw=0.9, ls="--", label="extended")
            below.plot(record.t, record.y - e, color=EXTENDED, lw=0.7)
            most = float(np.quantile(np.abs(record.y - e), 0.995))
            below.set_ylim(-3.0 * most, 3.0 * most)
        span = float(np.ptp(record.y))
        top.set_ylim(record.y.min() - 0.15 * span, record.y.max() + 0.15 * span)
        top.set_ylabel(f"{record.name}\n[{unit}]", fontsize=8)
        below.set_ylabel(f"left [{unit}]", fontsize=8)
    grid[0, 0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False)
    grid[-1, 0].set_xlabel("time [s]")
    return figure


def left_out(d: AxisFinding) -> Figure:
    """rms of each left-out run: constant, nominal, extended."""
    assert d.conclusion is not None
    c, names = d.conclusion, [name for name, _, _ in d.model.folds()]
    figure, axes = new_figure(9.0, 3.0)
    place = np.arange(len(names))
    for shift, values, color, label in (
        (-0.27, d.constant, GREY, "a constant"),
        (0.0, c.before, NOMINAL, "nominal"),
        (0.27, c.after, EXTENDED, "extended"),
    ):
        axes.bar(place + shift, values, 0.25, color=color, label=label)
    axes.set_yscale("log")
    axes.set_xticks(place, names, fontsize=8)
    axes.set_ylabel(f"rms [{d.loaded.units()[1]}]")
    axes.legend(frameon=False, fontsize=8)
    return figure
