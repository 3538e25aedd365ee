"""Noise of a measured pose whose neighbours go along: what a logger makes of it that puts each row between two samples.

Third differences, which tell the noise of a pose from its motion, show little of such noise. Free flight shows all of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hiltestbed.diagnosis.settings import ENOUGH_FREE, SIGNIFICANT
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredRun
from hiltestbed.signals import GROUPS

CLOSE = 2  # rows before the first touch that are no longer counted as free
LITTLE = 0.3  # of the correlation of neighbours, that rows further apart may have by chance
BEYOND = (2, 3, 4)  # rows, at which noise between two samples goes along no more, and a motion that is not uniform does


def smooth_levels(runs: Sequence[MeasuredRun]) -> dict[str, float]:
    """Channel of pose_act to the root of the spectral density of its noise at low frequency [its unit], where rows lie between two samples.

    That is the level by which smooth departures are judged: of ``(1 - p) w_k + p w_(k-1)`` that of the samples ``w`` themselves. Empty
    where neighbours do not go along, or rows further apart do as well: then it is a motion.
    """
    free = {name: [x for run in runs if len(x := _free(run, name)) > max(BEYOND)] for name in GROUPS["pose_act"].columns}
    level = {name: float(np.sqrt(np.mean(np.concatenate(x) ** 2))) for name, x in free.items() if x}
    units = [[x / level[name] for x in free[name]] for name in level if level[name] > 0.0]
    samples = sum(len(x) for channel in units for x in channel)
    if samples < ENOUGH_FREE * max(len(units), 1):
        return {}
    first, *others = (sum(float(x[lag:] @ x[:-lag]) for channel in units for x in channel) / samples for lag in (1, *BEYOND))
    chance = SIGNIFICANT / math.sqrt(samples)
    if first < chance or max(map(abs, others)) > max(chance, LITTLE * first):
        return {}
    return {name: value * math.sqrt(1.0 + 2.0 * first) for name, value in level.items()}


def _free(run: MeasuredRun, name: str) -> Array:
    """(n,) of the channel before the first touch, less a straight line."""
    if not run.record.has(name):
        return np.zeros(0)
    end = max(0, run.survey.contacts[0].start - CLOSE) if run.survey.contacts else run.record.ticks
    values = run.record.column(name)[CLOSE:end]
    values = values[np.isfinite(values)]
    if len(values) <= max(BEYOND):
        return np.zeros(0)
    rows = np.linspace(-1.0, 1.0, len(values))
    line = np.polynomial.polynomial.polyfit(rows, values, 1)
    return np.asarray(values - np.polynomial.polynomial.polyval(rows, line))
