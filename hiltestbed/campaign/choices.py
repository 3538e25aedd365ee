"""The keys of a campaign that choose between things rather than vary a number, and what each choice comes to."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hiltestbed.campaign.columns import is_numeric
from hiltestbed.campaign.schema import LoadedCampaign
from hiltestbed.frames import Array


@dataclass(frozen=True, eq=False)
class Choice:
    """One combination of the campaign's choices.

    Attributes:
        label: its values in words. cases: ``(n,)`` bool, the cases that have it.
    """

    label: str
    cases: np.ndarray


@dataclass(frozen=True)
class Result:
    """What a choice comes to.

    Attributes:
        cases, completed, active: how many there are, completed, and rebounded faster than they came.
        median, worst: of the figure's magnitude over the completed cases: median and 95 % quantile; None where none has the figure.
        best: whether it has the largest share of completed cases, and among those the smallest worst figure.
    """

    label: str
    cases: int
    completed: int
    active: int
    median: float | None
    worst: float | None
    best: bool = False


def choices_of(campaign: LoadedCampaign, table: Any) -> list[Choice]:
    """Every combination of the campaign's choices that its cases have; a single one, without a label, where there are none."""
    keys = [key for key, variation in campaign.spec.vary.items() if not is_numeric(variation)]
    if not keys:
        return [Choice("", np.ones(table.num_rows, dtype=bool))]
    columns = [table[key].to_pylist() for key in keys]
    combinations = list(zip(*columns, strict=True))
    return [
        Choice(", ".join(map(in_words, values)), np.array([case == values for case in combinations]))
        for values in dict.fromkeys(combinations)
    ]


def in_words(cell: str) -> str:
    """A value as the table has it, without the punctuation of JSON: `{"kind": "phase_lead", "lag": 0.001}` as `phase_lead (lag 0.001)`."""
    try:
        value = json.loads(cell)
    except (json.JSONDecodeError, TypeError):
        return str(cell)
    if not isinstance(value, dict) or "kind" not in value:
        return cell if not isinstance(value, str) else value
    rest = ", ".join(f"{key} {part}" for key, part in value.items() if key != "kind")
    return f"{value['kind']} ({rest})" if rest else str(value["kind"])


def results(choices: Sequence[Choice], statuses: np.ndarray, cor: Array, figure: Array) -> list[Result]:
    """What each choice comes to, best first. statuses: ``(n,)`` text; cor, figure: ``(n,)``."""
    out = []
    for choice in choices:
        good = choice.cases & (statuses == "completed") & np.isfinite(figure)
        size = np.abs(figure[good])
        median, worst = (float(v) for v in np.quantile(size, [0.5, 0.95])) if size.size else (None, None)
        completed = int((choice.cases & (statuses == "completed")).sum())
        out.append(Result(choice.label, int(choice.cases.sum()), completed, int((cor[choice.cases] > 1.0).sum()), median, worst))
    out.sort(key=lambda r: (-r.completed / r.cases, np.inf if r.worst is None else r.worst))
    if out[0].worst is not None and len(out) > 1:
        out[0] = Result(**(vars(out[0]) | {"best": True}))
    return out
