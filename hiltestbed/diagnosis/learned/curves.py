"""Piecewise-linear curves with few knots among the finest a law may have: a hat on every second
knot is a sum of hats on all knots.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from hiltestbed.frames import Array

# chosen: of a squared first difference of a part, relative to a squared second one
SLOPE_COST = 3.0
# chosen: of a squared value, relative to a squared second difference, so that every value is
# determined
VALUE_COST = 1e-6


@dataclass(frozen=True)
class Block:
    """One curve of a law on its finest knots.

    Attributes:
        name: the parameter of the effect.
        places: (K,) abscissae, symmetric about 0 or on one side of it. zero: whether the curve must
            be 0 at 0.
        part: whether it is a factor on another force, which is extrapolated as a constant, and not
            a force, extrapolated with its slope.
        levels: numbers of knots, K at most, each one more than a divisor of K - 1; odd if the knots
            lie on both sides of 0.
    """

    name: str
    places: Array
    zero: bool
    levels: tuple[int, ...]
    part: bool = False

    @property
    def two_sided(self) -> bool:
        """Whether the abscissae lie on both sides of 0."""
        return bool(self.places[0] < 0.0 < self.places[-1])


@dataclass(frozen=True)
class Choice:
    """The form of a block's curve: its number of knots, 1 for a constant; odd: whether it is
    antisymmetric about 0.
    """

    knots: int
    odd: bool

    def every(self, finest: int) -> int:
        """Step from one of its knots to the next, in those of the ``finest``."""
        return (finest - 1) // max(1, self.knots - 1)


def choices(block: Block) -> list[Choice]:
    """All forms that a block allows, those with the fewest numbers first."""
    odds = (True, False) if not block.part else (False,)
    out = [
        Choice(n, odd)
        for n in block.levels
        for odd in odds
        if odd or block.part or block.two_sided or not block.zero
    ]
    return sorted(out, key=lambda c: (shape_of(block, c).shape[1], c.knots))


def shape_of(block: Block, choice: Choice | None) -> Array:
    """``(K, Q)`` basis of a form: its Q numbers to values on the finest knots; no column for None,
    a block that is left out.
    """
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
    """``(P, P)`` regularisation: squared second differences of all curves and a little of their
    squares, for knots without data.
    """
    parts = []
    for b in blocks:
        second = np.diff(np.eye(len(b.places)), 2, axis=0)
        first = np.diff(np.eye(len(b.places)), axis=0) if b.part else np.zeros_like(second)
        parts.append(
            second.T @ second + SLOPE_COST * first.T @ first + VALUE_COST * np.eye(len(b.places))
        )
    return np.asarray(block_diag(*parts))
