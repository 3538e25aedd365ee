"""The page of the benchmark of identification."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hiltestbed.report.page import Report, new_figure


def identification_report(records: Sequence[dict[str, Any]], summary: dict[str, Any]) -> Report:
    """Leaderboard, heat maps of the error of c, errors over the noise, intervals."""
    report = Report("Identification of stiffness and damping")
    best = summary["leaderboard"][0]
    report.lead(
        f"{best['method']} finds k within {100 * best['stiffness_error']:.2f} % and c within "
        f"{100 * best['damping_error']:.2f} % from one "
        "contact at 0.2 % noise, over the whole grid (median over seeds)."
    )
    rows = []
    for row in summary["leaderboard"]:
        delay = "" if "delay_error" not in row else f"{1e3 * row['delay_error']:.2f} ms"
        cells = [_percent(row[name]) for name in ("stiffness_error", "damping_error")]
        rows.append([row["method"], *cells, row["damping_error_missing"], delay])
    report.table(
        ["method", "k", "c", "contacts without an estimate", "delay, worst seed"],
        rows,
        "Largest error over the grid at 0.2 % noise, median over seeds. rls_delay_estimated "
        "starts from a nominal delay that is 20 % off.",
    )
    report.figure(
        _heat_maps(records), "Error of c at 0.2 % noise [%], the largest over the damping ratios."
    )
    if len({r["noise"] for r in records}) > 1:
        report.figure(
            _noise(records),
            "Half the 95 % spread of k and c as a function of the noise: 8 Hz, 20 ms, damping "
            "ratio 0.2.",
        )
    held = summary["intervals"]
    report.text(
        f"Reported 95 % intervals contained the true value in {100 * held['stiffness']:.1f} % (k) "
        f"and {100 * held['damping']:.1f} % (c) of "
        f"{held['seeds']:.0f} seeds at 4 Hz, 10 ms, damping ratio 0.05."
    )
    report.text(
        "An unknown delay can be determined only from the instant of touch: during contact, an "
        "error of the delay is absorbed by c. This requires a touch point known to within speed "
        "times the error, and a force that rises by more than its noise within a tick."
    )
    return report


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.2f} %"


def _heat_maps(records: Sequence[dict[str, Any]]):
    from matplotlib.colors import SymLogNorm

    some = [r for r in records if r["noise"] == 0.002]
    methods = list(dict.fromkeys(r["method"] for r in some))
    frequencies, delays = (sorted({r[key] for r in some}) for key in ("frequency", "delay"))
    figure, axes = new_figure(13, 5.4, nrows=2, ncols=4)
    for axis in axes.flat[len(methods) :]:
        axis.axis("off")
    for axis, method in zip(axes.flat, methods, strict=False):
        values = np.full((len(frequencies), len(delays)), np.nan)
        for r in some:
            i, j = frequencies.index(r["frequency"]), delays.index(r["delay"])
            if (
                r["method"] == method
                and r["damping_error"] is not None
                and not abs(values[i, j]) > 100 * abs(r["damping_error"])
            ):
                values[i, j] = 100 * r["damping_error"]
        axis.imshow(
            values,
            norm=SymLogNorm(0.1, vmin=-300, vmax=300),
            cmap="RdBu_r",
            origin="lower",
            aspect="auto",
        )
        for (i, j), value in np.ndenumerate(values):
            axis.text(
                j,
                i,
                "-" if np.isnan(value) else f"{value:.3g}",
                ha="center",
                va="center",
                fontsize=7,
            )
        axis.set_xticks(range(len(delays)), [f"{1e3 * d:g} ms" for d in delays], fontsize=7)
        axis.set_yticks(range(len(frequencies)), [f"{f:g} Hz" for f in frequencies], fontsize=7)
        axis.set_title(method, fontsize=9)
    return figure


def _noise(records: Sequence[dict[str, Any]]):
    figure, axes = new_figure(10, 3.6, ncols=2)
    for axis, name in zip(axes, ("stiffness", "damping"), strict=True):
        for method in dict.fromkeys(r["method"] for r in records):
            line = [
                r
                for r in records
                if (r["method"], r["frequency"], r["delay"], r["damping_ratio"])
                == (method, 8.0, 0.02, 0.2)
                and r[f"{name}_spread"]
            ]
            spread = [50 * (r[f"{name}_spread"][1] - r[f"{name}_spread"][0]) for r in line]
            if line:
                axis.plot([100 * r["noise"] for r in line], spread, "o-", label=method)
        axis.set(xscale="log", yscale="log", xlabel="noise [% of peak force]", ylabel=f"{name} [%]")
    axes[0].legend(fontsize=7)
    return figure
