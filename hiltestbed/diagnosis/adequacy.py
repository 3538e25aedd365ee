"""Stage "select": goodness of fit: whether the residual of a hypothesis is noise, channel by
channel, in contact and outside it.

Two statistics a channel, both 1 for white noise at the floor: the variance ratio, and the same for
means of blocks of samples, in which a smooth misfit far below the noise shows. The samples of a
block count once, so that correlated residuals do not count as many samples.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hiltestbed.diagnosis.fit import predicted
from hiltestbed.diagnosis.links import Link, WrenchLink
from hiltestbed.diagnosis.links.base import Effects
from hiltestbed.diagnosis.noise import softened
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.settings import (
    ADEQUACY_SIGMA,
    BLOCK_ROWS,
    FLOOR_ERROR,
    FLOOR_ROWS,
    MIN_FREE_ROWS,
    MODEL_ERROR,
)
from hiltestbed.effects.base import Effect
from hiltestbed.frames import Array

JITTER = "sensor.jitter"


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


def noise_alone(leftovers: Mapping[str, Leftover]) -> bool:
    """Whether the residual passes for noise on every channel."""
    return all(left.noise for left in leftovers.values())


def leftover(residuals: list[Array], tail: float = 2.0, rows: int = FLOOR_ROWS) -> Leftover:
    """Of one channel; residuals: one array a run (or contact), in units of the noise; tail:
    variance of the square of a noise sample;
    rows: from which the noise floor was estimated.
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
    for i, prediction in zip(residual.runs, predicted(residual, effects), strict=True):
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


def _read_from(link: Link) -> int:
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
