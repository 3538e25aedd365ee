"""Recursive least squares of stiffness and damping, with the pose taken at the time the force was felt.

On each axis ``F = k x + c v + b``: the intercept b takes up where the touch is, since an error dx of the touch point costs
``dk/k ~ -(4/pi) dx/x_max`` without it. The samples are those of :mod:`hiltestbed.identification.samples`: pose and force of one instant.

The recursion is kept in its information form (L. Ljung, System Identification, 2nd ed. 1999, eq. 11.12): the sums of products are
updated, and the estimate solved from them. It is the usual recursion with P0 to infinity, so no P0 biases the estimate.

The methods that it is compared with take other samples: the raw force beside the pose of the same tick, or the force after the phase
lead (the field's usual way), for which a delay is a damping ``-k tau`` that goes into c.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit

from hiltestbed.compensation.force_methods.phase_lead import PhaseLeadBlock
from hiltestbed.frames import Array
from hiltestbed.identification.samples import NORMAL, ContactSamples

MINIMUM_SAMPLES = 8
MINIMUM_TRAVEL = 1e-6  # [m, rad] standard deviation of x below which an axis is not excited
EXPLAINED = 0.9  # part of the force's variance that k x + c v must explain, else the axis carries no spring that could be told
SUMS = 9  # n, x, v, y, xx, xv, vv, xy, vy (yy is kept apart: it only serves the intervals)


class RecursiveLeastSquares:
    """Estimates of stiffness and damping on six axes for ``n`` runs.

    Axes are the components of the relative pose (position of A, rotation vector, both in P) against those of the wrench.

    Attributes:
        stiffness, damping: ``(n, 6)`` [N/m, N m/rad; N s/m, N m s/rad], NaN before the first estimate.
        stiffness_sd, damping_sd: ``(n, 6)`` their standard deviations, from the residual's variance.
        samples: ``(n, 6)`` contact samples used.
        along_normal: ``(n, 5)`` the same five along the contact's normal, before it is latched.
    """

    def __init__(self, source: ContactSamples, forgetting: Sequence[float], lead: PhaseLeadBlock | None = None) -> None:
        """``source`` gives the samples; ``forgetting``: factor of each run a tick; ``lead``: what the force passes first."""
        n = len(forgetting)
        self.source = source
        self._lead = lead
        self.forgetting = np.array(forgetting)
        self._sums = np.zeros((n, 7, SUMS))
        self._yy = np.zeros((n, 7))
        self._found = np.full((4, n, 7), np.nan)
        self._used = np.zeros((n, 7))
        self.stiffness, self.damping, self.stiffness_sd, self.damping_sd = self._found[:, :, :NORMAL]
        self.samples = self._used[:, :NORMAL]
        self._steps = np.zeros(n, dtype=np.int64)

    @property
    def along_normal(self) -> Array:
        """``(n, 5)`` stiffness, damping, their standard deviations, and samples along the contact's normal."""
        return np.column_stack([*self._found[:, :, NORMAL], self._used[:, NORMAL]])

    def update(self, wrench: Array, pose: Array, twist: Array) -> None:
        """Take in what was measured at t_k: wrench ``(n, 6)``, pose ``(n, 7)``, twist ``(n, 6)``."""
        source = self.source
        source.take(wrench, pose, twist, self._lead.lead_wrench(wrench) if self._lead else None)
        _begin_anew(source.steps, self._steps, self._sums, self._yy, self._found, self._used)
        _accumulate(source.ready, source.ready_normal, source.whole, self.forgetting, self._sums, self._yy, self._used)
        _solve(source.ready, source.ready_normal, self._sums, self._yy, *self._found)


@njit(cache=True)
def _begin_anew(steps, before, sums, yy, found, used):
    """Forget the six axes of the runs in which a phase of capture has begun: the mechanism is another one."""
    for i in range(steps.shape[0]):
        if steps[i] == before[i]:
            continue
        before[i] = steps[i]
        sums[i, :NORMAL], yy[i, :NORMAL], used[i, :NORMAL] = 0.0, 0.0, 0.0
        found[:, i, :NORMAL] = np.nan


@njit(cache=True)
def _accumulate(ready, ready_normal, sample, forgetting, sums, yy, samples):
    for i in range(sample.shape[0]):
        for j in range(7):
            if not (ready[i] if j < NORMAL else ready_normal[i]):
                continue
            x, v, one, y = sample[i, j]
            s = sums[i, j]
            for c in range(SUMS):
                s[c] *= forgetting[i]
            s[0] += one * one
            s[1] += one * x
            s[2] += one * v
            s[3] += one * y
            s[4] += x * x
            s[5] += x * v
            s[6] += v * v
            s[7] += x * y
            s[8] += v * y
            yy[i, j] = forgetting[i] * yy[i, j] + y * y
            samples[i, j] += 1.0


@njit(cache=True)
def _solve(ready, ready_normal, sums, yy, stiffness, damping, stiffness_sd, damping_sd):
    for i in range(sums.shape[0]):
        for j in range(7):
            if not (ready[i] if j < NORMAL else ready_normal[i]):
                continue
            n, x, v, y, xx, xv, vv, xy, vy = sums[i, j]
            if n < MINIMUM_SAMPLES:
                continue
            xx -= x * x / n
            xv -= x * v / n
            vv -= v * v / n
            xy -= x * y / n
            vy -= v * y / n
            det = xx * vv - xv * xv
            if xx < n * MINIMUM_TRAVEL**2 or det <= 1e-10 * xx * vv:
                continue
            k = (vv * xy - xv * vy) / det
            c = (xx * vy - xv * xy) / det
            total = yy[i, j] - y * y / n
            if k * xy + c * vy < EXPLAINED * total:
                stiffness[i, j] = damping[i, j] = stiffness_sd[i, j] = damping_sd[i, j] = np.nan
                continue
            variance = max(0.0, total - k * xy - c * vy) / max(1.0, n - 3.0)
            stiffness[i, j] = k
            damping[i, j] = c
            stiffness_sd[i, j] = math.sqrt(variance * vv / det)
            damping_sd[i, j] = math.sqrt(variance * xx / det)
