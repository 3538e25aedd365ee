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
    """Nuisance terms of one run under the weights (N, C) of its misfits, each at one standard
    deviation: ``columns`` (N, C, D), whose amplitudes differ from channel to channel, and
    ``shared`` (N, C, D'), each of which has one amplitude in all channels, like an error of an
    input that all of them follow from.

    With unit noise and terms U = Q S V^T in units of it, (1 + U U^T)^(-1/2) = 1 - Q (1 - (1 +
    S^2)^(-1/2)) Q^T whitens the misfits: by the columns first, then by the shared terms as these
    leave them.
    """

    def __init__(self, weight: Array, columns: Array | None, shared: Array | None = None) -> None:
        self._weight = weight
        self._inverse = np.divide(1.0, weight, out=np.zeros_like(weight), where=weight > 0.0)
        self._own = self._all = None
        if columns is not None:
            self._own = _basis(np.moveaxis(columns * weight[:, :, None], 1, 0))  # (C, N, D)
        if shared is not None:
            terms = np.moveaxis(shared * weight[:, :, None], 2, 0)  # (D', N, C)
            white = np.stack([self._without_own(term).ravel() for term in terms], axis=1)
            self._all = _basis(white)

    def of(self, left: Array) -> Array:
        """``(N, C)`` part of misfits (N, C) that whitening takes away."""
        misfit = self._weight * left
        white = self._without_own(misfit)
        if self._all is not None:
            q, share = self._all
            flat = white.ravel()
            along = np.einsum("md,m->d", q, flat) * share
            white = (flat - np.einsum("md,d->m", q, along)).reshape(white.shape)
        return (misfit - white) * self._inverse

    def _without_own(self, misfit: Array) -> Array:
        """Misfits (N, C) in units of the noise, whitened by the columns of each channel."""
        if self._own is None:
            return misfit
        q, share = self._own
        along = np.einsum("cnd,nc->cd", q, misfit) * share
        return misfit - np.einsum("cnd,cd->nc", q, along)


def _basis(terms: Array) -> tuple[Array, Array]:
    """Q of terms (..., N, D), and the share of a misfit along each that whitening takes away."""
    q, s, _ = np.linalg.svd(terms, full_matrices=False)
    return q, 1.0 - 1.0 / np.hypot(1.0, s)


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
