"""What samples of the force that a logger lost make uncertain of a motion that is computed from it.

A lost sample is bridged, which misses it by what second differences of its neighbours show: of white noise the two have the same
variance but for a factor of four. The numerical model integrates it twice, so that it is replayed with such misses drawn at random.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d

from hiltestbed.diagnosis.links import DynamicsLink
from hiltestbed.frames import Array
from hiltestbed.measured.record import Record

LONGEST = 5  # rows in a row that are bridged: past them what was lost is no noise
DRAWS = 12  # replays, from which a spread is read to a fifth
SURE = 3.0  # standard deviations: what is lost in a run makes one departure, which is no noise that averages out
NEIGHBOURS = 21  # rows about a lost one, whose second differences stand for its own


def lost(record: Record, group: str) -> np.ndarray:
    """``(ticks,)`` samples that are missing, which a log that is slower than the loop has none of."""
    return record.unknown(group, 0.0)


def bridges(record: Record, group: str) -> bool:
    """Whether samples of a group are missing in short gaps alone."""
    edges = np.flatnonzero(np.diff(np.r_[False, lost(record, group), False]))
    return bool((edges[1::2] - edges[::2] <= LONGEST).all())


def bridging_noise(link: DynamicsLink, wrenches: Sequence[Array], missing: Sequence[np.ndarray]) -> list[Array]:
    """``(N, 6)`` by how much the motion of each run may be off [m, rad]; wrenches: (N, 6) bridged; missing: (N,) bool."""
    rng, everything = np.random.default_rng(0), range(len(link.runs))
    squares = [np.zeros((run.rows, 6)) for run in link.runs]
    if not any(m.any() for m in missing):
        return squares
    spread = [_miss(w, m) for w, m in zip(wrenches, missing, strict=True)]
    shown = link.predict([(i, ()) for i in everything])
    for _ in range(DRAWS):
        shaken = [w + s * rng.standard_normal(w.shape) for w, s in zip(wrenches, spread, strict=True)]
        found = DynamicsLink(link.runs, shaken).predict([(i, ()) for i in everything])
        for total, a, b in zip(squares, found, shown, strict=True):
            total += (a - b) ** 2 / DRAWS
    return [SURE * np.sqrt(np.maximum.accumulate(s, axis=0)) for s in squares]


def _miss(wrench: Array, missing: np.ndarray) -> Array:
    """(N, 6) standard deviation [N, N m] by which a bridge misses each lost sample."""
    second = np.zeros_like(wrench)
    second[1:-1] = 0.25 * (wrench[2:] - 2.0 * wrench[1:-1] + wrench[:-2]) ** 2
    touched = missing | np.roll(missing, 1) | np.roll(missing, -1)
    known = np.where(touched, 0.0, 1.0)[:, None]
    weight = uniform_filter1d(known, NEIGHBOURS, axis=0)
    mean = uniform_filter1d(second * known, NEIGHBOURS, axis=0) / np.maximum(weight, 1.0 / NEIGHBOURS)
    kinks = np.maximum(np.roll(second, 1, axis=0), np.roll(second, -1, axis=0))  # where the bridge meets what was measured: a touch
    return np.sqrt(np.maximum(mean, 4.0 * kinks)) * missing[:, None]
