"""Recursive least squares of stiffness and damping, with the pose at the time the force acted.

On each axis ``F = k x + c v + b``: the intercept b absorbs the position of the touch; without it an
error dx of the touch point causes ``dk/k ~ -(4/pi) dx/x_max``. The samples are those of
:mod:`hiltestbed.identification.samples`: pose and force of the same instant.

The recursion is in information form (L. Ljung, System Identification, 2nd ed. 1999, eq. 11.12): the
sums of products are updated, and the estimate is solved from them.

A latch that alone carries an axis is a spring and damper there; if a joint away from its reference
point couples two axes, the partner axis enters as additional regressors, as derived below. Where
joints, stops or surfaces with friction share the load, the residual of k and c exceeds the sensor's
noise, and no estimate is given. Nor is one given where a latched axis hardly moves.

**Coupled axes** of a captured pair. A ball joint of stiffness K at a distance L along the axis from
the reference point resists translation there, and so couples translation along x with rotation
about y by K L, and y with rx by -K L. The regression of such an axis then includes the partner
axis's displacement x' and rate v', ``F = k x + c v + k' x' + c' v' + b``.

With A, B, D the sums of products about the means of (x, v) with themselves, with (x', v'), and of
(x', v') with themselves, and a, d those of the force with either, the two own regressors give t =
A^-1 a. The contribution of the partner's two follows by block elimination,

    S = D - B^T A^-1 B,   g = S^-1 (d - B^T t),   (k, c) = t - A^-1 B g,   drop = (d - B^T t) . g

with S the sums of products of the part of their motion that is not correlated with the axis's own,
g their coefficients, and drop the reduction of the residual sum of squares; cov(k, c) = s^2 (A^-1 +
A^-1 B S^-1 B^T A^-1) (G. A. F. Seber, A. J. Lee, Linear Regression Analysis, 2nd ed. 2003, sections
3.7 and 3.11).

**When they are included.** Three tests against the sensor noise, of variance s^2:

- Do they explain anything? Without coupling drop/s^2 is chi-square with 2 degrees of freedom,
  P(drop > D) = exp(-D/(2 s^2)). The test is repeated with every sample: at drop > 4 s^2 ln n the
  false-positive rate is 1/n^2, which sums to 0.13 from the eighth sample on, however long the
  record.
- Do they explain everything? If only springs and dampers act, the residual sum of squares over s^2
  is chi-square with m = n - 5 degrees of freedom, which exceeds m + 2 sqrt(m ln n) + 2 ln n with
  probability below 1/n (B. Laurent, P. Massart, Annals of Statistics 28, 2000, lemma 1). Above
  that, friction or stops act, which four regressors would fit no more truly than two: the partner
  is not included.
- What may the noise hide? With the same probability chi-square lies below m - 2 sqrt(m ln n), so 2
  s^2 sqrt(m ln n) is added to the residual sum of squares when the estimate is judged: few samples
  cannot prove the absence of friction.

So the partner is never included where the noise of the force is unknown or zero. The standard
deviations cover the noise, not what may be hidden in it.
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
from hiltestbed.identification.samples import NORMAL, ContactSamples

MINIMUM_SAMPLES = 8
# fraction of the force's variance that k x + c v may leave, beyond noise, on an axis of a latch: 3
# % of the force
HELD_REST = 1e-3
MINIMUM_TRAVEL = 1e-6  # [m, rad] standard deviation of x below which an axis is not excited
# fraction of the force's variance that k x + c v must explain; below it no estimate is given
EXPLAINED = 0.9
SUMS = 10  # n, x, v, y, xx, xv, vv, xy, vy, yy
PAIRS = 2  # x with ry, y with rx
# of each axis; none of z and rz, which lie along the axis of a mechanism
PARTNERS = np.array([4, 3, -1, 1, 0, -1])
PRODUCTS = 8  # of each pair, a before b: xa xb, xa vb, va xb, va vb, xb ya, vb ya, xa yb, va yb
# fraction of a regressor's sum of squares left by the other regressors, below which it is linearly
# dependent on them
ROUNDING = 1e-10


class _Sums(NamedTuple):
    """The state of the recursion."""

    seen: NDArray[np.int64]  # (n,) changes of the mechanism so far
    sums: Array  # (n, 7, SUMS)
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
        products = np.zeros((n, PAIRS, PRODUCTS)) if source.captures else None
        self._found = np.full((4, n, 7), np.nan)
        self._used = np.zeros((n, 7))
        self.stiffness, self.damping, self.stiffness_sd, self.damping_sd = self._found[
            :, :, :NORMAL
        ]
        self.samples = self._used[:, :NORMAL]
        self._changes = np.zeros(n, dtype=np.int64)
        self._noise = source.noise**2
        sums = _Sums(self._changes, self._sums, self._found, self._used)
        given = (source.held.changes, source.found, self.forgetting, self._noise, products, sums)
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
def _estimate(captured, changes, samples, forgetting, noise, products, s):
    """``products`` (n, PAIRS, PRODUCTS): of coupled axes; None for a mechanism without latches."""
    ready, ready_normal, place, whole = samples
    seen, sums, found, used = s
    out = np.empty(4)
    for i in range(sums.shape[0]):
        # the six axes begin anew where the mechanism has changed: a latch, a phase of capture
        anew = products is not None and changes[i] != seen[i]
        for j in range(NORMAL if anew else 0):
            used[i, j] = 0.0
            for c in range(SUMS):
                sums[i, j, c] = 0.0
            for c in range(4):
                found[c, i, j] = np.nan
        if products is not None:
            seen[i] = changes[i]
            for j in range(PAIRS):
                a, b, pair = whole[i, j], whole[i, PARTNERS[j]], products[i, j]
                for c in range(PRODUCTS if anew else 0):
                    pair[c] = 0.0
                if ready[i] and captured[i]:
                    for c in range(PRODUCTS):
                        pair[c] *= forgetting[i]
                    pair[0] += a[0] * b[0]
                    pair[1] += a[0] * b[1]
                    pair[2] += a[1] * b[0]
                    pair[3] += a[1] * b[1]
                    pair[4] += b[0] * a[3]
                    pair[5] += b[1] * a[3]
                    pair[6] += a[0] * b[3]
                    pair[7] += a[1] * b[3]
        for j in range(7):
            if ready[i] if j < NORMAL else ready_normal[i]:
                accumulate(sums[i, j], whole[i, j], forgetting[i])
                used[i, j] += 1.0
        for j in range(7):
            if not (ready[i] if j < NORMAL else ready_normal[i]):
                continue
            total, rest = _fit(sums[i, j], out)
            held = captured[i] and j < NORMAL
            if total <= 0.0 and not held:
                continue
            variance = 0.0  # of the sensor noise, with torques about the place of the latch
            if products is not None:
                if held:
                    x, y, z = place[i]
                    arm2 = x**2 + y**2 + z**2 - place[i, j - 3] ** 2 if j >= 3 else 0.0
                    variance = noise[i, j // 3] + noise[i, 0] * arm2
                if held and total > 0.0 and PARTNERS[j] >= 0:
                    _, rest = take_in_partner(
                        j, products[i], sums[i, j], sums[i, PARTNERS[j]], variance, rest, out
                    )
            accepted = total > 0.0 and total - rest >= EXPLAINED * total
            if held:
                accepted &= rest - sums[i, j, 0] * variance <= HELD_REST * (total - rest)
            for q in range(4):
                found[q, i, j] = out[q] if accepted else np.nan


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
def _fit(sums, out):
    """k, c and sd to ``out`` (4,) if the axis moved; sums of squares of force and residual."""
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
def about_means(sums):
    """Number of samples, and sums of x x, x v, v v, x y, v y, y y about the means."""
    n, x, v, y, xx, xv, vv, xy, vy, yy = sums
    return (
        n,
        xx - x * x / n,
        xv - x * v / n,
        vv - v * v / n,
        xy - x * y / n,
        vy - v * y / n,
        yy - y * y / n,
    )


@njit(cache=True)
def take_in_partner(j, products, own, other, variance, rest, out):
    """Write to ``out`` (4,) k, c and their standard deviations from the fit with the partner of
    axis ``j``, if it is to be included.

    Args:
        products: (PAIRS, PRODUCTS) of the pairs. own, other: sums of the axis and of its partner,
            as for the two regressors.
        variance: of the sensor noise. rest: residual sum of squares of k and c in ``out``.

    Returns:
        Whether the partner is included; an upper bound of the residual sum of squares then.
    """
    n, a11, a12, a22, _, _, _ = about_means(own)
    m = n - 5.0
    if m < 1.0:
        return False, rest
    _, d11, d12, d22, _, _, _ = about_means(other)
    s = products[j if j < PAIRS else PARTNERS[j]]
    xv, vx, xy, vy = (s[1], s[2], s[4], s[5]) if j < PAIRS else (s[2], s[1], s[6], s[7])
    x, v, y, p, q = own[1], own[2], own[3], other[1], other[2]
    # sums of products about the means, with the partner's motion and with the force
    b11, b12, b21, b22 = s[0] - x * p / n, xv - x * q / n, vx - v * p / n, s[3] - v * q / n
    e1, e2 = xy - p * y / n, vy - q * y / n
    det = a11 * a22 - a12 * a12
    w11, w12 = (a22 * b11 - a12 * b21) / det, (a22 * b12 - a12 * b22) / det  # W = A^-1 B
    w21, w22 = (a11 * b21 - a12 * b11) / det, (a11 * b22 - a12 * b12) / det
    s11, s22 = d11 - b11 * w11 - b21 * w21, d22 - b12 * w12 - b22 * w22
    s12 = d12 - b11 * w12 - b21 * w22
    own_det = s11 * s22 - s12 * s12
    if s11 <= ROUNDING * d11 or s22 <= ROUNDING * d22 or own_det <= ROUNDING * s11 * s22:
        return False, rest
    k, c = out[0], out[1]
    e1, e2 = e1 - b11 * k - b21 * c, e2 - b12 * k - b22 * c
    g1, g2 = (s22 * e1 - s12 * e2) / own_det, (s11 * e2 - s12 * e1) / own_det
    drop = e1 * g1 + e2 * g2
    surely = math.log(n)
    if drop <= 4.0 * variance * surely or rest - drop > variance * (
        m + 2.0 * math.sqrt(m * surely) + 2.0 * surely
    ):
        return False, rest
    left = max(0.0, rest - drop) / m
    out[0], out[1] = k - w11 * g1 - w12 * g2, c - w21 * g1 - w22 * g2
    out[2] = math.sqrt(
        left * (a22 / det + (w11 * w11 * s22 - 2.0 * w11 * w12 * s12 + w12 * w12 * s11) / own_det)
    )
    out[3] = math.sqrt(
        left * (a11 / det + (w21 * w21 * s22 - 2.0 * w21 * w22 * s12 + w22 * w22 * s11) / own_det)
    )
    return True, rest - drop + 2.0 * variance * math.sqrt(m * surely)
