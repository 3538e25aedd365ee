"""Estimators of stiffness and damping for comparison.

**Instrumental variables**, in a batch: the reference method for a noisy pose. Noise in the
regressors x and v biases k and c towards zero. Instruments z that are correlated with x and v but
not with their noise remove the bias: ``theta = (Z^T Phi)^-1 Z^T y`` (L. Ljung, System
Identification, 2nd ed. 1999, section 7.6). Here z is the regressor of some ticks earlier.

**A Hunt-Crossley contact** in a single stage, ``F = k x^n (1 + alpha v)``.

    ln F = ln k + n ln x + alpha v,   for |alpha v| < 0.1

linear in (ln k, n, alpha) (A. Haddadi, K. Hashtrudi-Zaad, "Real-time identification of
Hunt-Crossley dynamic models of contact environments", IEEE T-RO 28(3), 2012). The logarithm needs
the touch point: x is measured from the nominal one. The reported stiffness and damping are those of
the linear spring and damper with the same force at the largest penetration X and the same energy
loss: k X^(n-1), and ``alpha F(X)`` times ``<x v^2>/(X <v^2>) = 4/(3 pi)`` of a half sine.

**An adaptive Kalman filter**: the state (k, c, b) of each axis follows a random walk; the force is
the observation, ``F = k x + c v + b``. The variance of the force noise is estimated from the
innovations, ``R <- R + (e^2 - phi P phi - R)/N``, and so is the process noise, ``Q = q K e^2 K^T``
(A. P. Sage, G. W. Husa, "Adaptive filtering with unknown prior statistics", 1969; used for k and c
on such a rig by F. He et al., Chin. J. Mech. Eng. 35:149, 2022). With q = 0 it is recursive least
squares. Columns are scaled by the first speed in contact, so that one P0 suits all axes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field

from hiltestbed.compiled.bound import bound
from hiltestbed.compiled.jit import njit
from hiltestbed.config.validation import NotNegative
from hiltestbed.frames import Array
from hiltestbed.identification.least_squares import (
    MINIMUM_SAMPLES,
    MINIMUM_TRAVEL,
    SUMS,
    about_means,
    accumulate,
)
from hiltestbed.identification.samples import ContactSamples, SampleParameters
from hiltestbed.identification.settings import ContactIdentifier
from hiltestbed.plugins import register

INSTRUMENTAL_SAMPLES = 12
LONGEST = 10_000  # ticks: seconds at any rate of a loop
# fraction of the deepest x so far; below it samples are skipped, since ln x magnifies any error of
# the touch point
SHALLOW = 0.1
DAMPING_SHARE = 4.0 / (3.0 * math.pi)
P0 = 1e12  # [N^2] of the scaled state: large against any force squared
TIME_SCALE = 0.02  # [s] the column x is scaled by the speed times this
SLOWEST_SPEED = 1e-5  # [m/s, rad/s] an axis that moves more slowly is not excited
ACCEPTED = 0.3  # relative standard deviation below which k is reported


class SampleFit:
    """Estimates on six axes for ``n`` runs, of one kernel; attributes as in
    :class:`RecursiveLeastSquares`, and ``found``: (q, n, 6) all of them.
    """

    stiffness_sd: Array | None = None
    damping_sd: Array | None = None

    def __init__(self, given: SampleParameters, kernel: Any, found: int, *state: Any) -> None:
        """``found``: number q of quantities, first k and c; state: what the ``kernel`` takes."""
        self.source, n = ContactSamples(given), len(given.sensors)
        self.found, self.samples = np.full((found, n, 6), np.nan), np.zeros((n, 6))
        self.stiffness, self.damping = self.found[:2]
        self._state = state
        self._take = bound(
            kernel, self.source.ready, self.source.sample, *state, self.samples, self.found
        )

    def update(self, wrench: Array, pose: Array, twist: Array) -> None:
        """Process the measurements at t_k: wrench ``(n, 6)``, pose ``(n, 7)``, twist ``(n, 6)``."""
        self.source.take(wrench, pose, twist)
        self._take()


@register
class Instrumental(ContactIdentifier):
    """Batch least squares with instrumental variables: the reference method for a noisy pose."""

    kind: Literal["instrumental"] = "instrumental"
    lag: Annotated[int, Field(ge=1, le=LONGEST)] = Field(
        default=2, description="Ticks by which the instruments are older than the samples"
    )

    @classmethod
    def estimator(cls, own: Sequence[Self], given: SampleParameters) -> SampleFit:
        n, lags = len(own), np.array([o.lag for o in own])
        past, length = np.zeros((n, int(lags.max()) + 1, 6, 3)), np.zeros(n, dtype=np.int64)
        # Z^T Phi, Z^T y
        return SampleFit(given, _instruments, 2, lags, past, length, np.zeros((n, 6, 3, 4)))


@njit(cache=True)
def _instruments(ready, sample, lags, past, length, sums, samples, found):
    """``past``: regressors of this contact, of ``length`` (n,) samples."""
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
            s = sums[i, j]
            for a in range(3):
                for b in range(4):
                    s[a, b] += past[i, then, j, a] * sample[i, j, b]
            samples[i, j] += 1.0
            if samples[i, j] < INSTRUMENTAL_SAMPLES:
                continue
            one = s[2, 2]
            xx = s[0, 0] - s[0, 2] * s[2, 0] / one
            xv = s[0, 1] - s[0, 2] * s[2, 1] / one
            xy = s[0, 3] - s[0, 2] * s[2, 3] / one
            vx = s[1, 0] - s[1, 2] * s[2, 0] / one
            vv = s[1, 1] - s[1, 2] * s[2, 1] / one
            vy = s[1, 3] - s[1, 2] * s[2, 3] / one
            det = xx * vv - xv * vx
            if xx >= samples[i, j] * MINIMUM_TRAVEL**2 and abs(det) > 1e-10 * abs(xx * vv):
                found[0, i, j] = (vv * xy - xv * vy) / det
                found[1, i, j] = (xx * vy - vx * xy) / det
        length[i] += 1


@register
class HuntCrossley(ContactIdentifier):
    """Single-stage fit of the Hunt-Crossley law F = k x^n (1 + alpha v), with the pose at the time
    the force acted.
    """

    kind: Literal["hunt_crossley"] = "hunt_crossley"

    @classmethod
    def estimator(cls, own: Sequence[Self], given: SampleParameters) -> SampleFit:
        n = len(own)
        # also n [-], k [N/m^n] and alpha [s/m]
        return SampleFit(given, _hunt_crossley, 5, np.zeros((n, 6, SUMS)), np.zeros((n, 6)))


@njit(cache=True)
def _hunt_crossley(ready, sample, sums, deepest, samples, found):
    stiffness, damping = found[0], found[1]
    exponent, coefficient, alpha = found[2], found[3], found[4]
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


@register
class KalmanIdentifier(ContactIdentifier):
    """Adaptive Kalman filter of k, c and an intercept, all modelled as a random walk."""

    kind: Literal["kalman"] = "kalman"
    wander: NotNegative = Field(
        default=1e-6,
        description="Factor q of the process noise of k and c, Q = q K e^2 K^T [-]; 0: none",
    )

    @classmethod
    def estimator(cls, own: Sequence[Self], given: SampleParameters) -> SampleFit:
        n, wander = len(own), np.array([o.wander for o in own])
        state, covariance = np.zeros((n, 6, 3)), np.tile(P0 * np.eye(3), (n, 6, 1, 1))
        # variance of the force; speed that scales the columns, 0: not yet known
        noise, speed = np.zeros((2, n, 6))
        sigma = [[max(s.noise, 1e-6), max(s.torque_noise, 1e-7)] for s in given.sensors]
        floor = np.repeat(np.array(sigma) ** 2, 3, axis=1)
        fit = SampleFit(given, _kalman, 4, (wander, floor), state, covariance, noise, speed)
        fit.stiffness_sd, fit.damping_sd = fit.found[2:]
        return fit


@njit(cache=True)
def _kalman(ready, sample, given, state, covariance, noise, speed, samples, found):
    (wander, floor), phi, gain = given, np.empty(3), np.empty(3)
    for i in range(sample.shape[0]):
        if not ready[i]:
            continue
        for j in range(6):
            x, v, one, y = sample[i, j]
            if speed[i, j] == 0.0:
                if abs(v) < SLOWEST_SPEED:
                    continue
                speed[i, j] = abs(v)
            s = speed[i, j]
            phi[0], phi[1], phi[2] = x / (s * TIME_SCALE), v / s, one
            P, theta = covariance[i, j], state[i, j]
            error, spread = y, 0.0
            for a in range(3):
                error -= phi[a] * theta[a]
                gain[a] = P[a, 0] * phi[0] + P[a, 1] * phi[1] + P[a, 2] * phi[2]
                spread += phi[a] * gain[a]
            samples[i, j] += 1.0
            count = samples[i, j] - 3.0
            if count > 0.0:  # the first three samples determine the state and leave no residual
                noise[i, j] += (max(error * error - spread, 0.0) - noise[i, j]) / count
            R = max(noise[i, j], floor[i, j])
            total = spread + R
            push = wander[i] * error * error / (total * total) if count > MINIMUM_SAMPLES else 0.0
            for a in range(3):
                theta[a] += gain[a] / total * error
            for a in range(3):
                for b in range(3):
                    P[a, b] += gain[a] * gain[b] * (push - 1.0 / total)
            if count < MINIMUM_SAMPLES:
                continue
            k, sd = theta[0] / (s * TIME_SCALE), math.sqrt(max(P[0, 0], 0.0)) / (s * TIME_SCALE)
            if k > 0.0 and sd < ACCEPTED * k:
                found[0, i, j], found[1, i, j] = k, theta[1] / s
                found[2, i, j], found[3, i, j] = sd, math.sqrt(max(P[1, 1], 0.0)) / s
            else:
                for q in range(4):
                    found[q, i, j] = np.nan
