"""report.html of a campaign: what came out, over which keys, how it spreads, what moves it, and which cases to look at."""

from __future__ import annotations

import shlex
from collections import Counter
from pathlib import Path

import numpy as np

from hiltestbed.campaign.columns import is_numeric
from hiltestbed.campaign.schema import LoadedCampaign, Variation
from hiltestbed.campaign.sensitivity import explained_share, first_order_indices
from hiltestbed.errors import MissingExtra
from hiltestbed.frames import Array
from hiltestbed.report import Report

REPORT = "report.html"
SHOWN = ("cor", "cor_log_error", "energy_generated", "peak_force", "contact_duration", "tracking_error")
WORST = 10
_HELD = ("case", "status", "error", "outcome", *SHOWN)


def write_report(folder: Path, campaign: LoadedCampaign) -> None:
    """Writes report.html from the folder's cases.parquet; holds the numeric columns that it shows, no more."""
    import pyarrow.parquet as pq

    cases = pq.read_table(folder / "cases.parquet", columns=[*_HELD, *campaign.spec.vary])
    figures = {name: cases[name].to_numpy(zero_copy_only=False).astype(float) for name in SHOWN}
    inputs = {key: _numbers(variation, cases[key]) for key, variation in campaign.spec.vary.items()}
    response = "cor_log_error" if np.isfinite(figures["cor_log_error"]).any() else "peak_force"
    statuses = Counter(cases["status"].to_pylist())
    report = Report(f"Campaign {campaign.spec.name or campaign.path.stem}")
    report.lead(_finding(statuses, figures[response], response))
    outcomes = Counter(outcome for outcome in cases["outcome"].to_pylist() if outcome is not None)
    if outcomes:
        report.text("Outcomes: " + ", ".join(f"{count} {outcome}" for outcome, count in outcomes.most_common()) + ".")
    _response(report, campaign, inputs, figures, response)
    report.heading("Distributions")
    from hiltestbed.campaign.figures import distributions

    spread = {name: figure for name, figure in figures.items() if np.isfinite(figure).any() and np.ptp(figure[np.isfinite(figure)]) > 0.0}
    if spread:
        report.figure(distributions(spread), "Middle 99 % of the cases that have the figure.")
    _sensitivities(report, inputs, figures)
    _worst(report, campaign, cases, figures[response], response, folder)
    partial = folder / f"{REPORT}.partial"
    report.write(partial)
    partial.replace(folder / REPORT)


def _numbers(variation: Variation, column) -> Array:
    """A varied key as numbers; values that are none, by their place in the list."""
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
    return f"{sum(statuses.values())} cases: {ended}. {name}: median {middle:.4g}, 5 % below {low:.4g}, 5 % above {high:.4g}."


def _response(report: Report, campaign: LoadedCampaign, inputs: dict[str, Array], figures: dict[str, Array], name: str) -> None:
    """The heat map over the two keys that move the figure most."""
    numeric = [key for key in inputs if is_numeric(campaign.spec.vary[key]) and np.unique(inputs[key][:1000]).size > 1]
    figure = figures[name]
    if len(numeric) < 2 or not np.isfinite(figure).any():
        return
    from hiltestbed.campaign.figures import heat_map

    first, second = sorted(numeric, key=lambda key: -explained_share(inputs[key], figure))[:2]
    picture, drawn = heat_map(campaign, (first, second), (inputs[first], inputs[second]), figures, name)
    report.heading(f"{name} over {first} and {second}")
    lines = (
        " The lines are closed forms: beyond the full one a contact that stays closed grows; on the dashed one a bounce returns its "
        "speed, e = 1, which for a contact that cannot pull comes earlier."
    )
    report.figure(picture, f"Mean over the cases of each cell; the two keys that move {name} most." + (lines if drawn else ""))


def _sensitivities(report: Report, inputs: dict[str, Array], figures: dict[str, Array]) -> None:
    report.heading("What moves a figure")
    keys = list(inputs)
    matrix = np.stack([inputs[key] for key in keys], axis=1)
    try:
        found = {name: first_order_indices(keys, matrix, figure) for name, figure in figures.items()}
    except MissingExtra as error:
        report.text(f"Sobol indices are left out: {error}")
        return
    rows = []
    for name, indices in found.items():
        if indices:
            by_key = {index.key: index for index in indices}
            rows.append([name, *(f"{by_key[key].first_order:.2f} ± {by_key[key].half_width:.2f}" for key in keys)])
    if rows:
        caption = "First-order Sobol indices (RBD-FAST): the share of a figure's variance that a key explains alone; what a row lacks "
        report.table(["figure", *keys], rows, caption + "to 1 is interaction and noise.")
    else:
        report.text("Too few cases for Sobol indices.")


def _worst(report: Report, campaign: LoadedCampaign, cases, figure: Array, name: str, folder: Path) -> None:
    """Cases that did not complete, then those with the largest figure, with the command that repeats each."""
    failed = [i for i, status in enumerate(cases["status"].to_pylist()) if status != "completed"]
    magnitude = np.where(np.isfinite(figure), np.abs(figure), -1.0)
    largest = [int(i) for i in np.argsort(-magnitude, kind="stable")[:WORST] if magnitude[i] >= 0]
    report.heading("Worst cases")
    keys = list(campaign.spec.vary)
    rows = []
    for i in dict.fromkeys([*failed[:WORST], *largest]):
        record = cases.slice(i, 1).to_pylist()[0]
        cells = [f"{record[key]:.6g}" if isinstance(record[key], float) else str(record[key]) for key in keys]
        rows.append([record["case"], *cells, record["error"] or record["status"], _figure(record[name]), _command(i, folder)])
    report.table(["case", *keys, "ended", name, "to repeat it in full"], rows)
    if len(failed) > WORST:
        report.text(f"{len(failed) - WORST} more cases did not complete; cases.parquet has their reasons in the column error.")


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _command(case: int, folder: Path) -> str:
    """Repeats a case from the campaign as it was run, which lies in the folder of the results."""
    file, out = folder / "campaign.yaml", f"{folder.name}-case-{case}"
    return f"hiltestbed run {shlex.quote(str(file))} --case {case} --out {shlex.quote(out)}"
