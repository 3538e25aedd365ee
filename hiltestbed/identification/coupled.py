"""Turn and shift across each other on a latched pair: what a spring or joint that lies off the latched place puts into another axis.

A ball joint of stiffness K at a distance L along the axis from the latched place resists shifts there, and so couples the shift along x
with the turn about y by K L, and y with rx by -K L. Where both move, ``F = k x + c v + b`` has to explain the coupled force by x and v
alone, and since the two motions go together the coupling ends up in k and c. The regression of such an axis then takes in the partner's
shift x' and rate v' as well, ``F = k x + c v + k' x' + c' v' + b``.

With A, B, D the sums of products about the means of (x, v) with themselves, with (x', v'), and of (x', v') with themselves, and a, d
those of the force with either, two regressors give t = A^-1 a. What the other two do beside them follows by blocks, in

    S = D - B^T A^-1 B,   g = S^-1 (d - B^T t),   (k, c) = t - A^-1 B g,   drop = (d - B^T t) . g

with S their motion that does not go with the axis's own, g their coefficients, and drop what they take off the sum of squares that two
regressors leave; cov(k, c) = s^2 (A^-1 + A^-1 B S^-1 B^T A^-1) (G. A. F. Seber, A. J. Lee, Linear Regression Analysis, 2nd ed. 2003,
sections 3.7 and 3.11).

**When they are taken in.** Three questions are put to the sensor's noise, of variance s^2:

- Is there anything for them to explain? Without coupling drop/s^2 is chi-square with 2 degrees of freedom, P(drop > D) = exp(-D/(2 s^2)).
  It is asked again with every sample: at drop > 4 s^2 ln n each answer is wrong with a chance of 1/n^2, and the sum of those from the
  eighth sample on is 0.13, however long the record. What is there is found in the end, since drop grows with n.
- Do they explain all of it? Where springs and dampers are all that acts, what is left over s^2 is chi-square with m = n - 5 degrees of
  freedom, which exceeds m + 2 sqrt(m ln n) + 2 ln n with a chance below 1/n (B. Laurent, P. Massart, Annals of Statistics 28, 2000,
  lemma 1). Where more is left, surfaces rub or stops act, and four regressors would fit them as well as two without being any truer:
  the axis stays as it is.
- What may the noise still hide? With the same chance chi-square lies below m - 2 sqrt(m ln n), so that what is left counts as more by
  2 s^2 sqrt(m ln n) when the estimate is judged: few samples cannot show that nothing rubs.

So nothing is taken in where the noise of the force is not known, or none. Motion that goes with the axis's own has nothing left to explain,
whatever it couples; within rounding (S below 1e-10 of D, as for the two regressors among themselves) it is left out before it is
divided by. The standard deviations count the noise, not what is hidden in it.
"""

from __future__ import annotations

import math

import numpy as np

from hiltestbed.jit import njit

PAIRS = 2  # x with ry, y with rx
PARTNERS = np.array([4, 3, -1, 1, 0, -1])  # of each axis; none of z and rz, which lie along the axis of a mechanism
PRODUCTS = 8  # of each pair, a before b: xa xb, xa vb, va xb, va vb, xb ya, vb ya, xa yb, va yb
ROUNDING = 1e-10  # part of a regressor's sum of squares, beside those before it, below which it is one of them


@njit(cache=True)
def accumulate_pairs(sample, forgetting, products):
    """Take a ``sample`` (7, 4) of a latched pair into its ``products`` (PAIRS, PRODUCTS)."""
    for j in range(PAIRS):
        s, p = products[j], PARTNERS[j]
        xa, va, ya = sample[j, 0], sample[j, 1], sample[j, 3]
        xb, vb, yb = sample[p, 0], sample[p, 1], sample[p, 3]
        for c in range(PRODUCTS):
            s[c] *= forgetting
        s[0] += xa * xb
        s[1] += xa * vb
        s[2] += va * xb
        s[3] += va * vb
        s[4] += xb * ya
        s[5] += vb * ya
        s[6] += xa * yb
        s[7] += va * yb


@njit(cache=True)
def _across(j, products, own, other):
    """About the means, of axis ``j`` with its partner: x x', x v', v x', v v', x' y, v' y; ``own``, ``other``: the sums of both."""
    n = own[0]
    if j < PAIRS:
        xx, xv, vx, vv, xy, vy = products[j, 0], products[j, 1], products[j, 2], products[j, 3], products[j, 4], products[j, 5]
    else:
        s = products[PARTNERS[j]]
        xx, xv, vx, vv, xy, vy = s[0], s[2], s[1], s[3], s[6], s[7]
    x, v, y, p, q = own[1], own[2], own[3], other[1], other[2]
    return xx - x * p / n, xv - x * q / n, vx - v * p / n, vv - v * q / n, xy - p * y / n, vy - q * y / n


@njit(cache=True)
def take_in_partner(j, products, own, other, variance, rest, out):
    """Put k, c and their standard deviations beside the partner of axis ``j`` into ``out`` (4,), where the partner is to be taken in.

    Args:
        products: (PAIRS, PRODUCTS) of the pairs. own, other: sums of the axis and of its partner, as of the two regressors.
        variance: of the sensor's noise. rest: what k and c in ``out`` leave, times the number of samples.

    Returns:
        Whether it is; what is left of the force then, times the number of samples, at most.
    """
    n = own[0]
    m = n - 5.0
    if m < 1.0:
        return False, rest
    a11, a12, a22 = own[4] - own[1] * own[1] / n, own[5] - own[1] * own[2] / n, own[6] - own[2] * own[2] / n
    d11, d12, d22 = other[4] - other[1] * other[1] / n, other[5] - other[1] * other[2] / n, other[6] - other[2] * other[2] / n
    b11, b12, b21, b22, e1, e2 = _across(j, products, own, other)
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
    if drop <= 4.0 * variance * surely or rest - drop > variance * (m + 2.0 * math.sqrt(m * surely) + 2.0 * surely):
        return False, rest
    left = max(0.0, rest - drop) / m
    out[0], out[1] = k - w11 * g1 - w12 * g2, c - w21 * g1 - w22 * g2
    out[2] = math.sqrt(left * (a22 / det + (w11 * w11 * s22 - 2.0 * w11 * w12 * s12 + w12 * w12 * s11) / own_det))
    out[3] = math.sqrt(left * (a11 / det + (w21 * w21 * s22 - 2.0 * w21 * w22 * s12 + w22 * w22 * s11) / own_det))
    return True, rest - drop + 2.0 * variance * math.sqrt(m * surely)
