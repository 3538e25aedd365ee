"""Batch least squares with instrumental variables: the reference method for a noisy pose.

Noise in the regressors x and v biases k and c towards zero. Instruments z that are correlated with
x and v but not with their noise remove
the bias: ``theta = (Z^T Phi)^-1 Z^T y`` (L. Ljung, System Identification, 2nd ed. 1999, section
7.6). Here z is the regressor of some ticks earlier. Without pose noise this is least squares with
slightly more scatter.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field

from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array
from hiltestbed.identification.least_squares import MINIMUM_TRAVEL
from hiltestbed.identification.samples import ContactSamples
from hiltestbed.identification.settings import Identifier, identifier_of
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario

MINIMUM_SAMPLES = 12
LONGEST = 10_000  # ticks: seconds at any rate of a loop


@register
class Instrumental(Identifier):
    """Batch least squares with instrumental variables: the reference method for a noisy pose."""

    kind: Literal["instrumental"] = "instrumental"
    lag: Annotated[int, Field(ge=1, le=LONGEST)] = Field(
        default=2, description="Ticks by which the instruments are older than the samples"
    )

    @classmethod
    def start(cls, scenarios: Sequence[Scenario]) -> InstrumentVariables:
        return InstrumentVariables(scenarios)


class InstrumentVariables:
    """Estimates on six axes for ``n`` runs; attributes as in :class:`RecursiveLeastSquares`."""

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        n = len(scenarios)
        self.source = ContactSamples(scenarios)
        self._lags = np.array([o.lag for o in identifier_of(scenarios, Instrumental)])
        self._past = np.zeros((n, int(self._lags.max()) + 1, 6, 3))
        self._length = np.zeros(n, dtype=np.int64)  # samples of this contact
        self._sums = np.zeros((n, 6, 3, 4))  # Z^T Phi, Z^T y
        self.stiffness, self.damping = np.full((n, 6), np.nan), np.full((n, 6), np.nan)
        self.samples = np.zeros((n, 6))

    def update(self, wrench: Array, pose: Array, twist: Array) -> None:
        """Process the measurements at t_k: wrench ``(n, 6)``, pose ``(n, 7)``, twist ``(n, 6)``."""
        self.source.take(wrench, pose, twist)
        _accumulate(
            self.source.ready, self.source.sample, self._lags, self._past, self._length, self._sums,
            self.samples, self.stiffness, self.damping,
        )  # fmt: skip


@njit(cache=True)
def _accumulate(ready, sample, lags, past, length, sums, samples, stiffness, damping):
    for i in range(sample.shape[0]):
        if not ready[i]:
            length[i] = 0
            continue
        slots = past.shape[1]
        now, then = length[i] % slots, (length[i] - lags[i]) % slots
        for j in range(6):
            for a in range(3):
                past[i, now, j, a] = sample[i, j, a]
            if length[i] < lags[i]:
                continue
            for a in range(3):
                z = past[i, then, j, a]
                for b in range(4):
                    sums[i, j, a, b] += z * sample[i, j, b]
            samples[i, j] += 1.0
            if samples[i, j] >= MINIMUM_SAMPLES:
                _solve(sums[i, j], samples[i, j], stiffness[i], damping[i], j)
        length[i] += 1


@njit(cache=True)
def _solve(s, n, stiffness, damping, j):
    """Eliminate the intercept, then solve two equations for k and c."""
    one = s[2, 2]
    xx = s[0, 0] - s[0, 2] * s[2, 0] / one
    xv = s[0, 1] - s[0, 2] * s[2, 1] / one
    xy = s[0, 3] - s[0, 2] * s[2, 3] / one
    vx = s[1, 0] - s[1, 2] * s[2, 0] / one
    vv = s[1, 1] - s[1, 2] * s[2, 1] / one
    vy = s[1, 3] - s[1, 2] * s[2, 3] / one
    det = xx * vv - xv * vx
    if xx < n * MINIMUM_TRAVEL**2 or abs(det) <= 1e-10 * abs(xx * vv):
        return
    stiffness[j] = (vv * xy - xv * vy) / det
    damping[j] = (xx * vy - vx * xy) / det
