"""Extrapolation of the measured force over the delay, by a polynomial or a Kalman filter.

The polynomial of order p through the last p + 1 samples spaced one delay apart, evaluated one delay
ahead:

    F(t) ~ sum over i of (-1)^i C(p + 1, i + 1) F_meas(t - i tau);
    p = 3: 4 F_0 - 6 F_1 + 4 F_2 - F_3

(T. Horiuchi, M. Inoue, T. Konno, Y. Namita, "Real-time hybrid experimental system with actuator
delay compensation and its application to a piping system with energy absorber", Earthquake Eng.
Struct. Dyn. 28, 1999, where it extrapolates the displacement).

The Kalman predictor takes the force for a motion of constant second derivative that white noise of
density q [N^2/s^5] drives, measured with white noise of density r [N^2 s]. Of that model the Kalman
filter is the best linear estimator of F, F' and F'' (R. E. Kalman, "A new approach to linear
filtering and prediction problems", J. Basic Engineering 82, 1960; Y. Bar-Shalom, X. R. Li, T.
Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, sections 6.2.3 and
6.5, there of a target's position). Its gains are those of the steady state, from the discrete
Riccati equation, and

    F(t) ~ F + tau F' + tau^2/2 F''

of the estimate at the stamp of the reading. Only q/r counts: as long as (q/r)^(1/6) is far below
the rate, the poles of the filter lie on a Butterworth circle of this radius, which ``bandwidth``
sets.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field

from hiltestbed.compensation.history import History
from hiltestbed.compensation.interfaces import ForceBlock, ForcePath, KernelBlock
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.settings import BlockMethod
from hiltestbed.compiled.jit import njit
from hiltestbed.config.validation import Positive
from hiltestbed.frames import Array
from hiltestbed.plugins import register


@register
class Polynomial(BlockMethod):
    """Polynomial extrapolation of the measured wrench over the delay, through samples spaced one
    delay apart.
    """

    kind: Literal["polynomial"] = "polynomial"
    order: Annotated[int, Field(ge=1, le=5)] = Field(
        default=3, description="Order of the polynomial"
    )
    removes_delay: ClassVar[bool] = True

    @classmethod
    def block(cls, own: Sequence[Self], path: ForcePath) -> ForceBlock:
        return PolynomialBlock(path.delay * path.rate, [force.order for force in own])


class PolynomialBlock:
    """The extrapolation of all six components of the wrench, for ``n`` runs."""

    def __init__(self, ticks: Array, orders: Sequence[int]) -> None:
        """``ticks``: (n,) delay [ticks]. orders: of each run's polynomial."""
        n, highest = len(ticks), max(orders)
        self._ticks = ticks
        self._weights = np.array(
            [[(-1) ** i * math.comb(p + 1, i + 1) for i in range(highest + 1)] for p in orders],
            dtype=float,
        )
        self._history = History(6, ticks * highest)
        self.output = np.zeros((n, 6))

    def compensate(self, measurement: Measurement) -> Array:
        """``(n, 6)`` the wrench extrapolated by the delay."""
        self._history.remember(measurement.wrench)
        self.output[:] = 0.0
        for i in range(self._weights.shape[1]):
            self.output += self._weights[:, i, None] * self._history.before(i * self._ticks)
        return self.output


@register
class Kalman(BlockMethod):
    """Kalman predictor: force, slope and curvature of each axis, estimated in white noise and
    extrapolated over the delay.
    """

    kind: Literal["kalman"] = "kalman"
    bandwidth: Positive = Field(
        default=150.0, description="Radius of the filter's poles over 2 pi [Hz]"
    )
    removes_delay: ClassVar[bool] = True

    @classmethod
    def block(cls, own: Sequence[Self], path: ForcePath) -> ForceBlock:
        h = 1.0 / path.rate
        gain = np.array([steady_gain(2.0 * math.pi * force.bandwidth, h) for force in own])
        # force, slope [1/s], curvature [1/s^2]
        return KernelBlock(_predict, ("wrench",), gain, path.delay, h, np.zeros((len(own), 6, 3)))

    def memory(self) -> float:
        return 1.0 / (2.0 * math.pi * self.bandwidth)


def steady_gain(radius: float, tick: float) -> Array:
    """(3,) gains of F, F' [1/s] and F'' [1/s^2] for a ``radius`` [rad/s] of the poles, at a tick of
    ``tick`` [s].

    In units of a tick, so that the Riccati equation is well conditioned at any rate.
    """
    from scipy.linalg import solve_discrete_are

    move = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
    seen = np.array([[1.0, 0.0, 0.0]])
    drive = (radius * tick) ** 6 * np.array(
        [[1 / 20, 1 / 8, 1 / 6], [1 / 8, 1 / 3, 1 / 2], [1 / 6, 1 / 2, 1.0]]
    )
    covariance = solve_discrete_are(move.T, seen.T, drive, np.ones((1, 1)))
    return covariance[:, 0] / (covariance[0, 0] + 1.0) / np.array([1.0, tick, tick**2])


@njit(cache=True)
def _predict(u, gain, delay, h, state, y):
    for i in range(u.shape[0]):
        t = delay[i]
        for j in range(6):
            s = state[i, j]
            s[0] += h * (s[1] + 0.5 * h * s[2])
            s[1] += h * s[2]
            off = u[i, j] - s[0]
            s[0] += gain[i, 0] * off
            s[1] += gain[i, 1] * off
            s[2] += gain[i, 2] * off
            y[i, j] = s[0] + t * (s[1] + 0.5 * t * s[2])
