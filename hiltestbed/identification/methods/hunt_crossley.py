"""Single-stage identification of a Hunt-Crossley contact, ``F = k x^n (1 + alpha v)``.

    ln F = ln k + n ln x + alpha v,   for |alpha v| < 0.1

linear in (ln k, n, alpha) (A. Haddadi, K. Hashtrudi-Zaad, "Real-time identification of
Hunt-Crossley dynamic models of contact environments", IEEE T-RO 28(3), 2012). The logarithm needs
the touch point: x is measured from the nominal one. The reported stiffness and damping are those of
the linear spring and damper with the same force at the largest penetration X and the same energy
loss: k X^(n-1), and ``alpha F(X)`` times ``<x v^2>/(X <v^2>) = 4/(3 pi)`` of a half sine. On a
contact that is a linear spring and damper the force step at
touch, ``c v0``, does not fit the law: the estimate of n is below 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array
from hiltestbed.identification.least_squares import MINIMUM_SAMPLES, SUMS, about_means, accumulate
from hiltestbed.identification.samples import ContactSamples
from hiltestbed.identification.settings import Identifier
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario

# fraction of the deepest x so far; below it samples are skipped, since ln x magnifies any error of
# the touch point
SHALLOW = 0.1
DAMPING_SHARE = 4.0 / (3.0 * math.pi)


@register
class HuntCrossley(Identifier):
    """Single-stage fit of the Hunt-Crossley law F = k x^n (1 + alpha v), with the pose at the time
    the force acted.
    """

    kind: Literal["hunt_crossley"] = "hunt_crossley"

    @classmethod
    def start(cls, scenarios: Sequence[Scenario]) -> HuntCrossleyFit:
        return HuntCrossleyFit(scenarios)


class HuntCrossleyFit:
    """Estimates on six axes for ``n`` runs; attributes as in :class:`RecursiveLeastSquares`, and

    Attributes:
        exponent: ``(n, 6)`` n [-], NaN before the first estimate.
        coefficient: ``(n, 6)`` k [N/m^n].
        alpha: ``(n, 6)`` [s/m].
    """

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        n = len(scenarios)
        self.source = ContactSamples(scenarios)
        self._sums = np.zeros((n, 6, SUMS))
        self._deepest = np.zeros((n, 6))
        self._found = np.full((5, n, 6), np.nan)
        self.exponent, self.coefficient, self.alpha, self.stiffness, self.damping = self._found
        self.samples = np.zeros((n, 6))

    def update(self, wrench: Array, pose: Array, twist: Array) -> None:
        """Process the measurements at t_k: wrench ``(n, 6)``, pose ``(n, 7)``, twist ``(n, 6)``."""
        self.source.take(wrench, pose, twist)
        source = self.source
        _fit(source.ready, source.sample, self._sums, self._deepest, self.samples, self._found)


@njit(cache=True)
def _fit(ready, sample, sums, deepest, samples, found):
    exponent, coefficient, alpha = found[0], found[1], found[2]
    stiffness, damping = found[3], found[4]
    for i in range(sample.shape[0]):
        if not ready[i]:
            continue
        for j in range(6):
            x, v, y = sample[i, j, 0], sample[i, j, 1], sample[i, j, 3]
            deepest[i, j] = max(deepest[i, j], x)
            if x <= 0.0 or y <= 0.0 or x < SHALLOW * deepest[i, j]:
                continue
            s = sums[i, j]
            accumulate(s, (math.log(x), v, 1.0, math.log(y)), 1.0)
            samples[i, j] += 1.0
            if s[0] < MINIMUM_SAMPLES:
                continue
            n, xx, xv, vv, xy, vy, _ = about_means(s)
            det = xx * vv - xv * xv
            if det <= 1e-10 * xx * vv:
                continue
            exponent[i, j] = (vv * xy - xv * vy) / det
            alpha[i, j] = (xx * vy - xv * xy) / det
            level = (s[3] - exponent[i, j] * s[1] - alpha[i, j] * s[2]) / n
            if abs(level) > 100.0:
                continue
            coefficient[i, j] = math.exp(level)
            depth = deepest[i, j]
            stiffness[i, j] = coefficient[i, j] * depth ** (exponent[i, j] - 1.0)
            damping[i, j] = DAMPING_SHARE * alpha[i, j] * stiffness[i, j] * depth
