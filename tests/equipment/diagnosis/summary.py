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

from hiltestbed.report.page import new_figure
from tests.equipment.diagnosis.tasks import DOCKING_FULL, FULL


def summarise(records: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The rates, the confusion matrix, the smallest size of each effect that was found."""
    noisy = [r for r in records if r["noise"] and r["kind"] == "healthy"]
    calibration, found = reliability(records), groups(records)
    records = [r for r in records if not r["noise"] and r["computing"] == "plain"]
    moderate = [r for r in records if r["scale"] == 1.0 and r["design"] == "bumper"]
    dockings = {
        kind: [r for r in records if r["design"] != "bumper" and r["kind"] == kind]
        for kind in DOCKING_FULL
    }
    by_kind = {kind: [r for r in moderate if r["kind"] == kind] for kind in FULL}
    hidden = by_kind["single"] + by_kind["pair"]
    asked = sum(r["intervals"] for r in hidden)
    ratios = [
        r["gain"] / r["gain_true"] for r in hidden if r["gain"] is not None and r["gain_true"]
    ]
    return {
        "named_rate": _rate(by_kind["single"]),
        "pair_rate": _rate(by_kind["pair"]),
        "triple_rate": _rate(by_kind["triple"]),
        "alike_rate": _rate(by_kind["alike"]),
        "alike_wrong_rate": _share([_misnamed(r) for r in by_kind["alike"]]),
        "false_alarm_rate": _alarms(by_kind["healthy"]),
        "foreign_unknown_rate": _rate(by_kind["foreign"]),
        "foreign_named_rate": _share([bool(r["causes"]) for r in by_kind["foreign"]]),
        "named_in_part_wrong_rate": wrong_in_part(records),
        **{
            f"healthy_{name}": max((r["alarm"][name] for r in by_kind["healthy"]), default=None)
            for name in ("taken_off", "excess")
        },
        "abstention_rate": _share([r["verdict"] == "unknown" for r in hidden]),
        "interval_coverage": sum(r["intervals_held"] for r in hidden) / asked if asked else None,
        "gain_ratio": float(np.median(ratios)) if ratios else None,
        "sets": {kind: len(part) for kind, part in by_kind.items()},
        "docking_named_rate": _rate(dockings["single"]),
        "docking_pair_rate": _rate(dockings["pair"]),
        "docking_false_alarm_rate": _alarms(dockings["healthy"]),
        "docking_foreign_unknown_rate": _rate(dockings["foreign"]),
        "docking_sets": {kind: len(part) for kind, part in dockings.items()},
        "noise_alarms": noise_alarms(noisy),
        "noise_alarm_rate": _alarms(noisy),
        "cpu_median": float(np.median([r["cpu"] for r in records])) if records else None,
        "cpu_longest": max((r["cpu"] for r in records), default=None),
        "groups": found,
        "reliability": calibration,
        "confusion": confusion(by_kind["single"] + dockings["single"]),
        "smallest_found": smallest(records),
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
    share right (95 %, Wilson), `cpu_median`, `cpu_longest` [s].
    """
    parted: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for r in records:
        kind = r["kind"] if r["scale"] == 1.0 else f"{r['kind']}, {r['scale']:g} of its size"
        parted.setdefault((rig_of(r, "noise"), kind), []).append(r)
    out = []
    for (rig, kind), part in sorted(parted.items()):
        right, spent = sum(r["right"] for r in part), [r["cpu"] for r in part]
        low, high = wilson(right, len(part))
        row = {"rig": rig, "kind": kind, "sets": len(part), "right": right}
        row |= {"low": low, "high": high}
        out.append(row | {"cpu_median": float(np.median(spent)), "cpu_longest": max(spent)})
    return out


def rig_of(record: dict[str, Any], noisy: str) -> str:
    """The rig of a set: `noisy` with noise, otherwise its design or its way of computing."""
    plain = record["computing"] == "plain"
    return noisy if record["noise"] else record["design" if plain else "computing"]


def _misnamed(record: dict[str, Any]) -> bool:
    """Whether a stated cause was not hidden, and no hidden effect is listed as indistinguishable
    from it.
    """
    truth = {e["kind"] for e in record["hidden"]}
    return any(not truth & {c["effect"], *c["indistinguishable_from"]} for c in record["causes"])


def wrong_in_part(records: Sequence[dict[str, Any]]) -> float | None:
    """Share of the causes named in part that were not hidden; None if none was named in part."""
    correct = [
        bool({c["effect"], *c["indistinguishable_from"]} & {e["kind"] for e in r["hidden"]})
        for r in records for c in r["causes"] if r["verdict"] == "named_in_part"
    ]  # fmt: skip
    return 1.0 - sum(correct) / len(correct) if correct else None


def noise_alarms(records: Sequence[dict[str, Any]]) -> dict[str, str]:
    """Kind and strength of noise to the number of false alarms."""
    out: dict[str, list[bool]] = {}
    for r in records:
        out.setdefault(f"{r['noise'][0]} {r['noise'][1]:g}", []).append(not r["right"])
    return {name: f"{sum(wrong)} of {len(wrong)}" for name, wrong in out.items()}


def _share(values: Sequence[bool]) -> float | None:
    """Share of true values; None if there are no values."""
    return sum(values) / len(values) if values else None


def _rate(records: Sequence[dict[str, Any]]) -> float | None:
    return _share([r["right"] for r in records])


def _alarms(records: Sequence[dict[str, Any]]) -> float | None:
    return _share([not r["right"] for r in records])


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
        if r["kind"] != "single" or not r["right"] or r["design"] != "bumper":
            continue
        name, strength = r["hidden"][0]["kind"], r["strengths"][0]
        if name not in out or strength < out[name]["strength"]:
            size = {k: v for k, v in r["hidden"][0].items() if k != "kind"}
            out[name] = {"strength": strength} | size
    return dict(sorted(out.items()))


EDGES = (0.0, 0.5, 0.8, 0.95, 0.99, 1.0)


def reliability(records: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row per range of stated probabilities: `low`, `high`, `stated` (mean), `right` and
    `causes` (numbers of first causes).
    """
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


def wilson(right: int, count: int, z: float = 1.96) -> tuple[float, float]:
    """95 % interval of a probability from ``right`` successes in ``count`` trials (E. B. Wilson,
    1927).
    """
    share, square = right / count, z * z / count
    middle = (share + 0.5 * square) / (1.0 + square)
    half = z * ((share * (1.0 - share) / count + square / (4.0 * count)) ** 0.5) / (1.0 + square)
    return max(0.0, middle - half), min(1.0, middle + half)
