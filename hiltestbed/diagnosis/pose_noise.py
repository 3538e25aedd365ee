"""Stage "layout": correlated noise of a measured pose, as of a logger that interpolates each row
between two samples.

Third differences, which separate the noise of a pose from its motion, show little of such noise.
Free flight shows all of it; in a mechanism that is latched from the start, the axes at rest do,
less their command, which the latch's springs and the loop's noise move.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hiltestbed.diagnosis.free_flight import TOUCH_MARGIN_ROWS, first_touch
from hiltestbed.diagnosis.noise import POSE_PARTS, moved_axes
from hiltestbed.diagnosis.settings import MIN_NOISE_ROWS, SIGNIFICANCE_SIGMA
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredRun
from hiltestbed.measured.noise import white_noise
from hiltestbed.signals import GROUPS

# chosen: of the polynomial that is taken off as motion: the noise of the force moves a body like a
# random walk
MOTION_DEGREE = 3
# chosen: of the correlation of neighbours, that rows further apart may have by chance
MAX_FAR_CORRELATION = 0.3
# chosen: rows at which interpolated noise is no longer correlated, while a non-uniform motion is
FAR_LAGS = (2, 3, 4)


def smooth_levels(runs: Sequence[MeasuredRun]) -> dict[str, float]:
    """Channel of pose_act to the root of the spectral density of its noise at low frequency [its
    unit], where rows lie between two samples.

    Smooth departures are judged by that level: for rows ``(1 - p) w_k + p w_(k-1)`` it is that of
    the samples ``w``. Empty where neighbours
    are not correlated, or rows further apart are too: that is a motion. Then the axes at rest may
    show it; one that moves is taken to have as much of it above third differences as those have. In
    a latched mechanism it always is.
    """
    moving = sorted({POSE_PARTS[j] for run in runs for j in moved_axes(run)})
    latched = any(run.scenario.mechanism.captured for run in runs)
    return (_levels(runs, ()) if not latched else {}) or _levels(runs, moving)


def _levels(runs: Sequence[MeasuredRun], moving: Sequence[str]) -> dict[str, float]:
    """:func:`smooth_levels`, with those of the ``moving`` axes by the others'."""
    names = [name for name in GROUPS["pose_act"].columns if name.rpartition(".")[2] not in moving]
    free = {
        name: [x for run in runs if len(x := _free(run, name)) > max(FAR_LAGS)] for name in names
    }
    level = {name: float(np.sqrt(np.mean(np.concatenate(x) ** 2))) for name, x in free.items() if x}
    units = [[x / level[name] for x in free[name]] for name in level if level[name] > 0.0]
    samples = sum(len(x) for channel in units for x in channel)
    if samples < MIN_NOISE_ROWS * max(len(units), 1):
        return {}
    # by the polynomials, from each correlation
    taken = (MOTION_DEGREE + 1) * sum(map(len, units)) / samples
    first, *others = (
        sum(float(x[lag:] @ x[:-lag]) for channel in units for x in channel) / samples + taken
        for lag in (1, *FAR_LAGS)
    )
    chance = SIGNIFICANCE_SIGMA / math.sqrt(samples)
    if first < chance or max(map(abs, others)) > max(chance, MAX_FAR_CORRELATION * first):
        return {}
    found = {
        name: value * math.sqrt((1.0 + 2.0 * first) / (1.0 - taken))
        for name, value in level.items()
    }
    if not moving:
        return found
    white = {f"pose_act.{part}": _white(runs, f"pose_act.{part}") for part in POSE_PARTS}
    above = float(np.median([found[name] / white[name] for name in found if white.get(name)]))
    return found | {
        name: above * white[name] for part in moving if (name := f"pose_act.{part}") in white
    }


def _free(run: MeasuredRun, name: str) -> Array:
    """(n,) of the channel before the first touch; of a latched mechanism all of it, less its
    command. Slow motion is taken off.
    """
    if not run.record.has(name):
        return np.zeros(0)
    latched, told = run.scenario.mechanism.captured, name.replace("act", "cmd")
    end = run.record.ticks if latched else first_touch(run)
    values = run.record.column(name)[TOUCH_MARGIN_ROWS:end]
    if latched and run.record.has(told):  # which is reached a row later
        values = values - run.record.column(told)[TOUCH_MARGIN_ROWS - 1 : end - 1]
    values = values[np.isfinite(values)]
    if len(values) <= max(FAR_LAGS):
        return np.zeros(0)
    rows = np.linspace(-1.0, 1.0, len(values))
    slow = np.polynomial.polynomial.polyfit(rows, values, MOTION_DEGREE)
    return np.asarray(values - np.polynomial.polynomial.polyval(rows, slow))


def _white(runs: Sequence[MeasuredRun], name: str) -> float:
    """White noise of the channel by third differences, rms over the runs."""
    found = [white_noise(run.record.column(name)) for run in runs if run.record.has(name)]
    return float(np.sqrt(np.mean(np.square(found)))) if found else 0.0
