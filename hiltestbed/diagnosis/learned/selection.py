"""Selection of the number of knots of each curve of a law: those that lower the residual on
left-out runs.

About a law the residual is linear in the values at the knots, r + J d, so that leaving a run out
takes the normal equations of the others and no replay.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from hiltestbed.diagnosis.learned.curves import Block, Choice, choices, roughness, shape_of
from hiltestbed.diagnosis.settings import KNOT_SMOOTHING, MIN_HELDOUT_GAIN
from hiltestbed.frames import Array

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
