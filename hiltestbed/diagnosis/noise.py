"""Stage "layout": noise model of the recorded force, from free flight: colour, outliers, offsets,
noise in proportion to the reading.

The noise is taken for white, of one level, unless free flight, where a sensor reads nothing else,
contradicts that beyond chance. A hum, a drift and a bias that all runs share stay in the record:
they are effects, not noise. A mechanism that is latched from the start never flies freely: there
the axes that do not move take the place of free flight, less what they share with the axes that do,
and less what the believed contact makes of their path. In the loop a drift of the sensor moves the
numerical model until the springs of the latch balance it: the reading then shows no drift, and the
path does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.optimize import brentq, nnls
from scipy.stats import chi2 as chi_square
from scipy.stats import f as fisher

from hiltestbed.diagnosis.free_flight import (
    free_readings,
    readings_apart,
    shows_noise,
    straightened,
)
from hiltestbed.diagnosis.low_pass import LowPass
from hiltestbed.diagnosis.nuisances import (
    BASELINE_DEGREE,
    MIN_BASELINE_ROWS,
    baseline_terms,
    phases_differ,
    tones_of,
    wander_between,
    without_tones,
)
from hiltestbed.diagnosis.settings import (
    MIN_NOISE_ROWS,
    SIGNIFICANCE_LEVEL,
    SIGNIFICANCE_SIGMA,
    UNKNOWN,
)
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredRun
from hiltestbed.measured.noise import MAD_TO_SIGMA, OUTLIER_SIGMA, THIRD_DIFFERENCE, white_noise
from hiltestbed.signals import GROUPS

# chosen: samples beyond four standard deviations, in excess of those of normal noise
MIN_OUTLIERS = 3
# chosen: [sigma] beyond which a sample of noise with outliers counts by its logarithm
OUTLIER_KNEE = 3.0
# chosen: share of the noise variance that noise in proportion to the reading must add at the
# largest readings
MIN_SHARE_VARIANCE = 0.3

CHANNELS = GROUPS["wrench_meas"].columns
POSE_PARTS = ("px", "py", "pz", "qx", "qy", "qz")  # of the axes of CHANNELS
# chosen: after a touch and before its end, whose differences show the touch
CONTACT_MARGIN_ROWS = 6
MAX_LAG = 64  # chosen: rows over which a correlation is summed
SMOOTHED_ROWS = 9  # chosen: least, of the running mean of a reading in contact
# of a contact, over which a reading is averaged: half a sine wave loses 1 - sinc(1/32), 0.2 %
SMOOTHED_SHARE = 1.0 / 16.0
# chosen: range of a channel in steps of its converter, below which it shows the presence of a force
# and not its size
FEW_STEPS = 2.5
SUDDEN_ROWS = 9  # chosen: of a running median, which an outlier leaves as it is
# chosen: robust standard deviations from it, so few that no sample of normal noise lies beyond
SUDDEN_SIGMA = 8.0
# chosen: noise in steps, above which the quantisation error is independent of the signal and of the
# row before
MIN_DITHER = 1.0
STEP_TOLERANCE = 1.01  # chosen: relative error of a step that is estimated from a record
# chosen: share of the largest motion of a latched mechanism, below which an axis counts as at rest
MAX_REST = 0.02
# derived: squares of third differences that count as one: 1 + 2 (15^2 + 6^2 + 1)/20^2
CORRELATED_SQUARES = 2.31


@dataclass(frozen=True)
class ForceNoise:
    """The noise of wrench_meas, estimated from free flight.

    Attributes:
        level: (6,) standard deviation [N, N m]; 0 where it was not estimated: the noise floor by
            third differences is used instead.
        colour: root of the spectral density at low frequency over that of white noise of the same
            variance; it scales smooth misfits.
        heavy: whether there are more outliers than in normal noise.
        offset: (6,) of each run [N, N m], subtracted from it: its difference from the offset of all
            runs.
        share: noise in proportion to the reading.
        wander: (D, 6) standard deviation [N, N m] between runs of each coefficient of the baseline,
            a Legendre polynomial over the run; infinite where it is not known, D = 0 where there is
            none. tones: [rad] a row, whose phase differs between runs. For both see
            :mod:`hiltestbed.diagnosis.nuisances`.
        step: [N] quantisation of the force, where the scenario states a smaller one or none; 0
            otherwise, and where noise dithers it.
    """

    level: Array
    colour: float
    heavy: bool
    offset: tuple[Array, ...]
    share: float
    wander: Array = field(default_factory=lambda: np.zeros((0, 6)))
    tones: tuple[float, ...] = ()
    step: float = 0.0

    def levels(self) -> dict[str, float]:
        """Channel to its level, of those that were estimated."""
        return {c: float(v) for c, v in zip(CHANNELS, self.level, strict=True) if v > 0.0}

    def nuisances(self, rows: int, ticks: int, level: Array) -> Array:
        """(rows, 6, D) nuisance terms of a run of ``ticks`` at one sigma; level: (6,) of noise."""
        at, most = np.arange(rows, dtype=float), np.minimum(self.wander, UNKNOWN * level).T
        terms = [np.zeros((rows, 6, 0))]
        if len(self.wander):
            places = _places(at, ticks)
            terms.append(baseline_terms(places, len(self.wander) - 1)[:, None, :] * most)
        for w in self.tones:
            waves = np.stack([np.sin(w * at), np.cos(w * at)], axis=1)
            terms.append(waves[:, None, :] * (UNKNOWN * level)[:, None])
        return np.concatenate(terms, axis=2)

    def words(self) -> tuple[str, ...]:
        """The assumptions in sentences; none for white noise of one level."""
        out = []
        if self.colour > 1.0:
            out.append(
                f"the noise of the force is coloured: smooth departures are compared with "
                f"{self.colour:.2g} times its level"
            )
        if self.heavy:
            out.append(
                "the noise of the force has outliers: they count by the logarithm of their size"
            )
        if len(self.wander) == 1 or any(o.any() for o in self.offset):
            out.append("the force has a different offset in each run: it is subtracted run by run")
        if len(self.wander) > 1:
            out.append(
                "the baseline of the force wanders differently in each run: what the runs do not "
                "share of it is no departure"
            )
        if self.tones:
            out.append(
                "the force has tones whose phase differs from run to run, such as mains hum: they "
                "are removed from the residual"
            )
        if self.share:
            out.append(
                f"the noise of the force grows with the reading: {100.0 * self.share:.2g} % of it "
                f"in addition to its level"
            )
        if self.step:
            out.append(
                f"the force is read in steps of {self.step:.3g} N, which sensor.quantisation does "
                f"not state: they are treated as noise"
            )
        return tuple(out)


def softened(z: Array, heavy: bool) -> Array:
    """Residuals in units of the noise; with outliers, squares grow by their logarithm."""
    return np.sign(z) * OUTLIER_KNEE * np.sqrt(np.log1p((z / OUTLIER_KNEE) ** 2)) if heavy else z


def force_noise(
    runs: Sequence[MeasuredRun], logged: LowPass | None = None, shown: Sequence[Array] | None = None
) -> ForceNoise:
    """The noise of the force on record; white where free flight is too short to estimate it.

    logged: the filter of the record, if any. shown: (N, 6) of each run, readings of the believed
        contact of a latched mechanism on its path, NaN where unknown; None: not known yet, the
        readings themselves are taken for noise.
    """
    found = _noise(runs, logged, shown or [np.zeros((r.record.ticks, 6)) for r in runs])
    steps = (r.record.steps[name] for r in runs for name in CHANNELS[:3] if undithered(r, name))
    step = max(steps, default=0.0)
    stated = max((r.scenario.sensor.quantisation for r in runs), default=0.0)
    return replace(found, step=step) if step > STEP_TOLERANCE * stated else found


def _noise(
    runs: Sequence[MeasuredRun], logged: LowPass | None, shown: Sequence[Array]
) -> ForceNoise:
    offset = tuple(np.zeros(6) for _ in runs)
    still = ForceNoise(np.zeros(6), logged.colour if logged else 1.0, False, offset, 0.0)
    latched = any(run.scenario.mechanism.captured for run in runs)
    measured = [j for j in range(6) if not any(undithered(run, CHANNELS[j]) for run in runs)]
    # axes that move in any run, and in every run
    axes = [set(moved_axes(r)) for r in runs if latched and r.record.has("wrench_meas")]
    axes = axes or [set[int]()]
    moved, driving = sorted(set.union(*axes)), sorted(set.intersection(*axes))
    if latched:
        at_rest = [_at_rest(run, driving, s) for run, s in zip(runs, shown, strict=True)]
        free = [readings for _, readings in at_rest]
    else:
        at_rest, free = [], [free_readings(run) for run in runs]
    if sum(len(x) for x in free) < MIN_NOISE_ROWS:
        return still
    columns = [j for j in measured if j not in moved and shows_noise(free, j)]
    if not columns:
        return still
    apart = [(rows, x[:, columns]) for rows, x in at_rest]
    apart = apart or [readings_apart(run, columns) for run in runs]
    flat, start = straightened(free, columns)
    if latched:  # whole runs, over which a baseline wanders more than along a line
        flat = [_without_baseline(x) for x in flat]
    # numbers of the baseline, or of the line, of a channel in one run
    bent = 1 + BASELINE_DEGREE if latched else 2
    tones = [] if logged else tones_of(flat)  # filtered noise is not flat about a tone
    aside = phases_differ(flat, tones, apart)
    flat = without_tones(flat, tones)
    each = np.ascontiguousarray(np.concatenate(flat).T)  # (C, rows)
    scale = MAD_TO_SIGMA * np.median(np.abs(each), axis=1)
    z = [x / np.where(scale > 0.0, scale, 1.0) for x in flat]
    if logged:
        heavy, colour = _heavy([x[:: logged.stride] for x in z]), logged.colour
    else:
        sudden = sum(_sudden(x) for _, x in apart if len(x))
        heavy, colour = _heavy(z) or sudden > MIN_OUTLIERS, _colour(z, bent)
    rows, fitted = sum(map(len, flat)), sum(bent + 2 * len(tones) for x in flat if len(x))
    # of the deviation, by the lines and tones that were fitted
    lost = math.sqrt(rows / max(rows - fitted, 1))
    level = np.zeros(6)
    if heavy or colour > 1.0:
        level[columns] = [lost * _level(x, heavy) for x in each]
    elif aside:
        silent = without_tones([x for _, x in apart], aside, [r for r, _ in apart])
        level[columns] = _white_levels(silent)
    pressed = columns
    # noise of an axis that moves shows in third differences alone: as much above these as in the
    # other channels
    if latched:
        there = [r.record.data["wrench_meas"] for r in runs if r.record.has("wrench_meas")]
        white = _white_levels(there)
        level[moved] = white[moved] * float(np.median(level[columns] / white[columns]))
        pressed = [j for j in moved if j in measured]
        scale = white[pressed]
    share = _share(runs, pressed, scale)
    spread = np.array([lost * float(np.std(x)) * colour for x in each])
    pairs = zip(runs, apart, strict=True)
    wander = wander_between([(_places(r, run.record.ticks), x) for run, (r, x) in pairs], spread)
    if wander is not None:
        known = np.full((len(wander), 6), np.inf)
        known[:, columns] = wander
        return ForceNoise(level, colour, heavy, offset, share, known, aside)
    found, unknown = _offsets([len(x) for x in flat], start, spread)
    if latched and found.any():  # the offset of an axis that moves is not known
        found, unknown = np.zeros_like(found), True
    for o, f in zip(offset, found, strict=True):
        o[columns] = f
    known = np.full((int(unknown), 6), np.inf)
    return ForceNoise(level, colour, heavy, offset, share, known, aside)


def _white_levels(readings: Sequence[Array]) -> Array:
    """(C,) white noise of the readings (M, C) of all runs, by third differences."""
    weight = np.array([float(len(x)) for x in readings])
    squares = np.array([[white_noise(column) ** 2 for column in x.T] for x in readings])
    return np.asarray(np.sqrt(weight @ squares / weight.sum()))


def moved_axes(run: MeasuredRun) -> list[int]:
    """Axes that move: by more than their noise, and by a share of what the one that moves most does
    [m, rad].

    An axis whose pose is not on record may move.
    """
    group = "pose_act" if run.record.has("pose_act") else "pose_cmd"
    names, ranges = [f"{group}.{part}" for part in POSE_PARTS], np.full(6, math.inf)
    for j, name in enumerate(names):
        if run.record.has(name):
            x = run.record.column(name)
            ranges[j] = (1.0 if j < 3 else 2.0) * float(np.ptp(x[np.isfinite(x)]))
    most = np.max(ranges[np.isfinite(ranges)], initial=0.0)
    moves = [
        r > MAX_REST * most and n in run.survey.excited for n, r in zip(names, ranges, strict=True)
    ]
    return [j for j in range(6) if ranges[j] == math.inf or moves[j]]


def _at_rest(run: MeasuredRun, driving: Sequence[int], shown: Array) -> tuple[Array, Array]:
    """Rows (n,) of a latched mechanism, and what the believed contact, which has ``shown`` (N, 6),
    leaves of the readings (n, 6), less what it shares with the readings of the axes that move in
    every run, ``driving``, which may reach it a row earlier or later.
    """
    record = run.record
    if not record.has("wrench_meas") or len(driving) == len(CHANNELS):
        return np.zeros(0), np.zeros((0, 6))
    values = record.data["wrench_meas"]
    there = np.isfinite(values).any(axis=0)
    rows = np.flatnonzero(np.isfinite((values - shown)[:, there]).all(axis=1))
    values, left = (np.where(there, x, 0.0)[rows] for x in (values, values - shown))
    if not driving or len(values) < MIN_NOISE_ROWS:
        return rows.astype(float), left
    push = values[:, driving]
    beside = np.concatenate([push[2:], push[1:-1], push[:-2]], axis=1)
    rows, left = rows[1:-1].astype(float), left[1:-1]
    # beside it, since baselines look alike
    baseline = baseline_terms(_places(rows, record.ticks), BASELINE_DEGREE)
    both = np.concatenate([beside, baseline], axis=1)
    part = np.linalg.lstsq(both, left, rcond=None)[0][: beside.shape[1]]
    return rows, left - (beside - beside.mean(axis=0)) @ part


def _places(rows: Array, ticks: int) -> Array:
    """Rows of a run, scaled from -1 to 1."""
    return 2.0 * rows / max(ticks - 1, 1) - 1.0


def undithered(run: MeasuredRun, name: str) -> bool:
    """Whether noise does not dither a channel's quantisation, and cannot be estimated from it."""
    step = run.record.steps.get(name, 0.0)
    return step > 0.0 and run.survey.noise[name].white < MIN_DITHER * step


def few_levels(run: MeasuredRun, name: str) -> bool:
    """Whether an undithered channel shows at most three levels, which hide the force's size."""
    if not run.record.has(name) or not undithered(run, name):
        return False
    values = run.record.column(name)
    known = values[np.isfinite(values)]
    return len(known) > 0 and float(np.ptp(known)) < FEW_STEPS * run.record.steps[name]


def _without_baseline(x: Array) -> Array:
    """Readings (n, C) less the baseline polynomial of each channel."""
    if len(x) < MIN_BASELINE_ROWS:
        return x
    basis = baseline_terms(np.linspace(-1.0, 1.0, len(x)), BASELINE_DEGREE)
    return np.asarray(x - basis @ np.linalg.lstsq(basis, x, rcond=None)[0])


def _heavy(z: Sequence[Array]) -> bool:
    far = sum(int(np.sum(np.abs(x) > OUTLIER_SIGMA)) for x in z)
    expected = 6.3e-5 * sum(x.size for x in z)
    return far > MIN_OUTLIERS + 3.0 * expected


def _sudden(x: Array) -> int:
    """Readings (n, C) far from a running median, and four times as far as their neighbours."""
    left = np.abs(x - median_filter(x, (SUDDEN_ROWS, 1)))
    beside = np.pad(left, ((1, 1), (0, 0)))
    alone = 4.0 * np.maximum(beside[:-2], beside[2:]) < left
    return int(np.sum(alone & (left > SUDDEN_SIGMA * MAD_TO_SIGMA * np.median(left, axis=0))))


def _colour(z: Sequence[Array], fitted: int) -> float:
    """`colour` of :class:`ForceNoise`; 1 unless neighbours are correlated beyond chance. fitted:
    numbers that were fitted to a channel of a run, which biases each of its correlations.
    """
    clipped = [np.clip(x, -OUTLIER_SIGMA, OUTLIER_SIGMA) for x in z]
    square, samples = sum(float(np.sum(x * x)) for x in clipped), sum(x.size for x in clipped)
    chance = 1.0 / math.sqrt(samples)
    taken = fitted * len(z) / max(1, sum(len(x) for x in z))
    total, first = 1.0, 0.0
    for lag in range(1, MAX_LAG):
        found = (
            sum(float(np.sum(x[lag:] * x[:-lag])) for x in clipped if len(x) > lag) / square + taken
        )
        first = found if lag == 1 else first
        if found < 2.0 * chance:
            break
        total += 2.0 * found
    return math.sqrt(total) if first > SIGNIFICANCE_SIGMA * chance else 1.0


def _level(x: Array, heavy: bool) -> float:
    """Standard deviation; with outliers, the unit of softened samples of mean square 1."""
    rms = float(np.std(x))
    if not heavy or rms == 0.0:
        return rms
    found: Any = brentq(
        lambda s: float(np.mean(softened(x / s, True) ** 2)) - 1.0, 1e-2 * rms, 1e2 * rms
    )
    return float(found)


def _offsets(counts: Sequence[int], start: Array, spread: Array) -> tuple[Array, bool]:
    """(R, C) offset to subtract from each run, and whether what they share is not significant
    beside what they differ by, so that none of it is known. No offset where the runs differ by no
    more than chance.
    """
    none, known = np.zeros_like(start), np.array(counts) > 10
    if known.sum() < 2 or not (spread > 0.0).all():
        return none, False
    error = np.array([2.0 * spread / math.sqrt(max(n, 1)) for n in counts])
    weight = np.where(known[:, None], 1.0 / error**2, 0.0)
    apart = start - (weight * start).sum(axis=0) / weight.sum(axis=0)
    apart = np.where(known[:, None], apart, 0.0)
    freedom, count = (known.sum() - 1) * start.shape[1], int(known.sum())
    if float(np.sum((apart / error) ** 2)) <= chi_square.isf(SIGNIFICANCE_LEVEL, freedom):
        return none, False
    # against their spread: one F test of all channels
    readings = start[known] / spread
    between = count * float(np.mean(readings.mean(axis=0) ** 2))
    within = float(np.mean(readings.var(axis=0, ddof=1)))
    if between > fisher.isf(SIGNIFICANCE_LEVEL, start.shape[1], freedom) * within:
        return apart, False
    return none, True


def _share(runs: Sequence[MeasuredRun], columns: Sequence[int], scale: Array) -> float:
    """Noise in proportion to the reading, by third differences, beside one to its rate."""
    squares, readings, rates = [], [], []
    for run in (r for r in runs if r.record.has("wrench_meas")):
        values = run.record.data["wrench_meas"][:, columns] / scale
        for c in run.survey.contacts:
            x = values[c.start + CONTACT_MARGIN_ROWS : c.end - CONTACT_MARGIN_ROWS]
            x = x[np.isfinite(x).all(axis=1)]
            if len(x) < 20:
                continue
            squares.append(np.diff(x, 3, axis=0).ravel() ** 2 / THIRD_DIFFERENCE**2)
            # nearly independent of the noise of the differences
            rows = max(SMOOTHED_ROWS, round(SMOOTHED_SHARE * len(x)))
            smooth = uniform_filter1d(x, rows, axis=0)
            readings.append((0.5 * (smooth[1:-2] + smooth[2:-1])).ravel() ** 2)
            rates.append(((smooth[2:-1] - smooth[1:-2]) ** 2).ravel())
    if sum(map(len, squares)) < 200:
        return 0.0
    y, *rest = (np.concatenate(x) for x in (squares, readings, rates))
    basis = np.column_stack([np.ones_like(y), *rest])
    found = np.array([1.0, 0.0, 0.0])
    for _ in range(6):
        expected = np.maximum(basis @ found, 0.1)
        found, _ = nnls(basis / expected[:, None], np.minimum(y, 9.0 * expected) / expected)
    weighted = basis / np.maximum(basis @ found, 0.1)[:, None]
    # variance of a square: 2
    information = weighted.T @ weighted / (2.0 * CORRELATED_SQUARES)
    error = math.sqrt(float(np.linalg.pinv(information)[1, 1]))
    grown = found[1] * float(np.percentile(basis[:, 1], 95.0))
    if found[1] > SIGNIFICANCE_SIGMA * error and grown > MIN_SHARE_VARIANCE * max(found[0], 0.1):
        return math.sqrt(found[1])
    return 0.0
