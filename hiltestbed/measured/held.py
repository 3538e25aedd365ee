"""Rows in which a logger repeats the previous row: all axes of a sensor, whose noise never stops,
have the same numbers again.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hiltestbed.frames import Array
from hiltestbed.measured.remark import Remark
from hiltestbed.signals import GROUPS

GROUP = "wrench_meas"
LEAST_AXES = 3  # that must be constant together
MOST = 0.2  # part of the rows; above it, the sensor is slower than its log and repeats most rows
LONGEST = 12  # successive rows; longer constant stretches are a sensor at rest


def without_held(run: int, values: Mapping[str, Array]) -> tuple[dict[str, Array], list[Remark]]:
    """The columns, with NaN in repeated rows of the force, and a remark on them."""
    names = [n for n in GROUPS[GROUP].columns if n in values]
    if len(names) < LEAST_AXES or len({len(values[n]) for n in names}) != 1:
        return dict(values), []
    rows = np.column_stack([values[n] for n in names])
    same = np.r_[False, (rows[1:] == rows[:-1]).all(axis=1)] & (rows != 0.0).any(axis=1)
    same &= ~_long(same)
    if not same.any() or same.mean() > MOST:
        return dict(values), []
    out = dict(values) | {n: np.where(same, np.nan, values[n]) for n in names}
    text = (
        f"repeats the previous row in {int(same.sum())} of {len(same)} rows on all axes: "
        f"held by the logger, and left out"
    )
    return out, [Remark("loss", run, GROUP, text, "", {"rows": float(same.sum())})]


def _long(same: np.ndarray) -> np.ndarray:
    """The rows in stretches of repeated rows longer than :data:`LONGEST`."""
    out = np.zeros(len(same), dtype=bool)
    edges = np.flatnonzero(np.diff(np.r_[False, same, False]))
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        out[start:end] = end - start > LONGEST
    return out
