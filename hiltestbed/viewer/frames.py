"""Selection of the rows of a trace that are drawn."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hiltestbed.signals import RunTrace

# [Hz] frame rates out of contact and in contact, which lasts a few hundredths of a second
FREE, CONTACT = 60.0, 240.0


def frame_rows(trace: RunTrace, rate: float) -> NDArray[np.intp]:
    """Rows at FREE, at CONTACT while the mechanisms touch, the first and the last, and the largest
    force; finite poses only.
    """
    ticks = len(trace.t)
    drawn = np.zeros(ticks, dtype=bool)
    drawn[_every(ticks, rate / FREE)] = True
    close = _every(ticks, rate / CONTACT)
    drawn[close[trace.contact[close]]] = True
    drawn[[0, -1]] = True
    force = np.linalg.norm(trace["wrench_true"][:, :3], axis=1)
    if trace.contact.any():
        drawn[int(np.argmax(np.where(np.isfinite(force), force, 0.0)))] = True
    return np.flatnonzero(
        drawn
        & np.isfinite(trace["pose_act"]).all(axis=1)
        & np.isfinite(trace["pose_cmd"]).all(axis=1)
    )


def _every(ticks: int, step: float) -> NDArray[np.intp]:
    """Every ``step``-th row; ``step`` need not be an integer."""
    return np.unique(
        np.round(np.arange(0.0, ticks, max(step, 1.0))).astype(np.intp).clip(max=ticks - 1)
    )
