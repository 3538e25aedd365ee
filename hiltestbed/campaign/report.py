"""report.html of a campaign: results per choice, maps over the keys, sensitivities, and the worst
cases.
"""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hiltestbed.campaign.choices import CaseGroup, choices_of, in_words, results
from hiltestbed.campaign.columns import is_numeric
from hiltestbed.campaign.schema import FIGURES, LoadedCampaign, Variation
from hiltestbed.campaign.sensitivity import Sensitivity, explained_share, sensitivity
from hiltestbed.frames import Array
from hiltestbed.report.page import Report
from hiltestbed.run_folder.folders import parquet_table

REPORT = "report.html"
WORST = 10
FACETS = 9  # maps side by side; with more choices, those of the best
# share of the variance of left-out cases that an expansion must explain for its indices to be shown
TRUSTED = 0.5
_HELD = ("case", "status", "error", "outcome", *FIGURES)


def write_report(folder: Path, campaign: LoadedCampaign) -> None:
    """Writes report.html from the folder's cases.parquet; only the numeric columns that it shows
    are held in memory.
    """

    cases = parquet_table(folder / "cases.parquet", [*_HELD, *campaign.spec.vary])
    figures = {name: cases[name].to_numpy(zero_copy_only=False).astype(float) for name in FIGURES}
    inputs = {key: _numbers(variation, cases[key]) for key, variation in campaign.spec.vary.items()}
    response = campaign.spec.criterion or (
        "cor_log_error" if np.isfinite(figures["cor_log_error"]).any() else "peak_force"
    )
    statuses = np.array(cases["status"].to_pylist())
    choices = choices_of(campaign, cases)
    found = {
        name: sensitivity(
            list(inputs), np.stack(list(inputs.values()), axis=1), figure, _are_choices(campaign)
        )
        for name, figure in figures.items()
    }

    report = Report(f"Campaign {campaign.spec.name or campaign.path.stem}")
    report.lead(_finding(Counter(statuses.tolist()), figures[response], response))
    outcomes = Counter(outcome for outcome in cases["outcome"].to_pylist() if outcome is not None)
    if outcomes:
        report.text(
            "Outcomes: "
            + ", ".join(
                f"{count} {outcome.replace('_', ' ')}" for outcome, count in outcomes.most_common()
            )
            + "."
        )
    _active(report, figures["cor"])
    order = _by_choice(report, choices, statuses, figures, response)
    strongest = _strongest(inputs, figures[response], found[response])
    _maps(report, campaign, order, inputs, figures, response, strongest)
    _marginals(report, campaign, order, inputs, figures[response], response, strongest)
    _distributions(report, figures)
    _sensitivities(report, campaign, found)
    _worst(report, campaign, cases, statuses, figures[response], response, folder)
    partial = folder / f"{REPORT}.partial"
    report.write(partial)
    partial.replace(folder / REPORT)


def _are_choices(campaign: LoadedCampaign) -> list[bool]:
    return [not is_numeric(variation) for variation in campaign.spec.vary.values()]


def _numbers(variation: Variation, column) -> Array:
    """A varied key as numbers; non-numeric values by their index in the list."""
    if is_numeric(variation):
        return column.to_numpy()
    places = column.combine_chunks().dictionary_encode()
    return places.indices.to_numpy().astype(float)


def _finding(statuses: Counter[str], figure: Array, name: str) -> str:
    good = figure[np.isfinite(figure)]
    ended = ", ".join(f"{count} {status}" for status, count in statuses.most_common())
    if not good.size:
        return f"{sum(statuses.values())} cases: {ended}. None has a {name}."
    low, middle, high = np.quantile(good, [0.05, 0.5, 0.95])
    return (
        f"{sum(statuses.values())} cases: {ended}. {name}: median {middle:.4g}, 5 % "
        f"below {low:.4g}, 5 % above {high:.4g}."
    )


def _active(report: Report, cor: Array) -> None:
    known = np.isfinite(cor)
    faster = int((cor[known] > 1.0).sum())
    if known.any():
        rebounding = (
            "none rebounds" if not faster else "1 rebounds" if faster == 1 else f"{faster} rebound"
        )
        report.text(
            f"Of {int(known.sum())} cases with a rebound {rebounding} faster than the approach: e "
            f"> 1, the loop feeds energy in."
        )


def _by_choice(
    report: Report,
    choices: Sequence[CaseGroup],
    statuses: np.ndarray,
    figures: dict[str, Array],
    name: str,
) -> list[CaseGroup]:
    """A table with one row per choice, best first; returns the choices in that order."""
    if len(choices) < 2:
        return list(choices)
    ranked = results(choices, statuses, figures["cor"], figures[name])
    report.heading("Results per choice")
    rows = [
        [
            f"{r.label} (best)" if r.best else r.label,
            r.cases,
            f"{100.0 * r.completed / r.cases:.0f} %",
            r.active,
            _figure(r.median),
            _figure(r.worst),
        ]
        for r in ranked
    ]
    caption = (
        f"Magnitude of {name} over the completed cases. Best: most cases completed, "
        f"then the smallest 95 % quantile; another figure "
    )
    report.table(
        ["choice", "cases", "completed", "e > 1", f"|{name}| median", "95 % quantile"],
        rows,
        caption + "is chosen with `criterion` in the campaign.",
    )
    places = {choice.label: choice for choice in choices}
    return [places[r.label] for r in ranked]


def _strongest(inputs: dict[str, Array], figure: Array, found: Sensitivity | None) -> list[str]:
    """The keys, strongest first: by total index if the expansion is reliable, otherwise by the
    share that a key explains alone.
    """
    if found is not None and found.explained > TRUSTED:
        return [index.key for index in sorted(found.indices, key=lambda index: -index.total)]
    return sorted(inputs, key=lambda key: -explained_share(inputs[key], figure))


def _maps(
    report: Report,
    campaign: LoadedCampaign,
    choices: Sequence[CaseGroup],
    inputs: dict[str, Array],
    figures: dict[str, Array],
    name: str,
    strongest: Sequence[str],
) -> None:
    """The response over its two strongest numeric keys, one map per choice: the mean of each cell
    and, if other keys vary, its worst.
    """
    numeric = [
        key
        for key in strongest
        if is_numeric(campaign.spec.vary[key]) and np.unique(inputs[key][:1000]).size > 1
    ]
    if len(numeric) < 2 or not np.isfinite(figures[name]).any():
        return
    from hiltestbed.campaign.figures import heat_maps

    keys = (numeric[0], numeric[1])
    places = (inputs[keys[0]], inputs[keys[1]])
    shown = choices[:FACETS]
    report.heading(f"{name} over {keys[0]} and {keys[1]}")
    others = [key for key in numeric[2:]]
    for worst in (False, True) if others else (False,):
        picture, drawn = heat_maps(campaign, keys, places, figures, name, shown, worst=worst)
        report.figure(
            picture,
            _map_caption(campaign, name, strongest, others, len(choices), len(shown), worst, drawn),
        )


def _map_caption(
    campaign: LoadedCampaign,
    name: str,
    strongest: Sequence[str],
    others: Sequence[str],
    choices: int,
    shown: int,
    worst: bool,
    drawn: bool,
) -> str:
    words = [
        "The case with the largest magnitude in each cell."
        if worst
        else "Mean over the cases of each cell."
    ]
    if others:
        words.append(f"Also varied within a cell: {', '.join(others)}.")
    if choices > 1:
        words.append(
            "One map per choice, never averaged over choices."
            + (f" The best {shown} of {choices}." if shown < choices else "")
        )
    ordered = [
        key if is_numeric(campaign.spec.vary[key]) else f"{key} (a choice)" for key in strongest[:3]
    ]
    words.append(
        f"The keys with the largest influence on {name}, in this order: {', '.join(ordered)}."
    )
    if drawn:
        words.append(
            "The lines are closed forms: beyond the solid line the oscillation of a closed "
            "contact grows; on the dashed line a bounce "
            "rebounds with its approach speed, e = 1, which for a contact that cannot pull "
            "happens earlier."
        )
    return " ".join(words)


def _marginals(
    report: Report,
    campaign: LoadedCampaign,
    choices: Sequence[CaseGroup],
    inputs: dict[str, Array],
    figure: Array,
    name: str,
    strongest: Sequence[str],
) -> None:
    numeric = [
        key
        for key in strongest
        if is_numeric(campaign.spec.vary[key]) and np.unique(inputs[key]).size > 1
    ]
    if not numeric or np.isfinite(figure).sum() < 8:
        return
    from hiltestbed.campaign.figures import MARGINAL_CHOICES, marginals

    report.heading(f"{name} over each key alone")
    shown = choices[:MARGINAL_CHOICES]
    picture = marginals(campaign, {key: inputs[key] for key in numeric[:6]}, figure, name, shown)
    least = (
        f" The best {len(shown)} of {len(choices)} choices." if len(shown) < len(choices) else ""
    )
    report.figure(
        picture,
        f"Line: median of the cases; band: from 5 % to 95 % of them, over all values of the other "
        f"keys.{least}",
    )


def _distributions(report: Report, figures: dict[str, Array]) -> None:
    from hiltestbed.campaign.figures import distributions

    spread = {
        name: figure
        for name, figure in figures.items()
        if np.isfinite(figure).any() and np.ptp(figure[np.isfinite(figure)]) > 0.0
    }
    if spread:
        report.heading("Distributions")
        report.figure(distributions(spread), "Middle 99 % of the cases that have the figure.")


def _sensitivities(
    report: Report, campaign: LoadedCampaign, found: dict[str, Sensitivity | None]
) -> None:
    report.heading("Sensitivities")
    keys = list(campaign.spec.vary)
    rows = []
    for name, one in found.items():
        if one is not None and one.explained > TRUSTED:
            cells = [f"{index.first_order:.2f} / {index.total:.2f}" for index in one.indices]
            rows.append([name, *cells, f"{100.0 * one.explained:.0f} %"])
    if rows:
        caption = (
            "Sobol indices, first order / total: the share of a figure's variance that a key "
            "explains alone / with all interactions. From "
            "a polynomial expansion of the cases; last column: the share of the variance of "
            "left-out cases that it explains."
        )
        report.table(["figure", *keys, "explained"], rows, caption)
    else:
        report.text(
            "Too few cases for Sobol indices, or figures that are too discontinuous for a "
            "polynomial expansion."
        )


def _worst(
    report: Report,
    campaign: LoadedCampaign,
    cases,
    statuses: np.ndarray,
    figure: Array,
    name: str,
    folder: Path,
) -> None:
    """Cases that did not complete, then those with the largest figure, and the command to repeat a
    case.
    """
    failed = np.flatnonzero(statuses != "completed")
    magnitude = np.where(np.isfinite(figure), np.abs(figure), -1.0)
    largest = [int(i) for i in np.argsort(-magnitude, kind="stable")[:WORST] if magnitude[i] >= 0]
    report.heading("Worst cases")
    keys = list(campaign.spec.vary)
    rows = []
    chosen = list(dict.fromkeys([*(int(i) for i in failed[:WORST]), *largest]))
    for i in chosen:
        record = cases.slice(i, 1).to_pylist()[0]
        cells = [
            f"{record[key]:.6g}" if isinstance(record[key], float) else in_words(str(record[key]))
            for key in keys
        ]
        rows.append(
            [record["case"], *cells, record["error"] or record["status"], _figure(record[name])]
        )
    report.table(["case", *keys, "ended", name], rows)
    if chosen:
        report.text(
            f"To repeat a case in full, with its recording and its report, here case {chosen[0]}:"
        )
        report.code(_command(chosen[0], folder))
    if len(failed) > WORST:
        report.text(
            f"{len(failed) - WORST} more cases did not complete; cases.parquet has their reasons "
            f"in the column error."
        )


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _command(case: int, folder: Path) -> str:
    """The command that repeats a case, from the campaign.yaml in the results folder."""
    file, out = folder / "campaign.yaml", f"{folder.name}-case-{case}"
    return f"hiltestbed run {shlex.quote(str(file))} --case {case} --out {shlex.quote(out)}"
