"""Whether what a hypothesis leaves over is noise: judged channel by channel, in contact samples alone where there is a contact.

Two figures a channel, both 1 for white noise at the floor: the variance ratio, and the same for means of blocks of samples, in which a
smooth misfit far below the noise shows. Samples of one block count once, so that correlated leftovers are not taken for many.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hiltestbed.frames import Array

BLOCK = 8  # samples
SPREAD = 4.5  # standard deviations that a figure may lie off: some 30 figures are looked at
FLOOR_ERROR = 0.08  # a noise floor is known to some percent
MODEL_ERROR = 1e-3  # of the signal: another sub-stepping, another interpolation


@dataclass(frozen=True)
class Leftover:
    """What is left on one channel: variance ratio, block ratio, their limits, samples."""

    variance: float
    block: float
    variance_limit: float
    block_limit: float
    samples: int

    @property
    def noise(self) -> bool:
        """Whether it passes for noise."""
        return self.variance <= self.variance_limit and self.block <= self.block_limit

    @property
    def excess(self) -> float:
        """How far the worse figure lies above its limit: 1 is just there."""
        return max(self.variance / self.variance_limit, self.block / self.block_limit)


def leftover(residuals: list[Array]) -> Leftover:
    """Of one channel; residuals: one array a run (or contact), in units of the noise."""
    total, squares, sums, blocks = 0, 0.0, 0.0, 0
    for r in residuals:
        total += len(r)
        squares += float(r @ r)
        whole = len(r) // BLOCK
        means = r[: whole * BLOCK].reshape(whole, BLOCK).sum(axis=1) / math.sqrt(BLOCK)
        sums += float(means @ means)
        blocks += whole
    return Leftover(
        squares / max(total, 1),
        sums / max(blocks, 1),
        1.0 + FLOOR_ERROR + SPREAD * math.sqrt(2.0 / max(total, 1)),
        1.0 + FLOOR_ERROR + SPREAD * math.sqrt(2.0 / max(blocks, 1)) + (1.0 if blocks < 10 else 0.0),
        total,
    )


def soften(sigma: Array, signal: Array) -> Array:
    """The noise with a model error in proportion to the signal, both (N, C)."""
    return np.sqrt(sigma**2 + (MODEL_ERROR * signal) ** 2)
