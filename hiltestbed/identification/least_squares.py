"""Recursive least squares of stiffness and damping, with the pose at the time the force acted.

On each axis ``F = k x + c v + b``: the intercept b absorbs the position of the touch; without it an
error dx of the touch point causes ``dk/k ~ -(4/pi) dx/x_max``. The samples are those of
:mod:`hiltestbed.identification.samples`: pose and force of the same instant.

The recursion is in information form (L. Ljung, System Identification, 2nd ed. 1999, eq. 11.12): the
sums of products are updated, and the estimate is solved from them. It is the usual recursion in the
limit P0 to infinity, so that no P0 biases the estimate.

A latch that alone carries an axis is a spring and damper there; if a joint away from its reference
point couples two axes, the partner axis enters as additional regressors
(:mod:`hiltestbed.identification.coupled`). Where joints, stops or surfaces with friction share the
load, the residual of k and c exceeds the sensor's noise, and no estimate is given. Nor is one given
where a latched axis hardly moves.

The methods for comparison use other samples: the raw force with the pose of the same tick, or the
force after the phase lead (the usual method in the literature), for which a delay acts as a damping
``-k tau`` that biases c.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hiltestbed.compensation.force_methods.phase_lead import PhaseLeadBlock
from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array
from hiltestbed.identification.coupled import (
    PAIRS,
    PARTNERS,
    PRODUCTS,
    about_means,
    accumulate_pairs,
    take_in_partner,
)
from hiltestbed.identification.samples import NORMAL, ContactSamples

MINIMUM_SAMPLES = 8
# fraction of the force's variance that k x + c v may leave, beyond noise, on an axis of a latch: 3
# % of the force
HELD_REST = 1e-3
MINIMUM_TRAVEL = 1e-6  # [m, rad] standard deviation of x below which an axis is not excited
# fraction of the force's variance that k x + c v must explain; below it no estimate is given
EXPLAINED = 0.9
SUMS = 10  # n, x, v, y, xx, xv, vv, xy, vy, yy


class _Sums(NamedTuple):
    """The state of the recursion."""

    seen: NDArray[np.int64]  # (n,) changes of the mechanism so far
    sums: Array  # (n, 7, SUMS)
    products: Array  # (n, PAIRS, PRODUCTS)
    found: Array  # (4, n, 7) k, c and their standard deviations
    used: Array  # (n, 7) samples


class RecursiveLeastSquares:
    """Estimates of stiffness and damping on six axes for ``n`` runs.

    Axes are the components of the relative pose (position of A, rotation vector, both in P) against
    those of the wrench.

    Attributes:
        stiffness, damping: ``(n, 6)`` [N/m, N m/rad; N s/m, N m s/rad], NaN before the first
            estimate.
        stiffness_sd, damping_sd: ``(n, 6)`` their standard deviations, from the residual's
            variance.
        samples: ``(n, 6)`` contact samples used.
        along_normal: ``(n, 5)`` the same five quantities along the contact normal, before capture.
    """

    def __init__(
        self,
        source: ContactSamples,
        forgetting: Sequence[float],
        lead: PhaseLeadBlock | None = None,
    ) -> None:
        """``forgetting``: factor of each run per tick; ``lead``: that the force passes first."""
        n = len(forgetting)
        self.source = source
        self._lead = lead
        self.forgetting = np.array(forgetting)
        self._sums = np.zeros((n, 7, SUMS))
        self._products = np.zeros((n, PAIRS, PRODUCTS))
        self._found = np.full((4, n, 7), np.nan)
        self._used = np.zeros((n, 7))
        self.stiffness, self.damping, self.stiffness_sd, self.damping_sd = self._found[
            :, :, :NORMAL
        ]
        self.samples = self._used[:, :NORMAL]
        self._changes = np.zeros(n, dtype=np.int64)
        self._noise = source.noise**2
        sums = _Sums(self._changes, self._sums, self._products, self._found, self._used)
        given = (source.held.changes, source.found, self.forgetting, self._noise, sums)
        self._estimated = Call(_estimate, GIVEN, *given)

    @property
    def along_normal(self) -> Array:
        """``(n, 5)`` stiffness, damping, their sd, and samples, along the contact normal."""
        return np.column_stack([*self._found[:, :, NORMAL], self._used[:, NORMAL]])

    def update(self, wrench: Array, pose: Array, twist: Array) -> None:
        """Process the measurements at t_k: wrench ``(n, 6)``, pose ``(n, 7)``, twist ``(n, 6)``."""
        source = self.source
        source.take(wrench, pose, twist, self._lead.lead_wrench(wrench) if self._lead else None)
        self._estimated.on(source.captured)()


@njit(cache=True)
def _estimate(captured, changes, samples, forgetting, noise, s):
    _begin_anew(changes, s)
    _accumulate(samples, forgetting, captured, s)
    _solve(samples, captured, noise, s)


@njit(cache=True)
def _begin_anew(changes, s):
    """Reset the six axes where the mechanism has changed: a latch, a phase of capture."""
    seen, sums, products, found, used = s
    for i in range(changes.shape[0]):
        if changes[i] == seen[i]:
            continue
        seen[i] = changes[i]
        for j in range(NORMAL):
            used[i, j] = 0.0
            for c in range(sums.shape[2]):
                sums[i, j, c] = 0.0
            for c in range(found.shape[0]):
                found[c, i, j] = np.nan
        for j in range(products.shape[1]):
            for c in range(products.shape[2]):
                products[i, j, c] = 0.0


@njit(cache=True)
def _accumulate(samples, forgetting, captured, s):
    ready, ready_normal, sample = samples.ready, samples.ready_normal, samples.whole
    sums, products, used = s.sums, s.products, s.used
    for i in range(sample.shape[0]):
        for j in range(7):
            if not (ready[i] if j < NORMAL else ready_normal[i]):
                continue
            accumulate(sums[i, j], sample[i, j], forgetting[i])
            used[i, j] += 1.0
        if ready[i] and captured[i]:
            accumulate_pairs(sample[i], forgetting[i], products[i])


@njit(cache=True)
def accumulate(s, sample, forgetting):
    """Add a ``sample`` (4,) of x, v, 1 and y to its sums ``s`` (SUMS,)."""
    x, v, one, y = sample
    for c in range(SUMS):
        s[c] *= forgetting
    s[0] += one * one
    s[1] += one * x
    s[2] += one * v
    s[3] += one * y
    s[4] += x * x
    s[5] += x * v
    s[6] += v * v
    s[7] += x * y
    s[8] += v * y
    s[9] += y * y


@njit(cache=True)
def _variance(j, place, noise):
    """Variance of the sensor noise on an axis, with torques about ``place`` (3,) in P; ``noise``
    (2,): variances of force and torque.
    """
    if j < 3:
        return noise[0]
    return noise[1] + noise[0] * (place[0] ** 2 + place[1] ** 2 + place[2] ** 2 - place[j - 3] ** 2)


@njit(cache=True)
def _fit(sums, out):
    """Write k, c and their standard deviations to ``out`` (4,), which is unchanged if the axis has
    not moved.

    Returns the sums of squares of the force about its mean, and of the residual of the fit.
    """
    if sums[0] < MINIMUM_SAMPLES:
        return 0.0, 0.0
    n, xx, xv, vv, xy, vy, total = about_means(sums)
    det = xx * vv - xv * xv
    if xx < n * MINIMUM_TRAVEL**2 or det <= 1e-10 * xx * vv:
        return 0.0, 0.0
    k = (vv * xy - xv * vy) / det
    c = (xx * vy - xv * xy) / det
    rest = total - k * xy - c * vy
    variance = max(0.0, rest) / max(1.0, n - 3.0)
    out[0], out[1] = k, c
    out[2], out[3] = math.sqrt(variance * vv / det), math.sqrt(variance * xx / det)
    return total, rest


@njit(cache=True)
def _solve(samples, captured, noise, s):
    ready, ready_normal, place = samples.ready, samples.ready_normal, samples.place
    sums, products, found = s.sums, s.products, s.found
    out = np.empty(4)
    for i in range(sums.shape[0]):
        for j in range(7):
            if not (ready[i] if j < NORMAL else ready_normal[i]):
                continue
            total, rest = _fit(sums[i, j], out)
            held = captured[i] and j < NORMAL
            if total <= 0.0 and not held:
                continue
            variance = _variance(j, place[i], noise[i]) if held else 0.0
            if held and total > 0.0 and PARTNERS[j] >= 0:
                _, rest = take_in_partner(
                    j, products[i], sums[i, j], sums[i, PARTNERS[j]], variance, rest, out
                )
            accepted = total > 0.0 and total - rest >= EXPLAINED * total
            if held:
                accepted &= rest - sums[i, j, 0] * variance <= HELD_REST * (total - rest)
            for q in range(4):
                found[q, i, j] = out[q] if accepted else np.nan
