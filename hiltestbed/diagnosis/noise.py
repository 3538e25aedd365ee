"""Noise of the force record as the data have it: its colour and tails, an offset of each run, a share of the reading.

White noise of one level is what the record is taken to carry until free flight, where a sensor reads nothing else, says otherwise, beyond
what chance would. A hum, a drift and a bias that all runs share are left in: they are effects, not noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.optimize import brentq, nnls
from scipy.stats import chi2 as chi_square
from scipy.stats import f as fisher

from hiltestbed.diagnosis.aside import DEGREE, wanders
from hiltestbed.diagnosis.low_pass import LowPass
from hiltestbed.diagnosis.settings import BY_CHANCE, ENOUGH_FREE, HEAVY, KNEE, SHARE_SHOWS, SIGNIFICANT
from hiltestbed.diagnosis.tones import differing, tones_of, without_tones
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredRun
from hiltestbed.signals import GROUPS

CHANNELS = GROUPS["wrench_meas"].columns
CLOSE = 2  # rows before the first touch that are no longer counted as free
EDGE = 6  # rows after a touch and before its end whose differences show the touch
LAGS = 64  # rows, over which a correlation is summed at most
SMOOTH = 9  # rows of the running mean of a reading in contact
CLIPPED = 4.0  # robust standard deviations at which a sample counts for its correlation with others
FEW = 2.5  # steps of a converter, below which a force shows whether it is there, and not its size
FILLED = 1.0  # of a step, from which noise makes its error independent of the signal and from row to row
ROUNDED = 1.01  # of a step, to which it is read from a record
SETTLED = 0.05  # [s] after a contact in which a reading still shows it
FAR_TAIL = 4.0  # robust standard deviations, beyond which 6e-5 of normal samples lie
THIRD = 20.0  # variance of third differences of white noise
NORMAL = 2.0  # variance of the square of a normal sample
NEIGHBOURS = 2.31  # squares of third differences that count as one: 1 + 2 (15^2 + 6^2 + 1)/20^2


@dataclass(frozen=True)
class ForceNoise:
    """What free flight says of the noise of wrench_meas.

    Attributes:
        level: (6,) standard deviation [N, N m]; 0 where it was not read: third differences stand for it.
        colour: root of the spectral density at low frequency over that of white noise of the same variance, as a smooth misfit is judged.
        heavy: whether samples lie far out more often than normal ones do.
        offset: (6,) of each run [N, N m] that is taken out of it: by which it reads otherwise than all runs together.
        share: of the reading, that is noise beside. tail: variance of the square of a softened sample, 2 for normal noise.
        baseline: degree of the polynomial by which the readings differ from run to run, -1 for none; tones: [rad] a row, of another phase
            in each run, see :mod:`hiltestbed.diagnosis.aside`.
        step: [N] in which the force is read, where the scenario states none as large; 0 where it does, or noise fills it.
    """

    level: Array
    colour: float
    heavy: bool
    offset: tuple[Array, ...]
    share: float
    tail: float = NORMAL
    baseline: int = -1
    tones: tuple[float, ...] = ()
    step: float = 0.0

    def levels(self) -> dict[str, float]:
        """Channel to its level, of those that were read."""
        return {c: float(v) for c, v in zip(CHANNELS, self.level, strict=True) if v > 0.0}

    def words(self) -> tuple[str, ...]:
        """What was assumed, in sentences; none for white noise of one level."""
        out = []
        if self.colour > 1.0:
            out.append(f"the noise of the force is coloured: smooth departures are judged by {self.colour:.2g} times its level")
        if self.heavy:
            out.append("the noise of the force has outliers: samples far out count by the logarithm of their distance")
        if self.baseline == 0 or any(o.any() for o in self.offset):
            out.append("the force reads a different offset in each run: it is taken out run by run")
        if self.baseline > 0:
            out.append("the baseline of the force wanders otherwise in each run: a cubic a run is taken out of what is left")
        if self.tones:
            out.append("the force holds tones of another phase in each run, as of mains: they are taken out of what is left")
        if self.share:
            out.append(f"the noise of the force grows with the reading: {100.0 * self.share:.2g} % of it beside its level")
        if self.step:
            out.append(f"the force is read in steps of {self.step:.3g} N, unstated in sensor.quantisation: they are taken for noise")
        return tuple(out)


def softened(z: Array, heavy: bool) -> Array:
    """Residuals in units of the noise; of noise with outliers so that their squares grow by the logarithm from :data:`KNEE` on."""
    return np.sign(z) * KNEE * np.sqrt(np.log1p((z / KNEE) ** 2)) if heavy else z


def force_noise(runs: Sequence[MeasuredRun], logged: LowPass | None = None) -> ForceNoise:
    """The noise of the force on record, which went through a filter where it is ``logged`` so; white where free flight is too short to
    tell."""
    found = _noise(runs, logged)
    step = max((run.record.steps[name] for run in runs for name in CHANNELS[:3] if in_steps(run, name)), default=0.0)
    stated = not step or step <= ROUNDED * max(run.scenario.sensor.quantisation for run in runs)
    return found if stated else replace(found, step=step)


def _noise(runs: Sequence[MeasuredRun], logged: LowPass | None) -> ForceNoise:
    """Without its steps."""
    still = ForceNoise(np.zeros(6), logged.colour if logged else 1.0, False, tuple(np.zeros(6) for _ in runs), 0.0)
    free = [_free(run) for run in runs]
    if sum(len(x) for x in free) < ENOUGH_FREE:
        return still
    columns = [j for j in range(6) if _moves(free, j) and not any(in_steps(run, CHANNELS[j]) for run in runs)]
    if not columns:
        return still
    flat, start = _straightened(free, columns)
    tones = [] if logged else tones_of(flat)  # a narrow band of noise is not flat about a tone
    aside = differing(flat, tones, [_apart(run, columns)[1:] for run in runs])
    flat = without_tones(flat, tones)
    scale = np.array([1.4826 * np.median(np.abs(np.concatenate([x[:, i] for x in flat]))) for i in range(len(columns))])
    z = [x / np.where(scale > 0.0, scale, 1.0) for x in flat]
    heavy = _heavy([x[:: logged.stride] for x in z] if logged else z)
    colour = logged.colour if logged else _colour(z)
    level, tail = np.zeros(6), NORMAL
    if heavy or colour > 1.0 or aside:
        level[columns] = [_level(np.concatenate([x[:, i] for x in flat]), heavy) for i in range(len(columns))]
    if heavy:
        squares = np.concatenate([softened(x / level[columns], True).ravel() ** 2 for x in flat])
        tail = max(NORMAL, float(np.var(squares)))
    spread = np.array([float(np.std(np.concatenate([x[:, i] for x in flat]))) for i in range(len(columns))]) * colour
    if wanders([_apart(run, columns)[:2] for run in runs], spread):
        return ForceNoise(level, colour, heavy, still.offset, _share(runs, columns, scale), tail, DEGREE, aside)
    offset, (apart, degree) = [np.zeros(6) for _ in runs], _offsets([len(x) for x in flat], start, spread)
    for o, found in zip(offset, apart, strict=True):
        o[columns] = found
    return ForceNoise(level, colour, heavy, tuple(offset), _share(runs, columns, scale), tail, degree, aside)


def _free(run: MeasuredRun) -> Array:
    """(n, 6) readings before the first touch, rows of which all that was measured is there."""
    record = run.record
    if not record.has("wrench_meas"):
        return np.zeros((0, 6))
    end = max(0, run.survey.contacts[0].start - CLOSE) if run.survey.contacts else record.ticks
    values = record.data["wrench_meas"][:end]
    there = np.isfinite(values).any(axis=0)
    return np.where(there, values, 0.0)[np.isfinite(values[:, there]).all(axis=1)]


def _moves(free: Sequence[Array], j: int) -> bool:
    """Whether a channel shows any noise: not where it was not measured, or reads nothing below a threshold."""
    return all(np.median(np.abs(np.diff(x[:, j]))) > 0.0 for x in free if len(x) > 10)


def in_steps(run: MeasuredRun, name: str) -> bool:
    """Whether a channel comes in steps that its noise does not fill: nothing of the noise can be read there."""
    step = run.record.steps.get(name, 0.0)
    return step > 0.0 and run.survey.noise[name].white < FILLED * step


def few_numbers(run: MeasuredRun, name: str) -> bool:
    """Whether a channel in steps shows three numbers at most: what a converter makes of a force within its steps is no part of it."""
    if not run.record.has(name) or not in_steps(run, name):
        return False
    values = run.record.column(name)
    known = values[np.isfinite(values)]
    return len(known) > 0 and float(np.ptp(known)) < FEW * run.record.steps[name]


def _apart(run: MeasuredRun, columns: Sequence[int]) -> tuple[Array, Array, Array]:
    """Rows away from contacts, as parts of the run from -1 to 1, the readings there, and the numbers of the rows."""
    record = run.record
    if not record.has("wrench_meas"):
        return np.zeros(0), np.zeros((0, len(columns))), np.zeros(0)
    values = record.data["wrench_meas"][:, columns]
    apart = ~run.survey.touching(len(values), round((run.scenario.sensor.delay + SETTLED) * run.scenario.rate))
    apart &= np.isfinite(values).all(axis=1)
    return np.linspace(-1.0, 1.0, len(values))[apart], values[apart], np.flatnonzero(apart).astype(float)


def _straightened(free: Sequence[Array], columns: Sequence[int]) -> tuple[list[Array], Array]:
    """Readings less a straight line a run and channel, of one slope in all runs; and those lines' values at the start (R, C)."""
    rows = [np.arange(len(x), dtype=float) for x in free]
    above = sum(float(np.sum((t - t.mean()) ** 2)) for t in rows if len(t))
    slope = sum(((t - t.mean())[:, None] * x[:, columns]).sum(axis=0) for t, x in zip(rows, free, strict=True) if len(t)) / above
    start = np.array(
        [x[:, columns].mean(axis=0) - slope * t.mean() if len(t) else np.zeros(len(columns)) for t, x in zip(rows, free, strict=True)]
    )
    return [x[:, columns] - s - t[:, None] * slope for t, x, s in zip(rows, free, start, strict=True)], start


def _heavy(z: Sequence[Array]) -> bool:
    far = sum(int(np.sum(np.abs(x) > FAR_TAIL)) for x in z)
    expected = 6.3e-5 * sum(x.size for x in z)
    return far > HEAVY + 3.0 * expected


def _colour(z: Sequence[Array]) -> float:
    """See :class:`ForceNoise`; 1 unless neighbours are correlated beyond chance."""
    clipped = [np.clip(x, -CLIPPED, CLIPPED) for x in z]
    square, samples = sum(float(np.sum(x * x)) for x in clipped), sum(x.size for x in clipped)
    chance = 1.0 / math.sqrt(samples)
    taken = 2.0 * len(z) / max(1, sum(len(x) for x in z))  # what the straight line takes out of each correlation
    total, first = 1.0, 0.0
    for lag in range(1, LAGS):
        found = sum(float(np.sum(x[lag:] * x[:-lag])) for x in clipped if len(x) > lag) / square + taken
        first = found if lag == 1 else first
        if found < 2.0 * chance:
            break
        total += 2.0 * found
    return math.sqrt(total) if first > SIGNIFICANT * chance else 1.0


def _level(x: Array, heavy: bool) -> float:
    """Standard deviation; of noise with outliers that in units of which the softened samples have a mean square of 1."""
    rms = float(np.std(x))
    if not heavy or rms == 0.0:
        return rms
    return float(brentq(lambda s: float(np.mean(softened(x / s, True) ** 2)) - 1.0, 1e-2 * rms, 1e2 * rms))  # type: ignore[arg-type]


def _offsets(counts: Sequence[int], start: Array, spread: Array) -> tuple[Array, int]:
    """(R, C) that is taken out of each run, and the degree of a polynomial that is, see :class:`ForceNoise`.

    Nothing is where chance would make the runs differ as they do, and a constant where it would make of such runs what they share.
    """
    error = np.array([2.0 * spread / math.sqrt(max(n, 1)) for n in counts])
    known = np.array(counts) > 10
    if known.sum() < 2 or not (spread > 0.0).all():
        return np.zeros_like(start), -1
    weight = np.where(known[:, None], 1.0 / error**2, 0.0)
    apart = np.where(known[:, None], start - (weight * start).sum(axis=0) / weight.sum(axis=0), 0.0)
    freedom = (known.sum() - 1) * start.shape[1]
    if float(np.sum((apart / error) ** 2)) <= chi_square.isf(BY_CHANCE, freedom):
        return np.zeros_like(start), -1
    readings, count = start[known] / spread, int(known.sum())
    between = count * float(np.mean(readings.mean(axis=0) ** 2))  # against what the runs differ by: one F of all channels
    shared = between > fisher.isf(BY_CHANCE, start.shape[1], freedom) * float(np.mean(readings.var(axis=0, ddof=1)))
    return (apart, -1) if shared else (np.zeros_like(start), 0)


def _share(runs: Sequence[MeasuredRun], columns: Sequence[int], scale: Array) -> float:
    """Noise in contact as a part of the reading, by third differences, beside what goes along with its rate (a delay that varies)."""
    squares, readings, rates = [], [], []
    for run in runs:
        values = run.record.data["wrench_meas"][:, columns] / scale if run.record.has("wrench_meas") else np.zeros((0, len(columns)))
        for c in run.survey.contacts:
            x = values[c.start + EDGE : c.end - EDGE]
            x = x[np.isfinite(x).all(axis=1)]
            if len(x) < 20:
                continue
            squares.append(np.diff(x, 3, axis=0).ravel() ** 2 / THIRD)
            smooth = uniform_filter1d(x, SMOOTH, axis=0)  # whose noise is not that of the differences
            readings.append((0.5 * (smooth[1:-2] + smooth[2:-1])).ravel() ** 2)
            rates.append(((smooth[2:-1] - smooth[1:-2]) ** 2).ravel())
    if not squares or sum(map(len, squares)) < 200:
        return 0.0
    y, basis = (
        np.concatenate(squares),
        np.column_stack([np.concatenate([np.ones_like(r) for r in readings]), *map(np.concatenate, (readings, rates))]),
    )
    found = np.array([1.0, 0.0, 0.0])
    for _ in range(6):
        expected = np.maximum(basis @ found, 0.1)
        y_used = np.minimum(y, 9.0 * expected)
        found, _ = nnls(basis / expected[:, None], y_used / expected)
    expected = np.maximum(basis @ found, 0.1)
    information = (basis / expected[:, None]).T @ (basis / expected[:, None]) / (2.0 * NEIGHBOURS)  # variance of a square: 2
    error = math.sqrt(float(np.linalg.pinv(information)[1, 1]))
    grown = found[1] * float(np.percentile(basis[:, 1], 95.0))
    return math.sqrt(found[1]) if found[1] > SIGNIFICANT * error and grown > SHARE_SHOWS * max(found[0], 0.1) else 0.0
