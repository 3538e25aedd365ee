"""The rates of the benchmark of diagnosis: overall rates by name, rates of each group of sets, and
the calibration of stated probabilities: the share of first causes that were correct.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import binomtest

from hiltestbed.report.page import new_figure
from tests.equipment.diagnosis.tasks import FULL


def summarise(records: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The rates of bumpers with effects of full size; groups of all sets, calibration, confusion
    matrix and the smallest size of each effect that was found.
    """
    plain = [r for r in records if rig_of(r) == "bumper"]
    by_kind = {kind: [r for r in plain if r["kind"] == kind and r["scale"] == 1.0] for kind in FULL}
    hidden = by_kind["single"] + by_kind["pair"]
    asked = sum(r["intervals"] for r in hidden)
    ratios = [
        r["gain"] / r["gain_true"] for r in hidden if r["gain"] is not None and r["gain_true"]
    ]
    return {
        "named_rate": _share([r["right"] for r in by_kind["single"]]),
        "pair_rate": _share([r["right"] for r in by_kind["pair"]]),
        "false_alarm_rate": _share([not r["right"] for r in by_kind["healthy"]]),
        "foreign_unknown_rate": _share([r["right"] for r in by_kind["foreign"]]),
        "abstention_rate": _share([r["verdict"] == "unknown" for r in hidden]),
        "interval_coverage": sum(r["intervals_held"] for r in hidden) / asked if asked else None,
        "gain_ratio": float(np.median(ratios)) if ratios else None,
        "groups": groups(records),
        "reliability": reliability(records),
        "confusion": confusion([r for r in records if r["kind"] == "single" and not r["noise"]]),
        "smallest_found": smallest(plain),
    }


def summary_lines(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Label and value of each line of the printed table."""

    def text(value: Any) -> str:
        return f"{value:.3g}" if isinstance(value, float) else "-" if value is None else str(value)

    lines = [
        (name.replace("_", " "), text(value))
        for name, value in summary.items()
        if not isinstance(value, (dict, list))
    ]
    lines += [
        (f"{g['rig']}: {g['kind']}", f"{g['right']} of {g['sets']} right")
        for g in summary["groups"]
    ]
    lines += [
        (f"stated with {r['low']:g} to {r['high']:g}", f"{r['right']} of {r['causes']} right")
        for r in summary["reliability"]
    ]
    return lines


def groups(records: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row per rig and kind of set: `rig`, `kind`, `sets`, `right`, `low` and `high` of the
    share right (95 %), `misnamed` (a cause is stated that was not hidden), `cpu_median`,
    `cpu_longest` [s].
    """
    parted: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for r in records:
        kind = r["kind"] if r["scale"] == 1.0 else f"{r['kind']}, {r['scale']:g} of its size"
        parted.setdefault((rig_of(r), kind), []).append(r)
    out = []
    for (rig, kind), part in sorted(parted.items()):
        right, spent = sum(r["right"] for r in part), [r["cpu"] for r in part]
        low, high = wilson(right, len(part))
        row = {"rig": rig, "kind": kind, "sets": len(part), "right": right}
        row |= {"low": low, "high": high, "misnamed": sum(map(_misnamed, part))}
        out.append(row | {"cpu_median": float(np.median(spent)), "cpu_longest": max(spent)})
    return out


def rig_of(record: dict[str, Any]) -> str:
    """The rig of a set: its noise if that is not white, else its design or its way of computing."""
    if record["noise"]:
        return "{} {:g}".format(*record["noise"])
    return record["design" if record["computing"] == "plain" else "computing"]


def _misnamed(record: dict[str, Any]) -> bool:
    """Whether a stated cause was not hidden, nor listed as indistinguishable from one that was."""
    truth = {e["kind"] for e in record["hidden"]}
    return any(not truth & {c["effect"], *c["indistinguishable_from"]} for c in record["causes"])


def _share(values: Sequence[bool]) -> float | None:
    """Share of true values; None if there are no values."""
    return sum(values) / len(values) if values else None


def confusion(singles: Sequence[dict[str, Any]]) -> dict[str, dict[str, int]]:
    """Hidden effect to the names that it was given, with their counts."""
    out: dict[str, Counter] = {}
    for r in singles:
        called = (
            " + ".join(sorted(c["effect"] for c in r["causes"]))
            if r["verdict"] in ("named", "ambiguous")
            else r["verdict"]
        )
        out.setdefault(r["hidden"][0]["kind"], Counter())[called] += 1
    return {name: dict(counts) for name, counts in sorted(out.items())}


def smallest(records: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Effect to its smallest size that was found, with its strength relative to the noise."""
    out: dict[str, dict[str, Any]] = {}
    for r in records:
        if r["kind"] != "single" or not r["right"]:
            continue
        name, strength = r["hidden"][0]["kind"], r["strengths"][0]
        if name not in out or strength < out[name]["strength"]:
            size = {k: v for k, v in r["hidden"][0].items() if k != "kind"}
            out[name] = {"strength": strength} | size
    return dict(sorted(out.items()))


EDGES = (0.0, 0.5, 0.8, 0.95, 0.99, 1.0)


def reliability(records: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row per range of stated probabilities: `low`, `high`, `stated`, `right` and `causes`."""
    first_causes = []
    for r in records:
        truth = {e["kind"] for e in r["hidden"]}
        first_causes += [
            (c["probability"], c["effect"] in truth) for c in r["causes"][:1] if "probability" in c
        ]
    out = []
    for low, high in itertools.pairwise(EDGES):
        inside = [(p, right) for p, right in first_causes if low < p <= high or (p == 0.0 == low)]
        if inside:
            stated = sum(p for p, _ in inside) / len(inside)
            row = {"low": low, "high": high, "stated": stated}
            out.append(row | {"right": sum(r for _, r in inside), "causes": len(inside)})
    return out


def reliability_plot(rows: Sequence[dict[str, Any]]) -> Figure:
    """Share of correct causes over the stated probability, with its 95 % interval (Wilson)."""
    figure, axes = new_figure(4.2, 3.6)
    axes.plot([0.0, 1.0], [0.0, 1.0], color="0.6", lw=1)
    for r in rows:
        low, high = wilson(r["right"], r["causes"])
        axes.plot([r["stated"]] * 2, [low, high], color="C0", lw=1)
        axes.plot(r["stated"], r["right"] / r["causes"], "o", color="C0", ms=5)
    axes.set(
        xlabel="stated probability of the first cause",
        ylabel="share of correct causes",
        xlim=(0.0, 1.02),
        ylim=(0.0, 1.02),
    )
    return figure


def wilson(right: int, count: int) -> tuple[float, float]:
    """95 % interval of a probability from successes in ``count`` trials (E. B. Wilson, 1927)."""
    found = binomtest(right, count).proportion_ci(method="wilson")
    return float(found.low), float(found.high)
