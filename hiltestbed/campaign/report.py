"""report.html of a campaign: results per choice, maps over keys, sensitivities, worst cases."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hiltestbed.analysis.limits import BEYOND
from hiltestbed.campaign.columns import CaseGroup, choices_of, in_words, is_numeric, results
from hiltestbed.campaign.schema import FIGURES, LoadedCampaign, Variation
from hiltestbed.campaign.sensitivity import Sensitivity, explained_share, sensitivity
from hiltestbed.frames import Array
from hiltestbed.report.curves import PALETTE
from hiltestbed.report.page import Report
from hiltestbed.run_folder.folders import number, parquet_table

REPORT = "report.html"
WORST = 10
FACETS = 9  # maps side by side; with more choices, those of the best
# share of the variance of left-out cases that an expansion must explain for its indices to be shown
TRUSTED = 0.5
_HELD = ("case", "status", "error", "outcome", "limits_worst", *FIGURES)


@dataclass(frozen=True, eq=False)
class Cases:
    """The columns of cases.parquet that the report shows, ``(n,)`` each; only these are held in
    memory.

    Attributes:
        inputs: each varied key as numbers, other values by their index in the list.
        response: the figure by which choices are ranked.
    """

    campaign: LoadedCampaign
    table: Any
    statuses: np.ndarray
    inputs: dict[str, Array]
    figures: dict[str, Array]
    response: str

    @classmethod
    def read(cls, folder: Path, campaign: LoadedCampaign) -> Cases:
        vary = campaign.spec.vary
        table = parquet_table(folder / "cases.parquet", [*_HELD, *vary])
        figures = {n: table[n].to_numpy(zero_copy_only=False).astype(float) for n in FIGURES}
        known = "cor_log_error" if np.isfinite(figures["cor_log_error"]).any() else "peak_force"
        return cls(
            campaign,
            table,
            np.array(table["status"].to_pylist()),
            {key: _numbers(variation, table[key]) for key, variation in vary.items()},
            figures,
            campaign.spec.criterion or known,
        )

    @property
    def figure(self) -> Array:
        """The response."""
        return self.figures[self.response]

    def is_number(self, key: str) -> bool:
        return is_numeric(self.campaign.spec.vary[key])

    def numbers(self, keys: Sequence[str]) -> list[str]:
        """Those of the keys that are numbers and vary."""
        return [k for k in keys if self.is_number(k) and np.unique(self.inputs[k]).size > 1]


def write_report(folder: Path, campaign: LoadedCampaign) -> None:
    """Writes report.html from the folder's cases.parquet."""
    cases = Cases.read(folder, campaign)
    columns = np.stack(list(cases.inputs.values()), axis=1)
    are_choices = [not cases.is_number(key) for key in cases.inputs]
    found = {
        name: sensitivity(list(cases.inputs), columns, figure, are_choices)
        for name, figure in cases.figures.items()
    }
    report = Report(f"Campaign {campaign.spec.name or campaign.path.stem}")
    report.lead(_finding(cases))
    outcomes = Counter(o for o in cases.table["outcome"].to_pylist() if o is not None)
    if outcomes:
        counts = (f"{count} {o.replace('_', ' ')}" for o, count in outcomes.most_common())
        report.text(f"Outcomes: {', '.join(counts)}.")
    _active(report, cases.figures["cor"])
    _limits(report, cases.figures["limits_share"], cases.table["limits_worst"].to_pylist())
    order = _by_choice(report, cases)
    indices = found[cases.response]  # by total index if reliable, else by what each explains alone
    if indices is not None and indices.explained > TRUSTED:
        strongest = [i.key for i in sorted(indices.indices, key=lambda index: -index.total)]
    else:
        own = {key: explained_share(v, cases.figure) for key, v in cases.inputs.items()}
        strongest = sorted(own, key=lambda key: -own[key])
    _maps(report, cases, order, strongest)
    _marginals(report, cases, order, strongest)
    _sensitivities(report, list(cases.inputs), found)
    _worst(report, cases, folder)
    partial = folder / f"{REPORT}.partial"
    report.write(partial)
    partial.replace(folder / REPORT)


def _numbers(variation: Variation, column: Any) -> Array:
    if is_numeric(variation):
        return column.to_numpy()
    return column.combine_chunks().dictionary_encode().indices.to_numpy().astype(float)


def _finding(cases: Cases) -> str:
    good = cases.figure[np.isfinite(cases.figure)]
    counts = Counter(cases.statuses.tolist()).most_common()
    ended = f"{len(cases.statuses)} cases: {', '.join(f'{n} {status}' for status, n in counts)}."
    if not good.size:
        return f"{ended} None has a {cases.response}."
    low, middle, high = np.quantile(good, [0.05, 0.5, 0.95])
    return (
        f"{ended} {cases.response}: median {middle:.4g}, 5 % below {low:.4g}, 5 % above {high:.4g}."
    )


def _active(report: Report, cor: Array) -> None:
    known = int(np.isfinite(cor).sum())
    faster = int((cor > 1.0).sum())
    if known:
        rebounding = {0: "none rebounds", 1: "1 rebounds"}.get(faster, f"{faster} rebound")
        report.text(
            f"Of {known} cases with a rebound {rebounding} faster than the approach: e > 1, the "
            f"loop feeds energy in."
        )


def _limits(report: Report, share: Array, worst: list[str | None]) -> None:
    known = int(np.isfinite(share).sum())
    beyond = Counter(name for name, s in zip(worst, share, strict=True) if s > BEYOND)
    if known:
        which = ", ".join(f"{count} by {name}" for name, count in beyond.most_common())
        report.text(
            f"Of {known} cases {beyond.total() or 'none'} went beyond the limits"
            f"{f', most: {which}' if which else ''}."
        )


def _by_choice(report: Report, cases: Cases) -> list[CaseGroup]:
    """A table with one row per choice, best first; returns the choices in that order."""
    choices, name = choices_of(cases.campaign, cases.table), cases.response
    if len(choices) < 2:
        return choices
    ranked = results(choices, cases.statuses, cases.figures["cor"], cases.figure)
    report.heading("Results per choice")
    rows = [
        [
            f"{r.label} (best)" if r.best else r.label,
            r.cases,
            f"{100.0 * r.completed / r.cases:.0f} %",
            r.active,
            number(r.median),
            number(r.worst),
        ]
        for r in ranked
    ]
    report.table(
        ["choice", "cases", "completed", "e > 1", f"|{name}| median", "95 % quantile"],
        rows,
        f"Magnitude of {name} over the completed cases. Best: most cases completed, then the "
        "smallest 95 % quantile; another figure is chosen with `criterion` in the campaign.",
    )
    places = {choice.label: choice for choice in choices}
    return [places[r.label] for r in ranked]


def _maps(
    report: Report, cases: Cases, choices: Sequence[CaseGroup], strongest: Sequence[str]
) -> None:
    """The response over its two strongest numeric keys, one map per choice: the mean of each cell
    and, if other keys vary, its worst.
    """
    numeric = cases.numbers(strongest)
    if len(numeric) < 2 or not np.isfinite(cases.figure).any():
        return
    from hiltestbed.campaign.figures import heat_maps

    x, y, *others = numeric
    shown = choices[:FACETS]
    ordered = ", ".join(
        key if cases.is_number(key) else f"{key} (a choice)" for key in strongest[:3]
    )
    report.heading(f"{cases.response} over {x} and {y}")
    for worst in (False, True) if others else (False,):
        inputs, response = (cases.inputs[x], cases.inputs[y]), cases.response
        picture, drawn = heat_maps(
            cases.campaign, (x, y), inputs, cases.figures, response, shown, worst
        )
        words = ["Mean over the cases of each cell."]
        if worst:
            words = ["The case with the largest magnitude in each cell."]
        if others:
            words.append(f"Also varied within a cell: {', '.join(others)}.")
        if len(choices) > 1:
            words.append("One map per choice, never averaged over choices.")
        if len(shown) < len(choices):
            words.append(f"The best {len(shown)} of {len(choices)}.")
        words.append(
            f"The keys with the largest influence on {cases.response}, in this order: {ordered}."
        )
        if drawn:
            words.append(
                "The lines are closed forms: beyond the solid line the oscillation of a closed "
                "contact grows; on the dashed line a bounce rebounds with its approach speed, e = "
                "1, which for a contact that cannot pull happens earlier."
            )
        report.figure(picture, " ".join(words))


def _marginals(
    report: Report, cases: Cases, choices: Sequence[CaseGroup], strongest: Sequence[str]
) -> None:
    numeric = cases.numbers(strongest)
    if not numeric or np.isfinite(cases.figure).sum() < 8:
        return
    from hiltestbed.campaign.figures import marginals

    report.heading(f"{cases.response} over each key alone")
    shown = choices[: len(PALETTE)]
    some = {key: cases.inputs[key] for key in numeric[:6]}
    picture = marginals(cases.campaign, some, cases.figure, cases.response, shown)
    words = (
        "Line: median of the cases; band: from 5 % to 95 % of them, over all values of the other "
        "keys."
    )
    if len(shown) < len(choices):
        words += f" The best {len(shown)} of {len(choices)} choices."
    report.figure(picture, words)


def _sensitivities(
    report: Report, keys: Sequence[str], found: dict[str, Sensitivity | None]
) -> None:
    report.heading("Sensitivities")
    rows = []
    for name, one in found.items():
        if one is not None and one.explained > TRUSTED:
            cells = [f"{index.first_order:.2f} / {index.total:.2f}" for index in one.indices]
            rows.append([name, *cells, f"{100.0 * one.explained:.0f} %"])
    if rows:
        report.table(
            ["figure", *keys, "explained"],
            rows,
            "Sobol indices, first order / total: the share of a figure's variance that a key "
            "explains alone / with all interactions. From a polynomial expansion of the cases; "
            "last column: the share of the variance of left-out cases that it explains.",
        )
    else:
        report.text(
            "Too few cases for Sobol indices, or figures that are too discontinuous for a "
            "polynomial expansion."
        )


def _worst(report: Report, cases: Cases, folder: Path) -> None:
    """Cases that did not complete, those with the largest figure, the command to repeat a case."""
    failed = np.flatnonzero(cases.statuses != "completed")
    magnitude = np.where(np.isfinite(cases.figure), np.abs(cases.figure), -1.0)
    largest = [i for i in np.argsort(-magnitude, kind="stable")[:WORST] if magnitude[i] >= 0]
    chosen = list(dict.fromkeys(map(int, (*failed[:WORST], *largest))))
    report.heading("Worst cases")
    rows = []
    for i in chosen:
        record = cases.table.slice(i, 1).to_pylist()[0]
        cells = [
            f"{value:.6g}" if isinstance(value, float) else in_words(str(value))
            for value in (record[key] for key in cases.inputs)
        ]
        ended = record["error"] or record["status"]
        rows.append([record["case"], *cells, ended, number(record[cases.response])])
    report.table(["case", *cases.inputs, "ended", cases.response], rows)
    if chosen:
        report.text(
            f"To repeat a case in full, with its recording and its report, here case {chosen[0]}:"
        )
        file, out = folder / "campaign.yaml", f"{folder.name}-case-{chosen[0]}"
        report.code(
            f"hiltestbed run {shlex.quote(str(file))} --case {chosen[0]} --out {shlex.quote(out)}"
        )
    if len(failed) > WORST:
        report.text(
            f"{len(failed) - WORST} more cases did not complete; cases.parquet has their reasons "
            f"in the column error."
        )
