"""A delay that varies from sample to sample: noise in proportion to the rate of the reading, found by likelihood."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from hiltestbed.diagnosis.adequacy import JITTER
from hiltestbed.diagnosis.fit import Fit, inflation, nothing, refit
from hiltestbed.diagnosis.links import WrenchLink
from hiltestbed.diagnosis.links.base import Effects
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.diagnosis.settings import SAME_AGAIN, SHAKEN, WORTH_A_FIT
from hiltestbed.effects.search import Candidate
from hiltestbed.effects.table import EFFECTS
from hiltestbed.frames import Array

LONGEST = 0.02  # [s] standard deviation that is searched
SIGMAS = 40
REFINED = (0.92, 1.0, 1.08)  # of the first estimate, which takes the spread for small


def jitter_beside(residual: Residual, base: Fit) -> Fit | None:
    """A varying delay beside `base`; None where the data show none."""
    link, effects = residual.link, base.effects()
    if not isinstance(link, WrenchLink) or JITTER in base.kinds:
        return None
    slopes = link.slopes(effects)
    worth = np.concatenate([(slopes[i] * residual.weight[i]).ravel() for i in residual.runs])

    def cost(sigma: float) -> float:
        s2 = 1.0 + (sigma * worth) ** 2
        return float(np.sum(base.residual**2 / s2 + np.log(s2)))

    sigmas = np.geomspace(1e-6, LONGEST, SIGMAS)
    costs = [cost(s) for s in sigmas]
    at = int(np.argmin(costs))
    ends = (sigmas[max(at - 1, 0)], sigmas[min(at + 1, SIGMAS - 1)])
    found: Any = minimize_scalar(cost, bounds=ends, method="bounded", options={"xatol": 1e-9})
    if found.fun > base.chi2 - WORTH_A_FIT:
        return None
    best = float(found.x)
    spread = np.sqrt(1.0 + (best * worth) ** 2)
    z = base.residual / spread
    if not _independent(z, spread > SHAKEN, len(link.channels)) or not _centred(z, worth / spread, spread > SHAKEN):
        return None
    tried = [(best * f, *_likelihood(link, residual, effects, best * f)) for f in REFINED]
    sigma, chi2, r = min(tried, key=lambda item: item[1])
    cause = Candidate(EFFECTS[JITTER], ("sigma",), np.array([0.0]), np.array([LONGEST]), np.array([False]), ((0.0,),))
    return Fit((*base.causes, cause), np.append(base.theta, sigma), chi2, r, np.column_stack([base.jacobian, np.zeros(len(r))]))


def again(residual: Residual, found: Fit) -> Fit:
    """The same hypothesis under other weights."""
    if not found.causes or found.kinds[-1] != JITTER:
        return refit(residual, found)
    rest = replace(found, causes=found.causes[:-1], theta=found.theta[:-1])
    base = refit(residual, rest) if rest.causes else nothing(residual)
    return jitter_beside(residual, base) or found


def _likelihood(link: WrenchLink, residual: Residual, effects: Effects, sigma: float) -> tuple[float, Array]:
    """Chi-square with the cost of the spread, and the residual in units of noise and spread, for a delay that varies by sigma."""
    total, parts = 0.0, []
    for i in residual.runs:
        mean, spread = link.shaken(i, effects, sigma)
        s2 = 1.0 + (spread * residual.weight[i]) ** 2
        z = residual.left(i, mean) * residual.weight[i] / np.sqrt(s2)
        total += float(np.sum(z * z) + np.sum(np.log(s2)))
        parts.append(z.ravel())
    return total, np.concatenate(parts)


def _independent(z: Array, where: np.ndarray, channels: int) -> bool:
    """Whether neighbouring samples differ as if drawn anew, as a delay that varies from sample to sample makes them."""
    z, where = z.reshape(-1, channels), where.reshape(-1, channels)
    pairs = where[1:] & where[:-1]
    products, squares = float(np.sum((z[1:] * z[:-1])[pairs])), float(np.sum((z[1:] ** 2)[pairs]))
    return squares > 0 and abs(products) < SAME_AGAIN * squares


def _centred(z: Array, worth: Array, where: np.ndarray) -> bool:
    """Whether the delay varies about the one believed: what is late throughout goes along with the rate of the reading, `worth`."""
    z, worth = z[where], worth[where]
    return abs(float(np.sum(z * worth))) < SAME_AGAIN * math.sqrt(square(z) * square(worth))


__all__ = ["again", "inflation", "jitter_beside"]
