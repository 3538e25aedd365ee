"""The categorical keys of a campaign (those that select alternatives rather than vary a number),
and the results of each choice.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hiltestbed.campaign.columns import is_numeric
from hiltestbed.campaign.schema import LoadedCampaign
from hiltestbed.frames import Array


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
