"""Stage "select": jitter, a delay that varies from sample to sample, as noise in proportion to the
rate of the reading; by likelihood.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from hiltestbed.diagnosis.adequacy import JITTER
from hiltestbed.diagnosis.fit import Fit, inflation, null_fit, refit
from hiltestbed.diagnosis.links import WrenchLink
from hiltestbed.diagnosis.links.base import Effects
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.diagnosis.settings import MAX_JITTER_CORRELATION, MIN_JITTER_SPREAD, MIN_LINEAR_GAIN
from hiltestbed.effects.search import Candidate
from hiltestbed.effects.table import EFFECTS
from hiltestbed.frames import Array

MAX_SIGMA = 0.02  # chosen: [s] largest standard deviation that is searched
SIGMAS_TRIED = 40
# chosen: of neighbours on a channel, whose correlation then is known to pi / 2 over ten: 0.16
MIN_PAIRS = 100
# chosen: on the first estimate, which treats the noise of a delay as small
REFINEMENT_FACTORS = (0.92, 1.0, 1.08)


def jitter_beside(residual: Residual, base: Fit, _known: float = math.inf) -> Fit | None:
    """Jitter beside `base`; None where the data show none."""
    link, effects = residual.link, base.effects()
    if not isinstance(link, WrenchLink) or JITTER in base.kinds:
        return None
    slopes = link.slopes(effects)
    worth = np.concatenate([(slopes[i] * residual.weight[i]).ravel() for i in residual.runs])

    def cost(sigma: float) -> float:
        s2 = 1.0 + (sigma * worth) ** 2
        return float(np.sum(base.residual**2 / s2 + np.log(s2)))

    sigmas = np.geomspace(1e-6, MAX_SIGMA, SIGMAS_TRIED)
    costs = [cost(s) for s in sigmas]
    at = int(np.argmin(costs))
    if at == SIGMAS_TRIED - 1:  # a spread that large explains any misfit
        return None
    ends = (sigmas[max(at - 1, 0)], sigmas[min(at + 1, SIGMAS_TRIED - 1)])
    found: Any = minimize_scalar(cost, bounds=ends, method="bounded", options={"xatol": 1e-9})
    if found.fun > base.chi2 - MIN_LINEAR_GAIN:
        return None
    best = float(found.x)
    spread = np.sqrt(1.0 + (best * worth) ** 2)
    z = base.residual / spread
    if not _independent(z, spread > MIN_JITTER_SPREAD, len(link.channels)) or not _centred(
        z, worth / spread, spread > MIN_JITTER_SPREAD
    ):
        return None
    tried = [
        (best * f, *_likelihood(link, residual, effects, best * f)) for f in REFINEMENT_FACTORS
    ]
    sigma, chi2, r = min(tried, key=lambda item: item[1])
    cause = Candidate(
        EFFECTS[JITTER],
        ("sigma",),
        np.array([0.0]),
        np.array([MAX_SIGMA]),
        np.array([False]),
        ((0.0,),),
    )
    return Fit(
        (*base.causes, cause),
        np.append(base.theta, sigma),
        chi2,
        r,
        np.column_stack([base.jacobian, np.zeros(len(r))]),
    )


def again(residual: Residual, found: Fit, known: float = math.inf) -> Fit:
    """The same hypothesis fitted again under other weights; known: as of
    :func:`~hiltestbed.diagnosis.fit.fit`.
    """
    if not found.causes or found.kinds[-1] != JITTER:
        return refit(residual, found, known)
    rest = replace(found, causes=found.causes[:-1], theta=found.theta[:-1])
    base = refit(residual, rest) if rest.causes else null_fit(residual)
    return jitter_beside(residual, base) or found


def _likelihood(
    link: WrenchLink, residual: Residual, effects: Effects, sigma: float
) -> tuple[float, Array]:
    """Minus twice the log-likelihood, and the residual in units of noise and spread, for a delay
    with standard deviation sigma.
    """
    total, parts = 0.0, []
    for i in residual.runs:
        mean, spread = link.shaken(i, effects, sigma)
        s2 = 1.0 + (spread * residual.weight[i]) ** 2
        z = residual.left(i, mean) * residual.weight[i] / np.sqrt(s2)
        total += float(np.sum(z * z) + np.sum(np.log(s2)))
        parts.append(z.ravel())
    return total, np.concatenate(parts)


def _independent(z: Array, where: np.ndarray, channels: int) -> bool:
    """Whether neighbouring samples are independent, as jitter makes them: together, and on each
    channel with enough of them.

    By their signs, of which a share of asin(r) / pi more than half agree at a correlation of r (W.
    F. Sheppard, Phil. Trans. A 192, 1899): a few samples that are far off, as at a touch, do not
    hide that all others follow one another.
    """
    signs, where = np.sign(z).reshape(-1, channels), where.reshape(-1, channels)
    pairs = where[1:] & where[:-1]
    counts = np.sum(pairs, axis=0)
    products = np.sum(np.where(pairs, signs[1:] * signs[:-1], 0.0), axis=0)
    many = counts >= MIN_PAIRS
    most = 2.0 / math.pi * math.asin(MAX_JITTER_CORRELATION)
    alike = abs(float(products.sum())) < most * int(counts.sum())
    return alike and bool(np.all(products[many] < most * counts[many]))


def _centred(z: Array, worth: Array, where: np.ndarray) -> bool:
    """Whether the delay varies about the believed one: a constant delay would correlate with the
    rate of the reading, `worth`.
    """
    z, worth = z[where], worth[where]
    return abs(float(np.sum(z * worth))) < MAX_JITTER_CORRELATION * math.sqrt(
        square(z) * square(worth)
    )


__all__ = ["again", "inflation", "jitter_beside"]
