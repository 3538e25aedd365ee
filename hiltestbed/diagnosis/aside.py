"""Stage "layout": nuisance terms of each run: baseline wander and hum whose phase differs between runs. No misfit is judged by them.

Where free flight shows them beyond what its noise would do, cubics and tones of each run and channel are projected out of every misfit, of
measured and predicted alike: their amplitudes are nuisance parameters, which linear least squares eliminates at no cost.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.polynomial import legendre
from scipy.stats import chi2

from hiltestbed.diagnosis.settings import SIGNIFICANCE_LEVEL
from hiltestbed.frames import Array

BASELINE_DEGREE = 3  # chosen: of the polynomials; three quarters of a slow period are a cubic to a tenth
MIN_BASELINE_ROWS = 60  # chosen: rows of a run, from which its baseline is estimated


class Aside:
    """Polynomials and tones of one run, fitted under the weights (N, C) of its misfits."""

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
        """``(N, C)`` part of misfits (N, C) that they explain."""
        return self._basis @ np.einsum("cdn,nc->dc", self._solve, left)


def baselines_differ(free: Sequence[tuple[Array, Array]], spread: Array) -> bool:
    """Whether the baselines' shapes differ between runs, beyond chance.

    Args:
        free: of each run, rows (M,) scaled from -1 to 1 and readings there (M, C). spread: (C,) standard deviation of the noise, as it acts
            on smooth departures.
    """
    found, errors = [], []
    for at, readings in free:
        if len(at) < MIN_BASELINE_ROWS or not (spread > 0.0).all():
            continue
        basis = legendre.legvander(at, BASELINE_DEGREE)
        inverse = np.linalg.inv(basis.T @ basis)
        found.append((inverse @ basis.T @ readings)[1:])
        errors.append(np.sqrt(np.diag(inverse))[1:, None] * spread)
    if len(found) < 2:
        return False
    coefficients, error = np.array(found), np.array(errors)
    weight = 1.0 / error**2
    shared = (weight * coefficients).sum(axis=0) / weight.sum(axis=0)
    freedom = (len(found) - 1) * shared.size
    return float(np.sum(weight * (coefficients - shared) ** 2)) > float(chi2.isf(SIGNIFICANCE_LEVEL, freedom))
