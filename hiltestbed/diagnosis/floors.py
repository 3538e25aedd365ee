"""Stage "layout": the noise floor of every channel of a dataset.

Third differences separate the noise of a pose from its motion, but show little of correlated noise,
as of a logger that interpolates each row between two samples: free flight shows all of it; in a
mechanism that is latched from the start the axes at rest do, less their command, which the latch's
springs and the loop's noise move. Where nothing dithers a converter, quantisation errors that are
alike in many rows are no independent samples.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hiltestbed.diagnosis.free_flight import TOUCH_MARGIN_ROWS, first_touch
from hiltestbed.diagnosis.noise import POSE_PARTS, moved_axes, undithered
from hiltestbed.diagnosis.settings import MIN_NOISE_ROWS, SIGNIFICANCE_SIGMA
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredRun
from hiltestbed.measured.noise import white_noise
from hiltestbed.signals import GROUPS

MIN_FREE_ROWS = 30  # chosen: rows away from contacts from which a noise floor is estimated
# chosen: noise of one axis of translation over another's; stick-slip motion looks like noise
MAX_AXIS_NOISE_RATIO = 3.0
# simulated: relative error of white noise estimated by third differences of n rows, times the root
# of n
WHITE_NOISE_ERROR = 1.5

# derived: [rows] of repeating quantisation errors; longer ones average out to less than an eighth
# of a step
LONGEST_PERIOD = 4
# chosen: equal changes in a row; errors that repeat less often pass through a whole step within a
# contact
MIN_REPETITIONS = 32
# chosen: of the polynomial that is taken off as motion: the noise of the force moves a body like a
# random walk
MOTION_DEGREE = 3
# chosen: of the correlation of neighbours, that rows further apart may have by chance
MAX_FAR_CORRELATION = 0.3
# chosen: rows at which interpolated noise is no longer correlated, while a non-uniform motion is
FAR_LAGS = (2, 3, 4)


def floors(runs: Sequence[MeasuredRun]) -> dict[str, float]:
    """Channel to noise floor, by third differences away from contacts, pooled over the runs."""
    out, smooth = {}, smooth_levels(runs)
    for name in dict.fromkeys(c for r in runs for c in r.record.columns()):
        there = [r for r in runs if r.record.has(name)]
        found, still = zip(*(_floor(r, name) for r in there), strict=True)
        level = float(np.sqrt(np.mean(np.square(found))))
        # a dead zone, or a sensor that is off between contacts
        if name.startswith("wrench_meas") and sum(still) * 2 > len(runs):
            level = _level_inside(runs, name)
        # of a force: in its colour
        pose = name.startswith("pose_act")
        sampled = [r.record.sampled.get(name, 0.0) for r in runs] if pose else []
        out[name] = max(level, smooth.get(name, 0.0), *sampled)
    places = [n for n in ("pose_act.px", "pose_act.py", "pose_act.pz") if out.get(n)]
    for name in places:  # stick-slip looks like noise on the axis that moves most
        out[name] = min(out[name], MAX_AXIS_NOISE_RATIO * min(out[n] for n in places))
    turned = [(f"pose_act.r{axis}", f"pose_act.q{axis}") for axis in "xyz"]
    return out | {r: 2.0 * out[q] for r, q in turned if q in out}


def _floor(run: MeasuredRun, name: str) -> tuple[float, bool]:
    """White noise of a channel away from contacts, and whether it mostly stands still there."""
    values, step = run.record.column(name), run.record.steps.get(name, 0.0)
    outside = values
    if name.startswith("wrench") and run.survey.contacts:
        outside = values[~run.touching(len(values))]
    if len(outside) <= MIN_FREE_ROWS:  # a latched mechanism is never free
        outside = values
    changes = np.diff(outside)
    changes = changes[np.isfinite(changes)]  # rows may be lost
    still = len(changes) >= 10 and np.median(np.abs(changes)) == 0.0
    return max(white_outside(outside, values, step), step / math.sqrt(12.0)), bool(still)


def _level_inside(runs: Sequence[MeasuredRun], name: str) -> float:
    """Noise of a force that stands still between contacts: as stated, or in contact."""
    sensor = runs[0].scenario.sensor
    level = sensor.noise if ".f" in name else sensor.torque_noise
    if not level:
        touched = [r for r in runs if r.survey.contacts]
        inside = [white_noise(r.record.column(name)[r.touching(r.record.ticks)]) for r in touched]
        level = float(np.median(inside)) if inside else 0.0
    if not any(undithered(r, name) for r in runs):
        return level
    return math.hypot(level, max(r.record.steps.get(name, 0.0) for r in runs) / math.sqrt(12.0))


def white_outside(outside: Array, values: Array, step: float = 0.0) -> float:
    """White noise of the rows ``outside`` contacts; where these are few and agree with it, that of
    all ``values``. step: of both.
    """
    found, everywhere = white_noise(outside, step), white_noise(values, step)
    error = 2.0 * WHITE_NOISE_ERROR / math.sqrt(max(1, len(outside))) * everywhere
    few = len(outside) < MIN_NOISE_ROWS and abs(everywhere - found) < error
    return everywhere if few else found


def repetition_factor(run: MeasuredRun, group: str, rows: int) -> Array:
    """(rows, parts) root of the number of successive rows with like quantisation errors, in a
    channel without dither; they count as one.

    They are alike while a reading stays the same, and while it grows by equal amounts, such as
    three steps a row, or five in two rows.
    """
    out = np.ones((rows, len(GROUPS[group].columns)))
    rounding = run.record.rounding(group)
    for j, name in enumerate(GROUPS[group].columns):
        if run.record.has(name) and (undithered(run, name) or name in run.record.digits):
            step = np.maximum(run.record.steps.get(name, 0.0), math.sqrt(12.0) * rounding[:rows, j])
            out[:, j] = np.sqrt(alike_rows(run.record.column(name)[:rows], step))
    return out


def alike_rows(values: Array, step: Array) -> Array:
    """(N,) number of rows around each of values (N,) whose quantisation errors, in a converter of
    ``step`` (N,), count as one error.

    Errors that repeat after n rows average out to 1/n of a single error: L rows of them have the
    mean of L/n^2 rows with equal errors.
    """
    out = np.ones(len(values))
    for period in range(1, min(LONGEST_PERIOD, len(values) - 1) + 1):
        changes = values[period:] - values[:-period]
        starts = np.flatnonzero(np.r_[True, ~(np.abs(np.diff(changes)) < 0.5 * step[period:-1])])
        lengths = np.diff(np.r_[starts, len(changes)])
        alike = np.where(lengths >= MIN_REPETITIONS, lengths / period**2, 1.0)
        if period == 1:
            # two equal values have one change
            alike = np.where(np.abs(changes[starts]) < 0.5 * step[starts + 1], lengths + 1.0, alike)
        alike = np.repeat(alike, lengths)
        for first in range(period + 1):  # each change bears on all rows that it spans
            rows = slice(first, first + len(changes))
            out[rows] = np.maximum(out[rows], alike)
    return out


def smooth_levels(runs: Sequence[MeasuredRun]) -> dict[str, float]:
    """Channel of pose_act to the root of the spectral density of its noise at low frequency [its
    unit], where rows lie between two samples.

    Smooth departures are judged by that level: for rows ``(1 - p) w_k + p w_(k-1)`` it is that of
    the samples ``w``. Empty where neighbours are not correlated, or rows further apart are too:
    that is a motion. Then the axes at rest may show it; one that moves is taken to have as much of
    it above third differences as those have. In a latched mechanism it always is.
    """
    moving = sorted({POSE_PARTS[j] for run in runs for j in moved_axes(run)})
    latched = any(run.scenario.mechanism.captured for run in runs)
    return (_levels(runs, ()) if not latched else {}) or _levels(runs, moving)


def _levels(runs: Sequence[MeasuredRun], moving: Sequence[str]) -> dict[str, float]:
    """:func:`smooth_levels`, with those of the ``moving`` axes by the others'."""
    units, level = [], {}
    for name in GROUPS["pose_act"].columns:
        free = [x for r in runs if len(x := _free(r, name)) > max(FAR_LAGS)]
        if not free or name.rpartition(".")[2] in moving:
            continue
        level[name] = float(np.sqrt(np.mean(np.concatenate(free) ** 2)))
        if level[name] > 0.0:
            units.append([x / level[name] for x in free])
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
    above = math.sqrt((1.0 + 2.0 * first) / (1.0 - taken))
    found = {name: value * above for name, value in level.items()}
    if not moving:
        return found
    white = {f"pose_act.{part}": _white(runs, f"pose_act.{part}") for part in POSE_PARTS}
    above = float(np.median([found[name] / white[name] for name in found if white.get(name)]))
    return found | {n: above * white[n] for p in moving if (n := f"pose_act.{p}") in white}


def _free(run: MeasuredRun, name: str) -> Array:
    """(n,) of the channel before the first touch; if latched, all of it less its command."""
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
