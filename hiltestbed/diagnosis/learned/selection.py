"""Piecewise-linear curves, and the selection of the number of knots of each curve of a law: those
that lower the residual on left-out runs.

A curve with few knots is one among the finest that a law may have: a hat on every second knot is a
sum of hats on all knots. About a law the residual is linear in the values at the knots, r + J d, so
that leaving a run out takes the normal equations of the others and no replay.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from hiltestbed.diagnosis.settings import KNOT_SMOOTHING, MIN_HELDOUT_GAIN
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


Choices = tuple[Choice | None, ...]  # of each block


@dataclass(frozen=True)
class Normal:
    """The normal equations of each run: J'J (R, P, P), J'r (R, P), r'r (R,) and the number of
    samples (R,).
    """

    squares: Array
    gradients: Array
    left: Array
    samples: Array


@dataclass(frozen=True)
class Selected:
    """The form of every block, and the residual on left-out runs: mean over them of the logarithm
    of the rms.
    """

    choices: Choices
    carried: float


def normal_equations(residuals: Sequence[Array], jacobians: Sequence[Array]) -> Normal:
    """The normal equations of one residual (M,) and one Jacobian (M, P) a run."""
    return Normal(
        np.array([np.einsum("mi,mj->ij", j, j) for j in jacobians]),
        np.array([np.einsum("mi,m->i", j, r) for j, r in zip(jacobians, residuals, strict=True)]),
        np.array([float(r @ r) for r in residuals]),
        np.array([max(1, len(r)) for r in residuals]),
    )


def shape(blocks: Sequence[Block], chosen: Choices) -> Array:
    """``(P, Q)`` basis of all blocks."""
    return np.asarray(block_diag(*(shape_of(b, c) for b, c in zip(blocks, chosen, strict=True))))


def solve(
    normal: Normal, runs: Sequence[int], basis: Array, rough: Array, start: Array | None = None
) -> Array:
    """``(P,)`` change of the values that fits the ``runs`` best within the ``basis`` (P, Q); start:
    (P,) the law that it changes.
    """
    squares, gradient = (
        normal.squares[list(runs)].sum(axis=0),
        normal.gradients[list(runs)].sum(axis=0),
    )
    within = basis.T @ squares @ basis
    weight = KNOT_SMOOTHING * float(np.mean(np.diag(within)))
    pull = np.zeros(basis.shape[1]) if start is None else weight * (basis.T @ rough @ start)
    found = np.linalg.lstsq(
        within + weight * (basis.T @ rough @ basis), -(basis.T @ gradient) - pull, rcond=1e-13
    )[0]
    return np.asarray(basis @ found)


def left_by(normal: Normal, run: int, change: Array) -> float:
    """Mean square of a run's residual after a change of the values."""
    total = (
        normal.left[run]
        + 2.0 * normal.gradients[run] @ change
        + change @ normal.squares[run] @ change
    )
    return float(max(total, 1e-12 * normal.left[run]) / normal.samples[run])


def carried_by(normal: Normal, basis: Array, rough: Array) -> float:
    """Mean over the runs of the logarithm of the rms, each run left out of the fit."""
    runs = range(len(normal.left))
    if basis.shape[1] == 0:
        return float(
            np.mean([0.5 * math.log(left_by(normal, i, np.zeros(len(basis)))) for i in runs])
        )
    return float(
        np.mean(
            [
                0.5
                * math.log(
                    left_by(normal, i, solve(normal, [j for j in runs if j != i], basis, rough))
                )
                for i in runs
            ]
        )
    )


def select(normal: Normal, blocks: Sequence[Block]) -> Selected:
    """Curve by curve and knot by knot, as long as the residual on left-out runs falls by
    MIN_HELDOUT_GAIN.
    """
    search = _Search(normal, blocks)
    best: Choices = (None,) * len(blocks)
    carried = search.carried(best)
    while True:
        found = [(search.carried(t), t) for t in search.beside(best)]
        lowest, chosen = min(found, key=lambda item: item[0])
        if lowest > carried + math.log(1.0 - MIN_HELDOUT_GAIN):
            break
        best, carried = chosen, lowest
    return _slimmed(search, best, carried)


def _slimmed(search: _Search, best: Choices, carried: float) -> Selected:
    """With fewer numbers, as long as the residual rises by less than that."""
    limit = carried - math.log(1.0 - MIN_HELDOUT_GAIN)
    while True:
        fewer = [
            t
            for t in search.beside(best, leave_out=True)
            if search.numbers(t) < search.numbers(best)
        ]
        near = [t for t in fewer if search.carried(t) < limit]
        if not near:
            return Selected(best, search.carried(best))
        best = min(near, key=lambda t: (search.numbers(t), search.carried(t)))


class _Search:
    """The residual of every choice, computed once."""

    def __init__(self, normal: Normal, blocks: Sequence[Block]) -> None:
        self._normal, self._rough = normal, roughness(blocks)
        self._shapes = [{c: shape_of(b, c) for c in (None, *choices(b))} for b in blocks]
        self._known: dict[Choices, float] = {}

    def numbers(self, chosen: Choices) -> int:
        """How many numbers a choice has."""
        return sum(s[c].shape[1] for s, c in zip(self._shapes, chosen, strict=True))

    def carried(self, chosen: Choices) -> float:
        """`carried_by` of a choice, computed once."""
        if chosen not in self._known:
            basis = np.asarray(
                block_diag(*(s[c] for s, c in zip(self._shapes, chosen, strict=True)))
            )
            self._known[chosen] = carried_by(self._normal, basis, self._rough)
        return self._known[chosen]

    def beside(self, chosen: Choices, leave_out: bool = False) -> list[Choices]:
        """The choices that differ from one in one block."""
        out = []
        for i, shapes in enumerate(self._shapes):
            others = [c for c in shapes if c != chosen[i] and (c is not None or leave_out)]
            out += [(*chosen[:i], c, *chosen[i + 1 :]) for c in others]
        return out
