"""Errors that only the log has: made after the loop, so that what the facility computed is not
computed from what is on record.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.random import Generator

from hiltestbed.signals import GROUPS

Columns = dict[str, np.ndarray]
Change = Callable[[Columns, Generator], Columns]
LONGEST_GAP = 4  # rows
KEPT_ENDS = 5  # rows at each end that are never lost


def lost(share: float) -> Change:
    """A ``share`` of the rows lost at random, in gaps of 1 to :data:`LONGEST_GAP` rows."""

    def change(columns: Columns, rng: Generator) -> Columns:
        rows = len(columns["t"])
        keep, k = np.ones(rows, dtype=bool), KEPT_ENDS
        begins = share / (1.0 - share) / (0.5 * (1 + LONGEST_GAP))
        while k < rows - KEPT_ENDS - LONGEST_GAP:
            if rng.random() < begins:
                gap = int(rng.integers(1, LONGEST_GAP + 1))
                keep[k : k + gap] = False
                k += gap
            k += 1
        return {name: values[keep] for name, values in columns.items()}

    return change


def of_the_reading(share: float, group: str = "wrench_meas") -> Change:
    """White noise of a ``share`` of each reading of a group."""

    def change(columns: Columns, rng: Generator) -> Columns:
        return columns | {
            name: columns[name] * (1.0 + share * rng.standard_normal(len(columns[name])))
            for name in GROUPS[group].columns
        }

    return change


def spikes(size: float, share: float, names: Sequence[str]) -> Change:
    """Spikes of ``size`` and either sign on a ``share`` of the rows."""

    def change(columns: Columns, rng: Generator) -> Columns:
        out = dict(columns)
        for name in names:
            hit = rng.random(len(out[name])) < share
            out[name] = out[name] + size * hit * rng.choice([-1.0, 1.0], len(hit))
        return out

    return change


def in_steps(size: float, names: Sequence[str]) -> Change:
    """Written in steps of ``size``."""

    def change(columns: Columns, rng: Generator) -> Columns:
        return columns | {name: np.round(columns[name] / size) * size for name in names}

    return change


def rewrite(folder: Path, change: Change, seed: int = 0) -> None:
    """Change the log of every run in ``folder``."""
    rng = np.random.default_rng(seed)
    for file in sorted(folder.glob("run_*.parquet")):
        table = pq.read_table(file)
        columns = {name: table[name].to_numpy() for name in table.column_names}
        pq.write_table(pa.table(change(columns, rng)), file)
