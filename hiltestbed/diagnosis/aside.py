"""Stage "layout": nuisance terms of each run, such as baseline wander, or hum whose phase differs
between runs.

Their amplitudes in a run are not known, but how large they are as a rule is: as large as they
differ between the runs. Misfits are whitened by the covariance of noise and nuisances together, at
no cost for each hypothesis. What the runs have in common beyond that remains a
misfit: a baseline that wanders by 0.1 N from run to run does not hide a bias of 2 N.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.polynomial import legendre
from scipy.stats import chi2
from scipy.stats import f as fisher

from hiltestbed.diagnosis.settings import DETECTION, SIGNIFICANCE_LEVEL
from hiltestbed.frames import Array

# chosen: of the polynomials; three quarters of a slow period are a quintic to half a percent
BASELINE_DEGREE = 5
MIN_BASELINE_ROWS = 60  # chosen: rows of a run, from which its baseline is estimated
UNKNOWN = 1e6  # chosen: times the noise: an amplitude of which nothing is known


class Aside:
    """Nuisance terms of one run under the weights (N, C) of its misfits; ``columns`` (N, C, D):
    each term at one standard deviation.

    With unit noise and terms U = Q S V^T in units of it, (1 + U U^T)^(-1/2) = 1 - Q (1 - (1 +
    S^2)^(-1/2)) Q^T whitens the misfits.
    """

    def __init__(self, weight: Array, columns: Array) -> None:
        terms = np.moveaxis(columns * weight[:, :, None], 1, 0)  # (C, N, D)
        q, s, _ = np.linalg.svd(terms, full_matrices=False)
        self._q, self._share = q, 1.0 - 1.0 / np.hypot(1.0, s)
        self._weight, self._inverse = (
            weight,
            np.divide(1.0, weight, out=np.zeros_like(weight), where=weight > 0.0),
        )

    def of(self, left: Array) -> Array:
        """``(N, C)`` part of misfits (N, C) that whitening takes away."""
        along = np.einsum("cnd,nc->cd", self._q, self._weight * left) * self._share
        return np.einsum("cnd,cd->nc", self._q, along) * self._inverse


def baseline_terms(places: Array, degree: int) -> Array:
    """``(N, D)`` polynomials at places (N,) from -1 to 1."""
    return np.asarray(legendre.legvander(places, degree), dtype=np.float64)


def wander_between(free: Sequence[tuple[Array, Array]], spread: Array) -> Array | None:
    """(D, C) standard deviation of the baselines' coefficients between runs; None where their
    shapes differ by no more than chance.

    It is larger than that of the coefficients on hand, so far that what the runs share passes for a
    cause as rarely as noise does, however
    few they are: F(1, n - 1) and not chi-square is the distribution of its square.

    Args:
        free: of each run, rows (M,) scaled from -1 to 1 and readings there (M, C). spread: (C,)
            standard deviation of the noise, as it acts on smooth departures.
    """
    found, errors = [], []
    for at, readings in free:
        if len(at) < MIN_BASELINE_ROWS or not (spread > 0.0).all():
            continue
        # stable where rows are close together
        q, r = np.linalg.qr(baseline_terms(at, BASELINE_DEGREE))
        inverse = np.linalg.inv(r)
        found.append(inverse @ (q.T @ readings))
        errors.append(np.sqrt((inverse**2).sum(axis=1))[:, None] * spread)
    if len(found) < 2:
        return None
    coefficients, error = np.array(found), np.array(errors)
    weight = 1.0 / error**2
    shared = (weight * coefficients).sum(axis=0) / weight.sum(axis=0)
    freedom = (len(found) - 1) * shared[1:].size  # an offset has no shape
    apart = (weight * (coefficients - shared) ** 2)[:, 1:]
    if float(np.sum(apart)) <= float(chi2.isf(SIGNIFICANCE_LEVEL, freedom)):
        return None
    few = max(float(fisher.isf(SIGNIFICANCE_LEVEL, 1, len(found) - 1)) / DETECTION, 1.0)
    return np.asarray(np.sqrt(few * coefficients.var(axis=0, ddof=1)))
