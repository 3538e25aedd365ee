"""Calibration of stated probabilities: the share of first causes that were correct, by stated
probability.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

from matplotlib.figure import Figure

from hiltestbed.report.page import new_figure

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
            out.append(
                {
                    "low": low,
                    "high": high,
                    "stated": stated,
                    "right": sum(r for _, r in inside),
                    "causes": len(inside),
                }
            )
    return out


def reliability_lines(rows: Sequence[dict[str, Any]]) -> list[tuple[str, str]]:
    """Label and value of each line of the printed table."""
    return [
        (f"stated with {r['low']:g} to {r['high']:g}", f"{r['right']} of {r['causes']} right")
        for r in rows
    ]


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
