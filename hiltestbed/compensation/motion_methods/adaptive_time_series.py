"""Adaptive time series: the platform's inverse, fitted to its response to recent commands.

    x_c = a0 x + a1 dx/dt + a2 d2x/dt2,   a = least squares of the past x_c on the measured x and
    its derivatives over a window

(Y. Chae, K. Kazemibidokhti, J. M. Ricles, "Adaptive time series compensator for delay compensation
of servo-hydraulic actuator systems for real-time hybrid simulation", Earthquake Eng. Struct. Dyn.
42, 2013). The window is much longer than a bounce: in a single contact the coefficients come mainly
from the motion before it. The fit is made along the insertion, with an exponential window, and used
on all six axes; the coefficients are held within bounds, as the authors advise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field

from hiltestbed.compensation.interfaces import Derivatives
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.settings import Input, MotionMethod, motion_of
from hiltestbed.compiled.jit import njit
from hiltestbed.config.validation import NotNegative, Positive
from hiltestbed.frames import Array, pose_step
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario

BOUNDS = np.array([[0.9, 1.1], [0.0, 0.05], [0.0, 1e-3]])  # of a0, a1 [s], a2 [s^2]
# [-], [1/s], [1/s^2]: make the columns of similar size at a few Hz
SCALES = np.array([1.0, 30.0, 1000.0])
PRIOR = 1e-6  # [m^2] weight of the initial coefficients, against the sum of x^2 over the window


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
    def start(cls, scenarios: Sequence[Scenario]) -> AdaptiveTimeSeriesBlock:
        return AdaptiveTimeSeriesBlock(scenarios)


class AdaptiveTimeSeriesBlock:
    """The adaptive inverse, for ``n`` runs.

    Attributes:
        coefficients: ``(n, 3)`` a0 [-], a1 [s], a2 [s^2].
    """

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        n = len(scenarios)
        self.rate = None
        motion = motion_of(scenarios, AdaptiveTimeSeries)
        self._tick = 1.0 / scenarios[0].rate
        self._fade = np.array([math.exp(-self._tick / m.window) for m in motion])
        self.coefficients = np.array([[1.0, m.delay, 0.25 * m.delay**2] for m in motion])
        self._believed = self.coefficients.copy()
        self._sums = np.zeros((n, 3, 4))
        self._memory = np.zeros((n, 4))  # last command, last measured position and velocity, ticks

    def command(
        self, pose: Array, derivatives: Derivatives, measurement: Measurement, out: Array
    ) -> None:
        """Write to ``out`` (n, 7) the pose commanded to the platform."""
        _adapt(
            measurement.pose,
            self._tick,
            self._fade,
            self._believed,
            self._sums,
            self._memory,
            self.coefficients,
        )
        _apply(pose, derivatives[0], derivatives[1], self.coefficients, self._memory, out)


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
def _apply(pose, velocity, acceleration, coefficients, memory, out):
    ahead = np.empty(6)
    for i in range(pose.shape[0]):
        a0, a1, a2 = coefficients[i]
        for j in range(6):
            ahead[j] = a1 * velocity[i, j] + a2 * acceleration[i, j]
            if j < 3:
                ahead[j] += (a0 - 1.0) * pose[i, j]
        pose_step(pose[i], ahead, 1.0, out[i])
        memory[i, 0] = out[i, 2]
