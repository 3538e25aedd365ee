"""The columns of cases.parquet. They depend on the campaign alone, so that all its chunks have the
same columns.

The categorical keys of a campaign (those that select alternatives rather than vary a number), and
the results of each choice.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hiltestbed.campaign.schema import Campaign, LoadedCampaign, Variation
from hiltestbed.frames import Array
from hiltestbed.signals import AXES

_TEXT = ("name", "scenario_sha256", "status", "stop_reason", "outcome", "limits_worst")
_COUNTS = ("seed", "contacts")
_FIGURES = (
    "cor",
    "cor_reference",
    "cor_log_error",
    "cor_normal",
    "cor_normal_reference",
    "cor_normal_log_error",
    "cor_log_error_predicted",
    "approach_speed",
    "approach_energy",
    "rebound_speed",
    "energy_generated",
    "energy_reference",
    "energy_resolution",
    "peak_force",
    "contact_duration",
    "first_contact",
    "captured_at",
    "impulse",
    "tracking_error",
    "tracking_compliance",
    "limits_share",
)
SCALARS = (*_TEXT, *_COUNTS, *_FIGURES)
ESTIMATES = tuple(
    f"identification.{axis}.{quantity}" for axis in AXES for quantity in ("stiffness", "damping")
)


def schema(campaign: Campaign):
    """The pyarrow schema: case, varied keys, scalars of the summary, error, hash of the trace."""
    import pyarrow as pa

    fields = [pa.field("case", pa.int64())]
    fields += [
        pa.field(key, pa.float64() if is_numeric(variation) else pa.string())
        for key, variation in campaign.vary.items()
    ]
    taken = {field.name for field in fields}
    columns = [(name, pa.string()) for name in _TEXT] + [(name, pa.int64()) for name in _COUNTS]
    columns += [(name, pa.float64()) for name in (*_FIGURES, "delay_total", *ESTIMATES)]
    columns += [("error", pa.string()), ("trace_sha256", pa.string())]
    fields += [pa.field(name, kind) for name, kind in columns if name not in taken]
    return pa.schema(fields)


def is_numeric(variation: Variation) -> bool:
    """Whether a key's values are numbers."""
    return variation.values is None or all(
        isinstance(v, int | float) and not isinstance(v, bool) for v in variation.values
    )


def cell(variation: Variation, value: Any) -> float | str:
    """A varied value as stored in the table: a number, a text, anything else as JSON."""
    if is_numeric(variation):
        return float(value)
    return value if all(isinstance(v, str) for v in variation.values or ()) else json.dumps(value)


def row(
    campaign: Campaign,
    case: int,
    values: dict[str, Any],
    summary: dict[str, Any] | None,
    error: str | None,
    trace: str | None,
) -> dict:
    """One case as column name to value; null for figures that the case lacks."""
    cells: dict[str, Any] = {"case": case, "seed": values["seed"], "error": error}
    cells |= {"trace_sha256": trace, "status": "invalid"}
    if summary is not None:
        cells |= {name: summary[name] for name in SCALARS}
        cells["error"] = error if error is not None else summary["stop_reason"]
        cells["delay_total"] = summary["delay_ledger"][-1]["delay"]
        for name in ESTIMATES:
            _, axis, quantity = name.split(".")
            cells[name] = summary["identification"][axis][quantity]
    for key, variation in campaign.vary.items():
        cells[key] = cell(variation, values[key])
    return cells


def table(campaign: Campaign, rows: list[dict[str, Any]]):
    """Rows as a pyarrow table in case order."""
    import pyarrow as pa

    layout = schema(campaign)
    ordered = sorted(rows, key=lambda cells: cells["case"])
    return pa.Table.from_pylist(ordered, schema=layout)


@dataclass(frozen=True, eq=False)
class CaseGroup:
    """One combination of the campaign's choices.

    Attributes:
        label: its values as text. cases: ``(n,)`` bool, the cases with this choice.
    """

    label: str
    cases: np.ndarray


@dataclass(frozen=True)
class Result:
    """The result of a choice.

    Attributes:
        cases, completed, active: number of cases, of those that completed, and of those that
            rebounded faster than they approached.
        median, worst: median and 95 % quantile of the figure's magnitude over the completed cases;
            None if none has the figure.
        best: whether it has the largest share of completed cases and, among choices with that
            share, the smallest worst figure.
    """

    label: str
    cases: int
    completed: int
    active: int
    median: float | None
    worst: float | None
    best: bool = False


def choices_of(campaign: LoadedCampaign, table: Any) -> list[CaseGroup]:
    """Every combination of the campaign's choices in its cases; one without a label if none."""
    keys = [key for key, variation in campaign.spec.vary.items() if not is_numeric(variation)]
    if not keys:
        return [CaseGroup("", np.ones(table.num_rows, dtype=bool))]
    columns = [table[key].to_pylist() for key in keys]
    combinations = list(zip(*columns, strict=True))
    return [
        CaseGroup(
            ", ".join(map(in_words, values)), np.array([case == values for case in combinations])
        )
        for values in dict.fromkeys(combinations)
    ]


def in_words(cell: str) -> str:
    """A value without JSON syntax: `{"kind": "lead", "lag": 0.001}` is `lead (lag 0.001)`."""
    try:
        value = json.loads(cell)
    except (json.JSONDecodeError, TypeError):
        return str(cell)
    if not isinstance(value, dict) or "kind" not in value:
        return cell if not isinstance(value, str) else value
    rest = ", ".join(f"{key} {part}" for key, part in value.items() if key != "kind")
    return f"{value['kind']} ({rest})" if rest else str(value["kind"])


def results(
    choices: Sequence[CaseGroup], statuses: np.ndarray, cor: Array, figure: Array
) -> list[Result]:
    """The results of each choice, best first. statuses: ``(n,)`` text; cor, figure: ``(n,)``."""
    out = []
    for choice in choices:
        good = choice.cases & (statuses == "completed") & np.isfinite(figure)
        size = np.abs(figure[good])
        median, worst = (
            (float(v) for v in np.quantile(size, [0.5, 0.95])) if size.size else (None, None)
        )
        completed = int((choice.cases & (statuses == "completed")).sum())
        counts = (int(choice.cases.sum()), completed, int((cor[choice.cases] > 1.0).sum()))
        out.append(Result(choice.label, *counts, median, worst))
    out.sort(key=lambda r: (-r.completed / r.cases, np.inf if r.worst is None else r.worst))
    if out[0].worst is not None and len(out) > 1:
        out[0] = replace(out[0], best=True)
    return out
