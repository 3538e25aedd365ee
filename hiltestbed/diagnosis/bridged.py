"""What a log does not hold, samples that were lost and ticks between its rows, and how uncertain that makes what is computed from it.

A lost sample is bridged, which misses it by what second differences of its neighbours show: of white noise the two have the same
variance but for a factor of four. The numerical model integrates it twice, so that it is replayed with such misses drawn at random.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d

from hiltestbed.diagnosis.links import DynamicsLink, Link
from hiltestbed.diagnosis.settings import SMOOTHING
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredRun
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


def bridging_noise(
    link: DynamicsLink, wrenches: Sequence[Array], missing: Sequence[np.ndarray], between: Sequence[Array], level: Array
) -> list[Array]:
    """``(N, 6)`` by how much the motion of each run may be off [m, rad].

    wrenches: (N, 6) bridged; missing: (N,) bool. between: (N, 6) not 0 on ticks that no row of the log stands on; level: (6,) the noise
    there. A row apart from what two others say of it is off by ``sqrt(1 + 2/3)`` of the noise, the mean over the places between them.
    """
    rng, everything = np.random.default_rng(0), range(len(link.runs))
    squares = [np.zeros((run.rows, 6)) for run in link.runs]
    spread = [np.hypot(_miss(w, m), math.sqrt(5.0 / 3.0) * level * (b != 0.0)) for w, m, b in zip(wrenches, missing, between, strict=True)]
    if not any(s.any() for s in spread):
        return squares
    shown = link.predict([(i, ()) for i in everything])
    for _ in range(DRAWS):
        shaken = [w + s * rng.standard_normal(w.shape) for w, s in zip(wrenches, spread, strict=True)]
        found = DynamicsLink(link.runs, shaken).predict([(i, ()) for i in everything])
        for total, a, b in zip(squares, found, shown, strict=True):
            total += (a - b) ** 2 / DRAWS
    return [SURE * np.sqrt(np.maximum.accumulate(s, axis=0)) for s in squares]


def bends_of(runs: Sequence[MeasuredRun], group: str, rows: Sequence[int]) -> list[Array]:
    """``(N, parts)`` of each run, see :class:`Record`; 0 where all rows of the group are ticks."""
    return [r.record.bends.get(group, np.zeros(r.record.data[group].shape))[:n] for r, n in zip(runs, rows, strict=True)]


def differences(link: Link, other: Link) -> list[Array]:
    """``(N, channels)`` of each run by how much two links differ about each row, rms: what lies between the rows of a log may be either."""
    everything = [(i, ()) for i in range(len(link.runs))]
    pairs = zip(link.predict(everything), other.predict(everything), strict=True)
    return [np.sqrt(np.maximum(uniform_filter1d((a - b) ** 2, SMOOTHING, axis=0), 0.0)) for a, b in pairs]


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
