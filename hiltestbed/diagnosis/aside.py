"""What differs from run to run and is in the contact too: a baseline that wanders, mains of another phase. No misfit is judged by it.

Where free flight shows it, beyond what its noise would do, cubics and tones of each run and channel are taken out of every misfit, of
what was measured and what is predicted alike: their sizes are parameters that nobody asks for, and least squares has them at no cost.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.polynomial import legendre
from scipy.stats import chi2

from hiltestbed.diagnosis.settings import BY_CHANCE
from hiltestbed.frames import Array

DEGREE = 3  # of the polynomials: three quarters of a slow turn are a cubic to a tenth
ENOUGH = 60  # rows of a run, from which its baseline is read


class Aside:
    """Polynomials and tones of one run on its rows, under the weights (N, C) of its misfits."""

    def __init__(self, weight: Array, degree: int, tones: Sequence[float]) -> None:
        """degree: of the polynomial, -1 for none; tones: [rad] a row."""
        rows = np.arange(len(weight))
        columns = [legendre.legvander(np.linspace(-1.0, 1.0, len(weight)), degree)] if degree >= 0 else []
        columns += [np.column_stack([np.sin(w * rows), np.cos(w * rows)]) for w in tones]
        self._basis = np.concatenate(columns, axis=1)
        weighted = self._basis[:, None, :] * weight[:, :, None] ** 2  # (N, C, D)
        normal = np.einsum("nd,nce->cde", self._basis, weighted)
        self._solve = np.einsum("cde,nce->cdn", np.linalg.pinv(normal, hermitian=True), weighted)

    def of(self, left: Array) -> Array:
        """``(N, C)`` their part of misfits (N, C)."""
        return self._basis @ np.einsum("cdn,nc->dc", self._solve, left)


def wanders(free: Sequence[tuple[Array, Array]], spread: Array) -> bool:
    """Whether baselines bend otherwise from run to run.

    Args:
        free: of each run rows (M,) as parts of it from -1 to 1, and readings there (M, C). spread: (C,) standard deviation of the noise, as
            smooth departures see it.
    """
    found, errors = [], []
    for at, readings in free:
        if len(at) < ENOUGH or not (spread > 0.0).all():
            continue
        basis = legendre.legvander(at, DEGREE)
        inverse = np.linalg.inv(basis.T @ basis)
        found.append((inverse @ basis.T @ readings)[1:])
        errors.append(np.sqrt(np.diag(inverse))[1:, None] * spread)
    if len(found) < 2:
        return False
    coefficients, error = np.array(found), np.array(errors)
    weight = 1.0 / error**2
    shared = (weight * coefficients).sum(axis=0) / weight.sum(axis=0)
    freedom = (len(found) - 1) * shared.size
    return float(np.sum(weight * (coefficients - shared) ** 2)) > float(chi2.isf(BY_CHANCE, freedom))
