"""The contact model of the resynchronised prediction: one line of action, with one spring and
damper along it.

At A's origin, in P: the wrench acts along the direction ``D`` (6,); its magnitude follows from the
relative pose ``x`` (6,) (position, rotation vector) and twist ``v`` (6,) of A along the gradient
``G`` (6,)::

    wrench = D F,   F = k (G.x - x0) + c G.v   while G.x > x0, never negative

For a flat passive surface G is known: it is the surface normal, z of P. D comes from the measured
wrench, so that it includes the lever arm of an off-axis contact. For other surfaces G is taken as
D: on a frictionless surface the force is along the normal.

A flat surface may have friction: once sliding has been observed, the tangential force is ``mu F``
along the slip of the contact point, and viscous at lower slip speeds. mu is the regression of the
tangential force along the slip on the normal force.

k, c and x0 are the Bayesian least-squares estimate of the measured F on G.x and G.v *at the time
the force acted*, with an intercept. Prior knowledge enters as a prior: an earlier contact's k, c
and touch point or, without an earlier contact, that the touch point lies within the tick before the
first force. One contact is enough: the estimate is available about four samples after the touch.
"""

from __future__ import annotations

import math

import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.identification.samples import GATE_SIGMA

# Columns of a run's row in ``law``.
# DEEPENING [N s/m2] grows with the depth, STOP [N/m] acts beyond the depth KNOT [m]; FITTED says
# that they hold: then samples are not taken for those of k x + c v.
(
    STIFFNESS,
    DAMPING,
    TOUCH,
    KNOWN,
    ARMED,
    STIFFNESS_SD,
    DAMPING_SD,
    FRICTION,
    DEEPENING,
    STOP,
    KNOT,
    FITTED,
    LAW,
) = range(13)
# Columns of ``fit``: sums over the contact of products of x, v, 1 (all passed through the model of
# the sensor's filters) and y.
(
    XX,
    XV,
    XO,
    VV,
    VO,
    OO,
    XY,
    VY,
    OY,
    REFERENCE,
    PRIOR_K,
    PRIOR_C,
    SD_K,
    SD_C,
    SD_X,
    TRAVEL,
    PEAK,
    SLIDING,
    PRESSED,
    FIT,
) = range(20)
# Columns of ``count``.
ABOVE, SAMPLES, CONTACTS, COUNT = range(4)

# as GATE_PEAK with a low-pass, whose memory of the clipped force at separation would bias c
GATE_PEAK_FILTERED = 0.3
MINIMUM_SAMPLES = 4
ACCEPTED = 0.25  # relative standard deviation of k below which the law is used
MODEL_ERROR = 3e-4  # of the peak force: least departure of a real contact from k x + c v
# least relative uncertainty of an estimate in the prior of the next contact, elsewhere on the
# surface
LEARNT_K, LEARNT_C = 0.02, 0.10
SLIDES = 1e-3  # [m/s] slip speed above which the surface slides instead of creeping
CREEP = 2e5  # [N s/m] viscous friction at low slip, unless CREEP_LIMIT is lower
CREEP_LIMIT = 0.5  # times the damping that would stop the slip within one tick
DIRECTION_MEMORY = 0.02  # [s] over which the direction of the force is averaged


@njit(cache=True, inline="always")
def size(law, s, rate):
    """Magnitude of the force [N] at position ``s`` [m] and ``rate`` [m/s] along the gradient."""
    x = s - law[TOUCH]
    if law[ARMED] == 0.0 or x <= 0.0:
        return 0.0
    force = law[STIFFNESS] * x + law[DAMPING] * rate
    if law[FITTED] == 1.0:
        force += law[DEEPENING] * x * rate + law[STOP] * max(x - law[KNOT], 0.0)
    return max(0.0, force)


@njit(cache=True)
def touch(fit, law, count, x, v, h):
    """Start a contact: reference point of the fit and, after an earlier one, its k and c."""
    count[CONTACTS] += 1
    if law[ARMED] == 1.0:
        return
    restart(fit, count, x - 0.5 * h * v)  # on average the force began half a tick ago
    fit[TRAVEL] = abs(v) * h
    fit[SD_X] = 0.0
    if law[KNOWN] == 1.0:
        fit[PRIOR_K], fit[PRIOR_C] = law[STIFFNESS], law[DAMPING]
        fit[SD_K] = max(law[STIFFNESS_SD], LEARNT_K * law[STIFFNESS])
        fit[SD_C] = max(law[DAMPING_SD], LEARNT_C * abs(law[DAMPING]))
        law[TOUCH], law[ARMED] = fit[REFERENCE], 1.0


@njit(cache=True, inline="always")
def restart(fit, count, reference):
    """Forget the samples; reference: [m] the touch point that is believed."""
    fit[:REFERENCE] = 0.0
    fit[REFERENCE] = reference
    count[SAMPLES] = 0


@njit(cache=True)
def learn(fit, law, count, sample, sigma):
    """Add one contact sample (x, v, 1 when the force acted, and y) and solve for the law."""
    x, v, o, y = sample[0] - sample[2] * fit[REFERENCE], sample[1], sample[2], sample[3]
    fit[XX] += x * x
    fit[XV] += x * v
    fit[XO] += x * o
    fit[VV] += v * v
    fit[VO] += v * o
    fit[OO] += o * o
    fit[XY] += x * y
    fit[VY] += v * y
    fit[OY] += o * y
    count[SAMPLES] += 1
    if count[SAMPLES] < MINIMUM_SAMPLES and law[KNOWN] == 0.0:
        return
    if law[FITTED] == 1.0:
        return
    variance = sigma * sigma + (MODEL_ERROR * fit[PEAK]) ** 2
    k = law[STIFFNESS]
    if law[KNOWN] == 0.0:  # that of y = k x + c v without an intercept, to weight the touch point
        det, whole = fit[XX] * fit[VV] - fit[XV] * fit[XV], fit[XX] * fit[VV]
        k = (fit[VV] * fit[XY] - fit[XV] * fit[VY]) / det if det > 1e-12 * whole else 0.0
    if k <= 0.0:
        return
    # the posterior of (k, c, b) by Cramer's rule, with scaled columns
    variance = max(variance, 1e-30)
    weight_k = variance / fit[SD_K] ** 2 if fit[SD_K] > 0.0 else 0.0
    weight_c = variance / fit[SD_C] ** 2 if fit[SD_C] > 0.0 else 0.0
    sd_x = (
        fit[SD_X]
        if fit[SD_X] > 0.0
        else math.sqrt(fit[TRAVEL] ** 2 / 12.0 + GATE_SIGMA**2 * variance / (k * k))
    )
    weight_b = variance / (k * sd_x) ** 2
    a11, a12, a13 = fit[XX] + weight_k, fit[XV], fit[XO]
    a22, a23, a33 = fit[VV] + weight_c, fit[VO], fit[OO] + weight_b
    y1, y2, y3 = fit[XY] + weight_k * fit[PRIOR_K], fit[VY] + weight_c * fit[PRIOR_C], fit[OY]
    if a11 <= 0.0 or a22 <= 0.0 or a33 <= 0.0:
        return
    d1, d2, d3 = 1.0 / math.sqrt(a11), 1.0 / math.sqrt(a22), 1.0 / math.sqrt(a33)
    r12, r13, r23 = a12 * d1 * d2, a13 * d1 * d3, a23 * d2 * d3
    z1, z2, z3 = y1 * d1, y2 * d2, y3 * d3
    c11, c12, c13 = 1.0 - r23 * r23, r13 * r23 - r12, r12 * r23 - r13
    c22, c23, c33 = 1.0 - r13 * r13, r12 * r13 - r23, 1.0 - r12 * r12
    det = c11 + r12 * c12 + r13 * c13
    if det <= 1e-13:
        return
    stiffness = (c11 * z1 + c12 * z2 + c13 * z3) / det * d1
    damping = (c12 * z1 + c22 * z2 + c23 * z3) / det * d2
    intercept = (c13 * z1 + c23 * z2 + c33 * z3) / det * d3
    sd_k = math.sqrt(max(0.0, variance * c11 / det)) * d1
    if stiffness <= 0.0 or (law[KNOWN] == 0.0 and sd_k > ACCEPTED * stiffness):
        return
    law[STIFFNESS], law[DAMPING] = stiffness, damping
    law[TOUCH] = fit[REFERENCE] - intercept / stiffness
    law[STIFFNESS_SD], law[DAMPING_SD] = sd_k, math.sqrt(max(0.0, variance * c22 / det)) * d2
    law[KNOWN], law[ARMED] = 1.0, 1.0


@njit(cache=True)
def direct(line, wrench, y, fixed, fade, noise):
    """Average the direction of the wrench (6,) at A's origin; ``line`` (3, 6): D, sum of wrench y,
    (sum of y y).

    ``noise`` (2,): variances of force and torque; they weight a prior direction along z, which
    dominates while the wrench is in the noise.
    """
    line[2, 0] = fade * line[2, 0] + y * y
    for j in range(6):
        line[1, j] = fade * line[1, j] + wrench[j] * y
        rest = 25.0 * noise[j // 3]
        known = 1.0 if j == 2 else 0.0
        total = line[2, 0] + rest
        line[0, j] = (line[1, j] + rest * known) / total if total > 0.0 else known
    if not fixed:
        force = math.sqrt(line[0, 0] ** 2 + line[0, 1] ** 2 + line[0, 2] ** 2)
        for j in range(6):
            line[0, j] /= force


@njit(cache=True)
def rub(fit, law, line, wrench, rate, y, sigma):
    """Estimate the friction of a flat surface from a wrench (6,) at A and its twist (6,)."""
    sx, sy = slip(line, rate)
    speed = math.sqrt(sx * sx + sy * sy)
    if speed > SLIDES:
        fit[SLIDING] += y * (wrench[0] * sx + wrench[1] * sy) / speed
        fit[PRESSED] += y * y
        mu = fit[SLIDING] / fit[PRESSED]
        law[FRICTION] = mu if mu * math.sqrt(fit[PRESSED]) > GATE_SIGMA * sigma else 0.0


@njit(cache=True, inline="always")
def slip(line, rate):
    """Tangential velocity (x, y) [m/s] of the contact point r = (-D4, D3, 0)."""
    return rate[0] - rate[5] * line[0, 3], rate[1] - rate[5] * line[0, 4]


@njit(cache=True, inline="always")
def friction(law, normal, sx, sy, creep):
    """Tangential force (x, y) [N] for the normal force and the slip: viscous, limited to mu F."""
    speed = math.sqrt(sx * sx + sy * sy)
    limit = law[FRICTION] * normal
    size = creep if creep * speed <= limit else limit / speed
    return size * sx, size * sy


def prior(stiffness: float, damping: float, touch_point: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows of ``fit`` and ``law`` for a contact identified beforehand.

    Standard deviations: k 0.5 %, c 2 % plus k times 50 us, touch point 50 um.
    """
    fit, law = unknown()
    fit[REFERENCE], fit[PRIOR_K], fit[PRIOR_C] = touch_point, stiffness, damping
    fit[SD_K], fit[SD_C], fit[SD_X] = 0.005 * stiffness, 0.02 * damping + 5e-5 * stiffness, 5e-5
    law[STIFFNESS] = stiffness
    law[DAMPING] = damping
    law[TOUCH] = touch_point
    law[KNOWN] = 1.0
    law[ARMED] = 1.0
    law[STIFFNESS_SD], law[DAMPING_SD] = fit[SD_K], fit[SD_C]
    return fit, law


def unknown() -> tuple[np.ndarray, np.ndarray]:
    """Rows of ``fit`` and ``law`` for a contact without prior knowledge."""
    return np.zeros(FIT), np.zeros(LAW)
