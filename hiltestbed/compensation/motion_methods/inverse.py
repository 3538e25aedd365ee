"""The command is the model's pose, or that passed through an inverse of the platform's response:
given beforehand, or fitted to what it does.

The inverse of a platform with the response 1/((1 + T s)(1 + 2 zeta s/w + s^2/w^2)) is

    x_c = x + a1 dx/dt + a2 d2x/dt2 + a3 d3x/dt3,   1 + a1 s + a2 s^2 + a3 s^3 = (1 + T s)(1 + 2
    zeta s/w + s^2/w^2) to ``order``

(third-order platform and second-order position lead: C. Qi et al., J. Intell. Robot. Syst. 2016; in
real-time hybrid simulation the feed-forward of B. M. Phillips, B. F. Spencer, J. Eng. Mech. 139,
2013).

The adaptive time series is fitted to the platform's response to recent commands:

    x_c = a0 x + a1 dx/dt + a2 d2x/dt2,   a = least squares of the past x_c on the measured x and
    its derivatives over a window

(Y. Chae, K. Kazemibidokhti, J. M. Ricles, "Adaptive time series compensator for delay compensation
of servo-hydraulic actuator systems for real-time hybrid simulation", Earthquake Eng. Struct. Dyn.
42, 2013). The fit is made along the insertion, with an exponential window, and used
on all six axes; the coefficients are held within bounds, as the authors advise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field

from hiltestbed.compensation.interfaces import Derivatives, PoseBlock
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.settings import Input, MotionMethod
from hiltestbed.compiled.jit import njit
from hiltestbed.config.validation import NotNegative, Positive
from hiltestbed.frames import Array, pose_step
from hiltestbed.plugins import register

BOUNDS = np.array([[0.9, 1.1], [0.0, 0.05], [0.0, 1e-3]])  # of a0, a1 [s], a2 [s^2]
# [-], [1/s], [1/s^2]: make the columns of similar size at a few Hz
SCALES = np.array([1.0, 30.0, 1000.0])
PRIOR = 1e-6  # [m^2] weight of the initial coefficients, against the sum of x^2 over the window


@register
class NoMotionCompensation(MotionMethod):
    """No compensation: the platform receives only the pose."""

    kind: Literal["none"] = "none"
    reads: ClassVar[frozenset[Input]] = frozenset()
    tells_model_pose: ClassVar[bool] = True


@register
class Feedforward(MotionMethod):
    """Feed-forward: the platform's servo also receives velocity and acceleration."""

    kind: Literal["feedforward"] = "feedforward"
    reads: ClassVar[frozenset[Input]] = frozenset()
    feeds: ClassVar[bool] = True
    tells_model_pose: ClassVar[bool] = True


@register
class InverseModel(MotionMethod):
    """Inverse model: the command passes the platform's inverse response (1 + T s)(1 + 2 zeta s/w +
    s^2/w^2), truncated at an order.
    """

    kind: Literal["inverse_model"] = "inverse_model"
    order: Annotated[int, Field(ge=1, le=3)] = Field(
        default=2, description="Order at which the inverse response is truncated"
    )
    bandwidth: Positive = Field(
        default=40.0, description="Bandwidth w/(2 pi) of the platform's response [Hz]"
    )
    damping_ratio: Positive = Field(
        default=1.0, description="Damping ratio zeta of the platform's response [-]"
    )
    time_constant: NotNegative = Field(
        default=0.0,
        description="Time constant T of the platform's response [s], which makes it third-order; "
        "0: second-order",
    )
    reads: ClassVar[frozenset[Input]] = frozenset()

    @classmethod
    def block(cls, own: Sequence[Self], rate: float) -> PoseBlock:
        return Inverse(np.array([m.coefficients() for m in own]))

    def coefficients(self) -> tuple[float, float, float, float]:
        """1, a1 [s], a2 [s^2], a3 [s^3]."""
        w, T = 2.0 * math.pi * self.bandwidth, self.time_constant
        a, b = 2.0 * self.damping_ratio / w, 1.0 / w**2
        return 1.0, T + a, (a * T + b) * (self.order >= 2), b * T * (self.order >= 3)


@register
class AdaptiveTimeSeries(MotionMethod):
    """Adaptive time series: the command is a0 x + a1 x' + a2 x'', with coefficients fitted to the
    platform's recent response.
    """

    kind: Literal["adaptive_time_series"] = "adaptive_time_series"
    window: Positive = Field(
        default=1.0, description="Time constant of the fit's exponential window [s]"
    )
    delay: NotNegative = Field(
        default=0.008, description="Delay of the platform assumed at the start [s]"
    )
    reads: ClassVar[frozenset[Input]] = frozenset({"pose"})

    @classmethod
    def block(cls, own: Sequence[Self], rate: float) -> PoseBlock:
        tick = 1.0 / rate
        start = np.array([[1.0, m.delay, 0.25 * m.delay**2, 0.0] for m in own])
        return AdaptiveInverse(start, tick, np.array([math.exp(-tick / m.window) for m in own]))


class Inverse:
    """An inverse response on all six axes, for ``n`` runs.

    Attributes:
        coefficients: ``(n, 4)`` a0 [-], a1 [s], a2 [s^2], a3 [s^3].
    """

    rate: Array | None = None

    def __init__(self, coefficients: Array) -> None:
        self.coefficients = coefficients

    def command(
        self, pose: Array, derivatives: Derivatives, measurement: Measurement, out: Array
    ) -> None:
        """Write to ``out`` (n, 7) the pose commanded to the platform."""
        _apply(pose, *derivatives, self.coefficients, out)


class AdaptiveInverse(Inverse):
    """The same, with coefficients that are fitted to the response; a3 is 0."""

    def __init__(self, coefficients: Array, tick: float, fade: Array) -> None:
        """``fade``: (n,) factor per ``tick`` [s] of what counts in the fit."""
        super().__init__(coefficients)
        self._given = (tick, fade, coefficients.copy())
        self._sums = np.zeros((len(fade), 3, 4))
        # last command, last measured position and velocity, ticks
        self._memory = np.zeros((len(fade), 4))

    def command(
        self, pose: Array, derivatives: Derivatives, measurement: Measurement, out: Array
    ) -> None:
        """Write to ``out`` (n, 7) the pose commanded to the platform."""
        _adapt(measurement.pose, *self._given, self._sums, self._memory, self.coefficients)
        super().command(pose, derivatives, measurement, out)
        self._memory[:, 0] = out[:, 2]


@njit(cache=True)
def _adapt(pose_act, h, fade, believed, sums, memory, coefficients):
    row, matrix, side = np.empty(3), np.empty((3, 3)), np.empty(3)
    for i in range(pose_act.shape[0]):
        m = memory[i]
        x = pose_act[i, 2]
        v = (x - m[1]) / h
        if m[3] >= 2.0:
            row[0], row[1], row[2] = x, v / SCALES[1], (v - m[2]) / h / SCALES[2]
            for a in range(3):
                for b in range(3):
                    sums[i, a, b] = fade[i] * sums[i, a, b] + row[a] * row[b]
                sums[i, a, 3] = fade[i] * sums[i, a, 3] + row[a] * m[0]
        m[1], m[2], m[3] = x, v, m[3] + 1.0
        for a in range(3):
            for b in range(3):
                matrix[a, b] = sums[i, a, b] + (PRIOR if a == b else 0.0)
            side[a] = sums[i, a, 3] + PRIOR * believed[i, a] * SCALES[a]
        solution = np.linalg.solve(matrix, side)
        for a in range(3):
            coefficients[i, a] = min(max(solution[a] / SCALES[a], BOUNDS[a, 0]), BOUNDS[a, 1])


@njit(cache=True)
def _apply(pose, velocity, acceleration, jerk, coefficients, out):
    ahead = np.empty(6)
    for i in range(pose.shape[0]):
        a0, a1, a2, a3 = coefficients[i]
        for j in range(6):
            ahead[j] = a1 * velocity[i, j] + a2 * acceleration[i, j] + a3 * jerk[i, j]
            if j < 3:
                ahead[j] += (a0 - 1.0) * pose[i, j]
        pose_step(pose[i], ahead, 1.0, out[i])
