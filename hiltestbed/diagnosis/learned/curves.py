"""Curves of few knots out of the finest that a law may have: hats on every second knot are sums of hats on all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from hiltestbed.frames import Array

LEVEL = 3.0  # of a squared second difference: what a squared first one of a part costs
LITTLE = 1e-6  # of a squared second difference: what a square costs, so that nothing is left open


@dataclass(frozen=True)
class Block:
    """One curve of a law on its finest knots.

    Attributes:
        name: the parameter of the effect.
        places: (K,), as far on one side of 0 as on the other, or on one side alone. zero: whether the curve is 0 at 0 whatever it is.
        part: whether it is a part of another force, which is constant where there are no data, and not a force, whose slope is.
        levels: numbers of knots, K at most, each one more than a part of K - 1; uneven on two sides of 0.
    """

    name: str
    places: Array
    zero: bool
    levels: tuple[int, ...]
    part: bool = False

    @property
    def two_sided(self) -> bool:
        """Whether the places lie on both sides of 0, as far on either."""
        return bool(self.places[0] < 0.0 < self.places[-1])


@dataclass(frozen=True)
class Choice:
    """Which of the curves that a block allows: on so many knots, 1 for a constant; odd: as large on either side of 0, and 0 there."""

    knots: int
    odd: bool

    def every(self, finest: int) -> int:
        """From one of its knots to the next, in those of the ``finest``."""
        return (finest - 1) // max(1, self.knots - 1)


def choices(block: Block) -> list[Choice]:
    """All that a block allows, with the fewest numbers first."""
    odds = (True, False) if not block.part else (False,)
    out = [Choice(n, odd) for n in block.levels for odd in odds if odd or block.part or block.two_sided or not block.zero]
    return sorted(out, key=lambda c: (shape_of(block, c).shape[1], c.knots))


def shape_of(block: Block, choice: Choice | None) -> Array:
    """``(K, Q)`` what each of the numbers of a choice adds to the finest knots; no column for None, a block that is left out."""
    fine = len(block.places)
    if choice is None:
        return np.zeros((fine, 0))
    if choice.knots == 1:
        return np.ones((fine, 1))
    coarse = block.places[:: choice.every(fine)]
    hats = np.column_stack([np.interp(block.places, coarse, row) for row in np.eye(choice.knots)])
    if choice.odd and block.two_sided:
        half = choice.knots // 2
        return hats[:, ::-1][:, :half] - hats[:, :half]
    if choice.odd or block.zero:
        keep = np.abs(coarse) > 1e-9 * (coarse[-1] - coarse[0])
        hats = hats[:, keep]
    return hats


def roughness(blocks: Sequence[Block]) -> Array:
    """``(P, P)`` sum of squared second differences of all curves, and a little of their squares: for knots where there are no data."""
    parts = []
    for b in blocks:
        second = np.diff(np.eye(len(b.places)), 2, axis=0)
        first = np.diff(np.eye(len(b.places)), axis=0) if b.part else np.zeros_like(second)
        parts.append(second.T @ second + LEVEL * first.T @ first + LITTLE * np.eye(len(b.places)))
    return np.asarray(block_diag(*parts))
