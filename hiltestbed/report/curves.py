"""Colours of curves, and contacts shaded behind them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Okabe and Ito's palette: distinguishable with any of the common colour-vision deficiencies
PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")

POINTS = 4000  # of a curve: more cannot be distinguished
LEAST = 0.02  # [s] that is shown before and after a contact, at least


def span_of_contact(t: np.ndarray, contact: np.ndarray) -> tuple[float, float]:
    """[s] the contacts and a quarter of their duration on each side; all of ``t`` ``(rows,)`` [s]
    where ``contact`` ``(rows,)`` is nowhere true.
    """
    start, end, touching = float(t[0]), float(t[-1]), t[contact]
    if not len(touching):
        return start, end
    first, last = float(touching[0]), float(touching[-1])
    margin = max(0.25 * (last - first), LEAST)
    return max(start, first - margin), min(end, last + margin)


def shade_contacts(axes: Axes, t: np.ndarray, contact: np.ndarray) -> None:
    """Shade the times ``t`` ``(rows,)`` [s] at which ``contact`` ``(rows,)`` is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], contact, [False]]).astype(np.int8)))
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        axes.axvspan(float(t[start]), float(t[min(end, len(t) - 1)]), color="#e9edf1", zorder=0)
