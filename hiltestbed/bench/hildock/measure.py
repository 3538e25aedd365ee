"""`hiltestbed bench hildock [--quick] [--enter URL|FMU]`: the built-in entrants, and a foreign
one.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from hiltestbed.bench.hildock.door import entered
from hiltestbed.bench.hildock.methods import METHODS, shipped
from hiltestbed.bench.hildock.problem import (
    TRACKS,
    Entrant,
    by_track,
    cases,
    indices,
    play,
    reference,
)
from hiltestbed.bench.result import BenchResult, Progress, silent
from hiltestbed.report.page import Report, new_figure


def hildock(
    quick: bool = False, enter: str | None = None, progress: Progress = silent
) -> BenchResult:
    """All entrants on all cases; quick: on the cases that the page names for it; enter: a foreign
    one, and the short ones for comparison.

    Raises:
        HiltestbedError: the foreign entrant answered late, wrongly or not at all.
    """
    todo = cases(quick)
    foreign = entered(enter) if enter is not None else None
    entrants: list[Entrant] = [m() for m in METHODS]
    entrants = [foreign, *entrants] if foreign else [*entrants, *shipped()]
    work, ideal = len(entrants) * len(todo), [reference(c) for c in todo]
    records: list[dict[str, Any]] = []
    effort = {}
    try:
        for number, entrant in enumerate(entrants):
            begun, ticks = time.perf_counter(), 0
            for i, (case, right) in enumerate(zip(todo, ideal, strict=True)):
                course = play(case, entrant)
                ticks += len(course.force)
                records.append({"method": entrant.name, **indices(case, course, right)})
                progress(number * len(todo) + i + 1, work)
            effort[entrant.name] = 1e6 * (time.perf_counter() - begun) / ticks
    finally:
        if foreign is not None:
            foreign.close()
    names = [e.name for e in entrants]
    board = {n: by_track([r for r in records if r["method"] == n]) for n in names}
    summary = {"problem": "HILDOCK-1", "tracks": board, "tick_us": effort}
    lines = []
    for name in names:
        worst = {track: row["cor_log_error_worst"] for track, row in board[name].items()}
        over_all = None if None in worst.values() else max(worst.values())
        found = f"{_digits(worst['exact'])}, <= {_digits(over_all)} on every track"
        lines.append((name, f"|ln e/e_ref| <= {found}"))
    page = _report(names, summary, records, len(todo))
    return BenchResult("hildock", records, summary, page, lines)


def _digits(value: float | None) -> str:
    return "no rebound" if value is None else f"{value:.4g}"


def _entered_by_user(names: Sequence[str]) -> list[str]:
    """Of the entrants those that do not come with the benchmark: plugins, and foreign ones."""
    mine = {method.name for method in METHODS}
    return [n for n in names if n not in mine and not n.startswith("shipped ")]


def _peaks(records: Sequence[dict[str, Any]], names: Sequence[str]):
    figure, axis = new_figure(10, 4)
    exact = [r for r in records if r["track"] == "exact"]
    shown = [n for n in names if n in ("none", "phase_lead") or "resynchronised" in n]
    shown += _entered_by_user(names)
    for name in [*shown, "bound"]:
        mine = [r for r in exact if r["method"] == (names[0] if name == "bound" else name)]
        index = "peak_force_bound" if name == "bound" else "peak_force_error"
        known = [r for r in mine if r[index] is not None]
        w_tau = [2.0 * np.pi * r["frequency"] * r["delay"] for r in known]
        style = "k_" if name == "bound" else "."
        axis.plot(w_tau, [r[index] for r in known], style, label=name)
    axis.set(xscale="log", xlabel="w tau", ylabel="error of the peak force")
    axis.set_yscale("symlog", linthresh=0.01)
    axis.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), fontsize="small")
    return figure


def _report(
    names: Sequence[str], summary: dict[str, Any], records: Sequence[dict[str, Any]], todo: int
) -> Report:
    report = Report("HILDOCK-1")
    report.lead(
        f"{len(names)} entrants on {todo} cases of {len(TRACKS)} tracks; the problem is defined "
        "on the documentation's page HILDOCK-1."
    )
    board = summary["tracks"]
    for title, index in (
        ("Worst |ln(e/e_ref)|", "cor_log_error_worst"),
        ("Its 95th percentile", "cor_log_error_p95"),
        ("Energy made, worst, as a share of the approach energy", "energy_generated_worst"),
        ("Error of the peak force, worst", "peak_force_error_worst"),
    ):
        rows = [[t, *(_digits(board[n][t][index]) for n in names)] for t in TRACKS]
        report.table(["track", *names], rows, title)
    figure, axis = new_figure(10, 4)
    marks = "osv^D"  # with ten colours: fifty entrants are told apart
    for i, name in enumerate(names):
        worst = [board[name][t]["cor_log_error_worst"] or float("nan") for t in TRACKS]
        wide = 3.0 if name in _entered_by_user(names) else 1.0
        style = f"{marks[i // 10 % len(marks)]}-"
        axis.semilogy(TRACKS, worst, style, label=name, linewidth=wide, zorder=1.0 + wide)
    axis.set_ylabel("worst |ln(e/e_ref)|")
    axis.tick_params(axis="x", rotation=30)
    axis.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), fontsize="small")
    report.figure(figure, "Worst error of the coefficient of restitution, by track.")
    report.figure(
        _peaks(records, names),
        "Peak force of each case of the track `exact` as a function of w tau, and the least error "
        "that is possible before the delay has passed.",
    )
    report.text(
        "One tick of the loop with plant, entrant and, for a foreign one, its answer over the "
        "network: " + ", ".join(f"{n} {summary['tick_us'][n]:.1f} us" for n in names) + "."
    )
    return report
