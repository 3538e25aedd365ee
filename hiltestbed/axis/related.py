"""Whether the two signals of a record have to do with each other.

Slow signals resemble each other by chance: a random walk has a trend, and follows a part of any
sine (C. W. J. Granger, P. Newbold, J. Econometrics 2, 1974). A force or a position is therefore
explained by the recorded motion and by motions that did not happen, which are as slow: the recorded
one at other paces.
"""

from __future__ import annotations

import numpy as np

from hiltestbed.axis.motion import even, motion_of
from hiltestbed.frames import Array

# of the recorded pace, and as much faster: by chance, one of 21 motions is the best
PACES = np.geomspace(0.4, 0.8, 10)
LESS = 0.8  # of what the best of them leaves: the recorded motion explains more than chance does
ROWS = 4000  # of a record that are compared


def related(t: Array, x: Array, other: Array) -> bool:
    """Whether the motion (N,) through positions ``x`` explains the signal ``other`` better than
    the same motion at other paces does.
    """
    t, x, other = even(t, x, other)
    m = motion_of(t, x)
    rows = np.arange(0.0, len(t), -(-len(t) // ROWS))
    columns = np.column_stack([m.x, m.v, m.a, m.way, m.x * np.abs(m.x), m.v * np.abs(m.v)])
    at = [_folded(pace * rows, len(t)) for pace in (1.0, *PACES, *1.0 / PACES)]
    left = [_left(columns[some], other[at[0]]) for some in at]
    return left[0] < LESS * min(left[1:])


def _folded(at: Array, count: int) -> np.ndarray:
    """Rows (N,) of a record that runs back where it ends."""
    back = np.rint(at).astype(int) % (2 * count - 2)
    return np.minimum(back, 2 * count - 2 - back)


def _left(columns: Array, y: Array) -> float:
    """Mean square of ``y`` (N,) that no sum of columns, a constant and a trend explains."""
    full = np.column_stack([columns, np.ones(len(y)), np.arange(len(y))])
    scaled = full / np.maximum(np.abs(full).max(axis=0), 1e-300)
    found = np.linalg.lstsq(scaled, y, rcond=None)[0]
    return float(np.mean((y - scaled @ found) ** 2))
