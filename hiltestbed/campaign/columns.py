"""The columns of cases.parquet. They depend on the campaign alone, so that all its chunks have the
same columns.
"""

from __future__ import annotations

import json
from typing import Any

from hiltestbed.campaign.schema import Campaign, Variation
from hiltestbed.signals import AXES

_TEXT = ("name", "scenario_sha256", "status", "stop_reason", "outcome")
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
