"""Stage "select": goodness of fit: whether the residual of a hypothesis is noise, channel by
channel, in contact and outside it.

Two statistics a channel, both 1 for white noise at the floor: the variance ratio, and the same for
means of blocks of samples, in which a smooth misfit far below the noise shows. The samples of a
block count once, so that correlated residuals do not count as many samples. A computed channel has
no noise of its own: it is compared with what integrators may differ by, or with noise that the
record passes on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hiltestbed.diagnosis.links import AxisLink, CompensationLink, ModelLink, WrenchLink
from hiltestbed.diagnosis.links.base import NO_SHIFT, Effects
from hiltestbed.diagnosis.noise import softened
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.settings import (
    BLOCK_ROWS,
    CORRELATED_ROWS,
    DYNAMICS_FLOOR,
    MIN_FREE_ROWS,
    MODEL_ERROR,
    SIGNIFICANCE_SIGMA,
    SMOOTHING_ROWS,
)
from hiltestbed.effects.base import Effect
from hiltestbed.frames import Array

# derived: [m, rad] a h^2/8 of linear interpolation, at both ends; a = 8 m/s^2: 0.1 m/s, contacts of
# 40 ms
DYNAMICS_INTERPOLATION = 2e-6
# derived: standard deviations allowed for a statistic; of some 30 statistics one exceeds it in 5000
# sets
ADEQUACY_SIGMA = 4.5
# derived: of a variance by the median of third differences of FLOOR_ROWS rows, 2.3 of which count
# as one
FLOOR_ERROR = 0.08
FLOOR_ROWS = 1500
# chosen: share of the departure of a computed channel that an explanation may leave
MAX_COMPUTED_RESIDUAL = 0.01
# chosen: times the propagated noise of the record, up to which a residual of the compensation may
# be that noise
MAX_PROPAGATED_NOISE = 1.7

JITTER = "sensor.jitter"

NEIGHBOURS = 2  # chosen: rows to each side whose squares may be alike
# chosen: of the ratio of propagated noise in contact to that outside it, however many rows there
# are
MIN_VARIANCE_LIMIT = 1.3


@dataclass(frozen=True)
class Leftover:
    """The residual of one channel: variance ratio, block ratio, their limits, number of samples."""

    variance: float
    block: float
    variance_limit: float
    block_limit: float
    samples: int

    @property
    def noise(self) -> bool:
        """Whether the residual passes for noise."""
        return self.variance <= self.variance_limit and self.block <= self.block_limit

    @property
    def excess(self) -> float:
        """The worse statistic over its limit; above 1 it is not noise."""
        return max(self.variance / self.variance_limit, self.block / self.block_limit)


# channel to what a hypothesis leaves
Judge = Callable[[Residual, Effects], dict[str, Leftover]]


def noise_alone(leftovers: Mapping[str, Leftover]) -> bool:
    """Whether the residual passes for noise on every channel."""
    return all(left.noise for left in leftovers.values())


def leftover(residuals: list[Array], tail: float = 2.0, rows: int = FLOOR_ROWS) -> Leftover:
    """Of one channel; residuals: one array a run (or contact), in units of the noise; tail:
    variance of the square of a noise sample; rows: from which the noise floor was estimated.
    """
    total, squares, sums, blocks = 0, 0.0, 0.0, 0
    level = FLOOR_ERROR * math.sqrt(tail / 2.0 * max(1.0, FLOOR_ROWS / max(rows, 1)))
    for r in residuals:
        total += len(r)
        squares += float(r @ r)
        whole = len(r) // BLOCK_ROWS
        means = r[: whole * BLOCK_ROWS].reshape(whole, BLOCK_ROWS).sum(axis=1) / math.sqrt(
            BLOCK_ROWS
        )
        sums += float(means @ means)
        blocks += whole
    return Leftover(
        squares / max(total, 1),
        sums / max(blocks, 1),
        level + _most(tail / max(total, 1)),
        level + _most((2.0 + (tail - 2.0) / BLOCK_ROWS) / max(blocks, 1)),
        total,
    )


def _most(variance: float) -> float:
    """The mean of squares of noise, of mean 1 and this variance, that is exceeded as rarely as
    ADEQUACY_SIGMA by a normal deviate: a few squares are skewed (chi-square, by E. B. Wilson, M. M.
    Hilferty, PNAS 17, 1931).
    """
    part = variance / 9.0
    return (1.0 - part + ADEQUACY_SIGMA * math.sqrt(part)) ** 3


def soften(sigma: Array, signal: Array) -> Array:
    """The noise plus a model error in proportion to the signal, both (N, C)."""
    return np.sqrt(sigma**2 + (MODEL_ERROR * signal) ** 2)


def shake(effects: Effects) -> float:
    """Standard deviation [s] of the delay under ``effects``."""
    return math.sqrt(sum(_sigma(e) ** 2 for e in effects if e.kind == JITTER))


def _sigma(effect: Effect) -> float:
    return float(effect.parameters()["sigma"])


def contact_leftovers(residual: Residual, effects: Effects) -> dict[str, Leftover]:
    """Channel to the leftover in contact or outside it, whichever is worse."""
    link = residual.link
    inside: list[list[Array]] = [[] for _ in link.channels]
    outside: list[list[Array]] = [[] for _ in link.channels]
    varies = shake(effects)
    shown = link.predict([(i, effects) for i in residual.runs])
    for i, prediction in zip(residual.runs, shown, strict=True):
        run, weight = link.runs[i], residual.weight[i]
        sigma = np.where(weight > 0, 1.0 / np.where(weight > 0, weight, 1.0), np.inf)
        if isinstance(link, WrenchLink):
            sigma = soften(sigma, prediction)
            if varies:
                prediction, spread = link.shaken(i, effects, varies)
                sigma = np.hypot(sigma, spread)
        z = softened(residual.left(i, prediction) / sigma, run.heavy)
        for c in range(len(link.channels)):
            counted = weight[:, c] > 0
            inside[c].append(z[run.touching & counted, c])
            outside[c].append(z[~run.touching & counted, c])
    out = {}
    for name, a, b in zip(link.channels, inside, outside, strict=True):
        both = [
            leftover(part, max(r.tail for r in link.runs), _read_from(link))
            for part in (a, b)
            if sum(map(len, part)) > 0
        ]
        if both:
            out[name] = max(both, key=lambda left: left.excess)
    return out


def _read_from(link: ModelLink) -> int:
    """Samples from which the noise floor was estimated: those away from contacts, or all where
    these are too few. A log that is slower than the loop has fewer of them than rows.
    """
    known = [np.asarray(np.isfinite(run.sigma).any(axis=1)) for run in link.runs]
    free = sum(
        int(np.count_nonzero(k & ~run.touching)) for k, run in zip(known, link.runs, strict=True)
    )
    if free > MIN_FREE_ROWS * len(link.runs):
        return free
    return sum(int(np.count_nonzero(k)) for k in known)


def judge_of_compensation(link: CompensationLink, noise: Mapping[str, float]) -> Judge:
    """Leaves zero, or propagated noise of the record that is no larger in contact than outside."""
    gain = link.noise_gain()

    def judge(residual: Residual, effects: Effects) -> dict[str, Leftover]:
        out = {}
        left = residual.by_run([effects])[0]
        touching = np.concatenate([residual.link.runs[i].touching for i in residual.runs])
        rows = np.concatenate(left)
        late = any(e.link == "log" for e in effects)
        for c, name in enumerate(residual.link.channels):
            level = min(float(residual.link.runs[i].sigma[:, c].min()) for i in residual.runs)
            if not math.isfinite(level):  # an axis that was not measured, or whose input was not
                continue
            inside, outside = rows[touching, c], rows[~touching, c]
            rms_in, rms_out = (
                float(np.sqrt(np.mean(x * x))) * level if len(x) else 0.0 for x in (inside, outside)
            )
            led = gain * noise.get(name.replace("comp", "meas"), 0.0)
            # a latched mechanism is never free
            apart = rms_out if len(outside) > SMOOTHING_ROWS else rms_in
            if late:  # from a late record the loop's readings are known up to its noise
                apart = led
            floor = max(level / math.sqrt(CORRELATED_ROWS), min(apart, MAX_PROPAGATED_NOISE * led))
            ratio, limit = (max(rms_in, rms_out) / floor) ** 2, _chance(residual, c, left)
            out[name] = Leftover(ratio, 0.0, max(MIN_VARIANCE_LIMIT, limit), 1.0, len(inside))
        return out

    return judge


def _chance(residual: Residual, channel: int, left: Sequence[Array]) -> float:
    """The largest ratio of the variances in contact and outside it by chance; left: (N, C) residual
    of each run.

    The logarithm of a variance of n rows on record has an error of sqrt(s/n): s is 2 for
    independent normal ones, and what the rows outside contact show it to be where their noise
    differs from row to row or follows their neighbours', as between the rows of a slower log.
    """
    inside, outside = 0, []
    for i, r in zip(residual.runs, left, strict=True):
        run = residual.link.runs[i]
        known = np.isfinite(run.sigma[:, channel])
        inside += int((known & run.touching).sum())
        outside.append(r[known & ~run.touching, channel] ** 2)
    rows, spread = sum(map(len, outside)), 2.0
    mean = sum(float(x.sum()) for x in outside) / max(rows, 1)
    if rows > SMOOTHING_ROWS and mean > 0.0:
        off = [x / mean - 1.0 for x in outside]
        lags = [
            sum(float(x[lag:] @ x[: len(x) - lag]) for x in off) / rows
            for lag in range(NEIGHBOURS + 1)
        ]
        spread = max(spread, lags[0] + 2.0 * sum(max(lag, 0.0) for lag in lags[1:]))
    return math.exp(SIGNIFICANCE_SIGMA * math.sqrt(spread / max(inside, 1) + spread / max(rows, 1)))


def judge_of_dynamics(residual: Residual) -> Judge:
    """Leaves what integrators may differ by, or a hundredth of the departure that is explained."""
    departures = _rms(residual, ())

    def judge(of: Residual, effects: Effects) -> dict[str, Leftover]:
        out = {}
        for name, rms, departure in zip(
            residual.link.channels, _rms(of, effects), departures, strict=True
        ):
            floor = DYNAMICS_FLOOR + (0.0 if of.link.timing == NO_SHIFT else DYNAMICS_INTERPOLATION)
            allowed = max(floor, MAX_COMPUTED_RESIDUAL * departure if effects else 0.0)
            out[name] = Leftover((rms / allowed) ** 2, 0.0, 1.0, 1.0, len(residual.runs))
        return out

    return judge


def judge_of_axis(link: AxisLink) -> Judge:
    """Measured, and integrated twice: no more than the noise, or than a hundredth of the motion."""
    squares = [(r.measured - r.measured.mean(axis=0)) ** 2 for r in link.runs]
    motion = float(np.sqrt(np.mean(np.concatenate(squares))))
    noise = min(float(r.sigma.min()) for r in link.runs)
    allowed = max(noise, MAX_COMPUTED_RESIDUAL * motion)

    def judge(of: Residual, effects: Effects) -> dict[str, Leftover]:
        placed = of.as_judged()
        left = [
            float(np.mean(z[placed.weight[i] > 0] ** 2)) * noise**2
            for i, z in zip(of.runs, placed.by_run([effects])[0], strict=True)
        ]
        return {link.channels[0]: Leftover(max(left) / allowed**2, 0.0, 1.0, 1.0, len(of.runs))}

    return judge


def _rms(residual: Residual, effects: Effects) -> list[float]:
    z = np.concatenate(residual.by_run([effects])[0])
    return [
        float(v) * DYNAMICS_FLOOR * math.sqrt(CORRELATED_ROWS)
        for v in np.sqrt(np.mean(z * z, axis=0))
    ]
