"""The page of the benchmark of the coefficient of restitution."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from hiltestbed.analysis.spring_damper import SpringDamper
from hiltestbed.report.page import Report, new_figure

COLUMNS = (
    ("to_w_tau_0.25", "w tau to 0.25"),
    ("to_w_tau_0.50", "to 0.5"),
    ("to_w_tau_1.00", "to 1.0"),
    ("servo", "servo"),
    ("delay_off", "delay off 20 %"),
    ("delay_jitter", "delay jitter"),
)
# keys of a record, with the factor to the displayed unit
GRID = (("frequency", 1.0), ("delay", 1e3), ("damping_ratio", 1.0))
SMALLEST, LARGEST = 1e-3, 1.0  # |ln e/e_ref| at the ends of the colour scale
NOTHING = 5e-4  # errors that round to 0.000 are shown as zero
COLORS = "RdBu_r"


def cor_report(records: Sequence[dict[str, Any]], summary: dict[str, Any]) -> Report:
    """Leaderboard, heat maps, stability boundary, random rigs."""
    report = Report("Coefficient of restitution")
    board = summary["leaderboard"]
    first = next(row for row in board if row["contact"] == "first")
    report.lead(
        f"For a first contact, about which nothing is known, {first['method']} achieves "
        f"|ln(e/e_ref)| <= {first['largest_log_error']:.4f} over the whole grid."
    )
    for name, error in summary["failed"].items():
        report.text(f"{name} is left out; it ended with: {error}")
    _leaderboard(report, board)
    report.heading("Errors over the grid")
    report.figure(
        _heat_maps(records),
        "ln(e/e_ref) with ideal tracking and known delay; the largest over the damping ratios.",
    )
    report.text(_grid(records))
    report.heading("Boundary to an active contact")
    report.figure(
        _boundary(summary["boundary"]),
        "ln e over delay and contact frequency f, with k = mu (2 pi f)^2, at a damping ratio of "
        "0.05; black: e = 1. No "
        "compensation, the usual one and the default; plugins are in the table and the maps above.",
    )
    report.text(
        "Orange, the same in each map: the delay at which a closed contact becomes unstable "
        "without compensation, tau = atan(c w_c/k)/w_c with w_c^2 = (c^2 + sqrt(c^4 + 4 mu^2 "
        "k^2))/(2 mu^2); to first order a bounce has e = 1 there."
    )
    _random_rigs(report, summary["random_rigs"])
    return report


def _grid(records: Sequence[dict[str, Any]]) -> str:
    """The varied quantities, in words."""
    exact = [r for r in records if r["delay_knowledge"] == "exact" and r["tracking"] == "ideal"]
    each = len({(r["frequency"], r["delay"], r["damping_ratio"]) for r in exact})
    frequencies, delays, ratios = (
        ", ".join(f"{v:g}" for v in sorted({f * r[key] for r in exact})) for key, f in GRID
    )
    return (
        f"{each} contacts per method: frequencies {frequencies} Hz, delays {delays} ms, "
        f"damping ratios {ratios}."
    )


def _leaderboard(report: Report, board: Sequence[dict[str, Any]]) -> None:
    last = ("energy / approach", "peak force", "e <= 1", "\N{MICRO SIGN}s/tick")
    header = ["method", "contact", *(title for _, title in COLUMNS), *last]
    rows = []
    for row in board:
        cells = [_error(row, key) for key, _ in COLUMNS]
        peak, stable = f"{100 * row['peak_force_error']:.1f} %", f"{100 * row['stable']:.0f} %"
        rest = f"{row['energy_created']:+.3f}", peak, stable, f"{row['cost']:.1f}"
        rows.append([row["method"], row["contact"], *cells, *rest])
    report.table(
        header,
        rows,
        "Largest |ln(e/e_ref)| over the grid. Ideal tracking and known delay unless the column "
        "says otherwise; a dash: not measured; lost: some contact of the grid gave no rebound. e "
        "<= 1: share of the contacts whose rebound is no faster than the approach. Energy: the "
        "largest energy created by the rig over the energy of approach. Peak force: its largest "
        "error. Time: per tick of one run in a batch, in addition to the numerical model.",
    )


def _error(row: dict[str, Any], key: str) -> str:
    """The largest error; a dash if nothing was measured, `lost` if a run gave no rebound."""
    value = row[key]
    return f"{value:.4f}" if value is not None else "lost" if row["runs"][key] else "-"


def _heat_maps(records: Sequence[dict[str, Any]]):
    """One map per method, on one colour scale; a cell is white if its number rounds to zero."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import SymLogNorm

    exact = [r for r in records if r["delay_knowledge"] == "exact" and r["tracking"] == "ideal"]
    methods = list(dict.fromkeys((r["method"], r["contact"]) for r in exact))
    frequencies, delays = (sorted({r[key] for r in exact}) for key in ("frequency", "delay"))
    columns = 4
    lines = math.ceil(len(methods) / columns)
    figure, axes = new_figure(13, 2.7 * lines, nrows=lines, ncols=columns, squeeze=False)
    norm = SymLogNorm(SMALLEST, vmin=-LARGEST, vmax=LARGEST, base=10)
    for axis in axes.flat[len(methods) :]:
        axis.axis("off")
    for axis, (name, contact) in zip(axes.flat, methods, strict=False):
        mine = [r for r in exact if (r["method"], r["contact"]) == (name, contact)]
        values = worst_errors(mine, frequencies, delays)
        shown = np.where(np.abs(values) < NOTHING, 0.0, values)
        axis.imshow(shown, norm=norm, cmap=COLORS, origin="lower", aspect="auto")
        axis.set_facecolor("#c8ced4")
        for (i, j), value in np.ndenumerate(values):
            color = "white" if abs(value) > 0.05 else "black"  # black for NaN
            axis.text(j, i, cell_text(value), ha="center", va="center", fontsize=7, color=color)
        axis.set_xticks(range(len(delays)), [f"{1e3 * d:g}" for d in delays], fontsize=7)
        axis.set_yticks(range(len(frequencies)), [f"{f:g}" for f in frequencies], fontsize=7)
        axis.set_xlabel("delay [ms]", fontsize=7)
        axis.set_ylabel("frequency [Hz]", fontsize=7)
        axis.set_title(f"{name}, {contact}", fontsize=9)
    bar = figure.colorbar(
        ScalarMappable(norm, COLORS), ax=axes, extend="both", shrink=0.6, aspect=40
    )
    bar.set_label(
        "ln(e/e_ref); red: rebound too fast, blue: too slow; grey: no rebound", fontsize=8
    )
    return figure


def worst_errors(
    records: Sequence[dict[str, Any]], frequencies: Sequence[float], delays: Sequence[float]
) -> np.ndarray:
    """``(frequencies, delays)`` the largest errors over the damping ratios; NaN: no rebound."""
    values = np.zeros((len(frequencies), len(delays)))
    for r in records:
        i, j = frequencies.index(r["frequency"]), delays.index(r["delay"])
        if r["cor_log_error"] is None or np.isnan(values[i, j]):
            values[i, j] = np.nan
        elif abs(r["cor_log_error"]) > abs(values[i, j]):
            values[i, j] = r["cor_log_error"]
    return values


def cell_text(value: float) -> str:
    """A cell's number with its sign; 0 without a sign if it rounds to zero."""
    if np.isnan(value):
        return "lost"
    return "0" if abs(value) < NOTHING else f"{value:+.3f}"


def _boundary(boundary: dict[str, Any]):
    frequency, delay = np.array(boundary["frequency"]), 1e3 * np.array(boundary["delay"])
    names = [name for name in boundary if name not in ("frequency", "delay", "damping_ratio")]
    figure, axes = new_figure(13, 3.8, ncols=len(names), sharey=True)
    w, z = 2.0 * math.pi * frequency, boundary["damping_ratio"]
    limit = [1e3 * SpringDamper(v**2, 2.0 * z * v, 1.0).critical_delay for v in w]  # of a unit mass
    for axis, name in zip(axes, names, strict=True):
        e = np.array(boundary[name])
        mesh = axis.pcolormesh(
            frequency, delay, np.log(e).T, cmap="RdBu_r", vmin=-1.0, vmax=1.0, shading="gouraud"
        )
        if (e > 1.0).any() and (e < 1.0).any():
            axis.contour(frequency, delay, e.T, levels=[1.0], colors="black")
        axis.plot(frequency, limit, color="tab:orange", linestyle="--", linewidth=2)
        axis.set(xscale="log", yscale="log", xlabel="contact frequency [Hz]", title=name)
        axis.set_xticks([1, 2, 4, 8], ["1", "2", "4", "8"])
        axis.set_yticks([1, 2, 5, 10, 20, 30], ["1", "2", "5", "10", "20", "30"])
        axis.minorticks_off()
        axis.set(xlim=(frequency[0], frequency[-1]), ylim=(delay[0], delay[-1]))
    axes[0].set_ylabel("delay [ms]")
    figure.colorbar(mesh, ax=axes, label="ln e", extend="both")
    return figure


def _random_rigs(report: Report, results: dict[str, dict[str, Any]]) -> None:
    report.heading("Random rigs")
    rows = []
    for name, result in results.items():
        cells = []
        for key in ("cor_log_error", "twist_error"):
            figures = result.get(key)
            cells += [f"{figures[k]:.4f}" if figures else "-" for k in ("mean", "sd", "max")]
        rows.append([name, f"{result['rebounded']} of {result['rigs']}", *cells])
    spread = ("|ln e/e_ref| mean", "sd", "max", "twist error mean", "sd", "max")
    report.table(
        ("method", "rebounded", *spread),
        rows,
        "First contact with the platform's servo: masses of 0.3 to 100 t, 1 to 6 Hz, 2 to 20 ms, "
        "hits up to 0.1 m off the axis, tilted, rotating and sliding with friction. Twist error: "
        "error of a body's change of velocity relative to that change, the worst of both bodies, "
        "linear and angular.",
    )
