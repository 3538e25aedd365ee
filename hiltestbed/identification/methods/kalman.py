"""Adaptive Kalman filter of stiffness and damping.

The state (k, c, b) of each axis follows a random walk; the force is the observation, ``F = k x + c
v + b``. The variance of the force noise is estimated from the innovations, ``R <- R + (e^2 - phi P
phi - R)/N``, and so is the process noise, ``Q = q K e^2 K^T`` (A. P. Sage, G. W. Husa, "Adaptive
filtering with unknown prior statistics", 1969; used for k and c on such a rig by F. He et al.,
Chin. J. Mech. Eng. 35:149, 2022). With q = 0 it is recursive least squares. Columns are scaled by
the first speed in contact, so that one P0 suits all axes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from pydantic import Field

from hiltestbed.compiled.bound import bound
from hiltestbed.compiled.jit import njit
from hiltestbed.config.validation import NotNegative
from hiltestbed.frames import Array
from hiltestbed.identification.least_squares import MINIMUM_SAMPLES
from hiltestbed.identification.samples import ContactSamples
from hiltestbed.identification.settings import Identifier, identifier_of
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario

P0 = 1e12  # [N^2] of the scaled state: large against any force squared
TIME_SCALE = 0.02  # [s] the column x is scaled by the speed times this
SLOWEST_SPEED = 1e-5  # [m/s, rad/s] an axis that moves more slowly is not excited
ACCEPTED = 0.3  # relative standard deviation below which k is reported


@register
class KalmanIdentifier(Identifier):
    """Adaptive Kalman filter of k, c and an intercept, all modelled as a random walk."""

    kind: Literal["kalman"] = "kalman"
    wander: NotNegative = Field(
        default=1e-6,
        description="Factor q of the process noise of k and c, Q = q K e^2 K^T [-]; 0: none",
    )

    @classmethod
    def start(cls, scenarios: Sequence[Scenario]) -> AdaptiveKalman:
        return AdaptiveKalman(scenarios)


class _State(NamedTuple):
    """The state of the filters, ``(n, 6, ...)``."""

    state: Array
    covariance: Array
    noise: Array  # variance of the force
    speed: Array  # that scales the columns; 0: not yet known
    samples: Array
    found: Array  # (4, n, 6) k, c and their standard deviations


class AdaptiveKalman:
    """Estimates on six axes for ``n`` runs; attributes as in :class:`RecursiveLeastSquares`."""

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        n = len(scenarios)
        self.source = ContactSamples(scenarios)
        self._wander = np.array([o.wander for o in identifier_of(scenarios, KalmanIdentifier)])
        found = np.full((4, n, 6), np.nan)
        self.stiffness, self.damping, self.stiffness_sd, self.damping_sd = found
        self.samples = np.zeros((n, 6))
        self._floor = np.array(
            [
                [max(s.sensor.noise, 1e-6) ** 2] * 3 + [max(s.sensor.torque_noise, 1e-7) ** 2] * 3
                for s in scenarios
            ]
        )
        covariance, noise, speed = np.tile(P0 * np.eye(3), (n, 6, 1, 1)), *np.zeros((2, n, 6))
        self._state = _State(np.zeros((n, 6, 3)), covariance, noise, speed, self.samples, found)
        given = (self.source.ready, self.source.sample, self._wander, self._floor)
        self._filter = bound(_filter, *given, self._state)

    def update(self, wrench: Array, pose: Array, twist: Array) -> None:
        """Process the measurements at t_k: wrench ``(n, 6)``, pose ``(n, 7)``, twist ``(n, 6)``."""
        self.source.take(wrench, pose, twist)
        self._filter()


@njit(cache=True)
def _filter(ready, sample, wander, floor, now):
    state, covariance, noise, speed, samples, found = now
    phi, gain = np.empty(3), np.empty(3)
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
