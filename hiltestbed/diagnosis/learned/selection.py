"""Piecewise-linear curves, and the selection of the number of knots of each curve of a law: those
that lower the residual on left-out runs.

A curve with few knots is one among the finest that a law may have: a hat on every second knot is a
sum of hats on all knots. About a law the residual is linear in the values at the knots, r + J d, so
that leaving a run out takes the normal equations of the others and no replay.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from hiltestbed.frames import Array

# chosen: share of the residual on left-out runs (geometric mean) by which a further knot, curve or
# cause has to lower it
MIN_HELDOUT_GAIN = 0.02
LEAST_LOSS = -math.log(1.0 - MIN_HELDOUT_GAIN)  # the same of the mean logarithm of the rms
# chosen: weight of a squared second difference, of the mean square response of a knot; for knots
# without data
KNOT_SMOOTHING = 1e-4
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
        levels: numbers of knots, K at most, each one more than a divisor of K - 1; odd if the knots
            lie on both sides of 0.
        part: whether it is a factor on another force, which is extrapolated as a constant, and not
            a force, extrapolated with its slope.
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


class Choice(NamedTuple):
    """The form of a block's curve: its number of knots, 1 for a constant; odd: whether it is
    antisymmetric about 0.
    """

    knots: int
    odd: bool

    def every(self, finest: int) -> int:
        """Step from one of its knots to the next, in those of the ``finest``."""
        return (finest - 1) // max(1, self.knots - 1)


Choices = tuple[Choice | None, ...]  # of each block; None: it is left out


def choices(block: Block) -> list[Choice]:
    """All forms that a block allows, those with the fewest numbers first."""
    free = block.part or block.two_sided or not block.zero
    odds = (False,) if block.part else (True, False) if free else (True,)
    out = [Choice(n, odd) for n in block.levels for odd in odds]
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
        return hats[:, np.abs(coarse) > 1e-9 * (coarse[-1] - coarse[0])]
    return hats


def shape(blocks: Sequence[Block], chosen: Choices) -> Array:
    """``(P, Q)`` basis of all blocks."""
    return np.asarray(block_diag(*(shape_of(b, c) for b, c in zip(blocks, chosen, strict=True))))


def roughness(blocks: Sequence[Block]) -> Array:
    """``(P, P)`` regularisation: squared second differences of all curves and a little of their
    squares, for knots without data.
    """
    parts = []
    for b in blocks:
        values = np.eye(len(b.places))
        second, first = np.diff(values, 2, axis=0), b.part * np.diff(values, axis=0)
        parts.append(second.T @ second + SLOPE_COST * first.T @ first + VALUE_COST * values)
    return np.asarray(block_diag(*parts))


@dataclass(frozen=True)
class Linear:
    """A family linearised about a law: residual (M,) and Jacobian (M, P) of each run, in the rows
    that count.
    """

    residuals: Sequence[Array]
    jacobians: Sequence[Array]

    @cached_property
    def squares(self) -> Array:
        """(R, P, P) J'J of each run."""
        return np.array([j.T @ j for j in self.jacobians])

    @cached_property
    def gradients(self) -> Array:
        """(R, P) J'r of each run."""
        pairs = zip(self.residuals, self.jacobians, strict=True)
        return np.array([r @ j for r, j in pairs])

    def solve(
        self, runs: Sequence[int], basis: Array, rough: Array, start: Array | None = None
    ) -> Array:
        """``(P,)`` change of the values that fits the ``runs`` best within the ``basis`` (P, Q);
        start: (P,) the law that it changes.
        """
        within = basis.T @ self.squares[list(runs)].sum(axis=0) @ basis
        pull = KNOT_SMOOTHING * float(np.mean(np.diag(within))) * (basis.T @ rough)
        aim = -(basis.T @ self.gradients[list(runs)].sum(axis=0))
        aim = aim if start is None else aim - pull @ start
        return np.asarray(basis @ np.linalg.lstsq(within + pull @ basis, aim, rcond=1e-13)[0])

    def carried(self, basis: Array, rough: Array) -> float:
        """Mean over the runs of the logarithm of the rms, each run left out of the fit."""
        total, runs = 0.0, range(len(self.residuals))
        for i in runs:
            change, r = np.zeros(len(basis)), self.residuals[i]
            if basis.shape[1]:
                change = self.solve([j for j in runs if j != i], basis, rough)
            least = float(r @ r)
            left = least + (2.0 * self.gradients[i] + self.squares[i] @ change) @ change
            total += 0.5 * math.log(max(left, 1e-12 * least) / max(1, len(r)))
        return total / len(runs)


class Selected(NamedTuple):
    """The form of every block, the residual on left-out runs (see :meth:`Linear.carried`), and how
    many numbers it takes.
    """

    choices: Choices
    carried: float
    numbers: int


def select(linear: Linear, blocks: Sequence[Block]) -> Selected:
    """Curve by curve and knot by knot, as long as the residual on left-out runs falls by
    MIN_HELDOUT_GAIN; then with fewer numbers, as long as it rises by less than that.
    """
    shapes = [{c: shape_of(b, c) for c in (None, *choices(b))} for b in blocks]
    rough, known = roughness(blocks), dict[Choices, Selected]()

    def scored(chosen: Choices) -> Selected:
        if chosen not in known:
            parts = (s[c] for s, c in zip(shapes, chosen, strict=True))
            basis = np.asarray(block_diag(*parts))
            known[chosen] = Selected(chosen, linear.carried(basis, rough), basis.shape[1])
        return known[chosen]

    def beside(chosen: Choices, leave_out: bool) -> Iterator[Selected]:
        """The choices that differ from one in one block."""
        for i, own in enumerate(shapes):
            for c in own:
                if c != chosen[i] and (leave_out or c is not None):
                    yield scored((*chosen[:i], c, *chosen[i + 1 :]))

    best = scored((None,) * len(blocks))
    while True:
        found = min(beside(best.choices, False), key=lambda s: s.carried)
        if found.carried > best.carried - LEAST_LOSS:
            break
        best = found
    limit = best.carried + LEAST_LOSS
    while True:
        fewer = [s for s in beside(best.choices, True) if s.numbers < best.numbers]
        fewer = [s for s in fewer if s.carried < limit]
        if not fewer:
            return best
        best = min(fewer, key=lambda s: (s.numbers, s.carried))
