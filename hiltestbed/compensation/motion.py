"""From the numerical model's motion to what the platform's servo is told."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numba import njit

from hiltestbed.compensation.adaptive_time_series import AdaptiveTimeSeries
from hiltestbed.compensation.admittance import Admittance
from hiltestbed.compensation.inverse_model import InverseModel
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.frames import Array
from hiltestbed.scenario import Scenario

FED = ("feedforward", "admittance")  # kinds with which the servo is told velocity and acceleration too


class PoseCommand(Protocol):
    """A method that changes the commanded pose."""

    def command(self, pose: Array, derivatives: tuple[Array, Array, Array], measurement: Measurement, out: Array) -> None:
        """Write the pose ``out`` (n, 7) to tell the platform.

        Args:
            pose: ``(n, 7)`` pose of A in P that is to be reached at t_(k+1).
            derivatives: ``(n, 6)`` each: velocity then, acceleration and jerk over the tick.
            measurement: what is known at t_k.
        """
        ...

    def buffers(self) -> dict[str, Array]:
        """The arrays that make up the state."""
        ...


class MotionCommand:
    """Pose, velocity and acceleration references of the platform for ``n`` runs.

    With ``compensation.motion: feedforward`` (and with an admittance on top of it) the servo is told the velocity and the acceleration
    of the tick that it is to run; else it is told the pose alone, changed by the method if there is one, and follows with its own lag.

    Attributes:
        pose: ``(n, 7)`` pose reference for the end of the tick.
        twist: ``(n, 6)`` velocity reference over the tick.
        acceleration: ``(n, 6)`` change of the velocity reference a second.
    """

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        n = len(scenarios)
        self._rate = scenarios[0].rate
        self._feed = np.array([float(s.compensation.motion.kind in FED) for s in scenarios])
        self._method = _method(scenarios)
        self.pose = np.zeros((n, 7))
        self.twist = np.zeros((n, 6))
        self.acceleration = np.zeros((n, 6))
        self._previous = np.zeros((n, 6))
        self._rate_before, self._still = np.zeros((n, 6)), np.zeros((n, 6))
        self._velocity, self._accel, self._jerk = np.zeros((n, 6)), np.zeros((n, 6)), np.zeros((n, 6))

    def start(self, twist: Array) -> None:
        """The twist ``(n, 6)`` before the first tick."""
        self._previous[:] = twist

    def update(self, pose: Array, twist: Array, measurement: Measurement) -> None:
        """Set the references from the pose ``(n, 7)`` and twist ``(n, 6)`` commanded for the coming tick."""
        if self._method is None:
            self.pose[:] = pose
        else:
            derivatives = (self._velocity, self._accel, self._jerk)
            _differentiate(twist, self._previous, self._rate, *derivatives)
            self._method.command(pose, derivatives, measurement, self.pose)
        yielding = self._method.rate if isinstance(self._method, Admittance) else self._still
        _refer(twist, yielding, self._rate, self._feed, self._previous, self._rate_before, self.twist, self.acceleration)

    def buffers(self) -> dict[str, Array]:
        own = {"pose": self.pose, "twist": self.twist, "acceleration": self.acceleration, "previous": self._previous}
        return own | {"accel": self._accel, "rate_before": self._rate_before} | (self._method.buffers() if self._method else {})


def _method(scenarios: Sequence[Scenario]) -> PoseCommand | None:
    match scenarios[0].compensation.motion.kind:
        case "admittance":
            return Admittance(scenarios)
        case "inverse_model":
            return InverseModel(scenarios)
        case "adaptive_time_series":
            return AdaptiveTimeSeries(scenarios)
        case _:
            return None


@njit(cache=True)
def _refer(twist, yielding, rate, feed, previous, rate_before, velocity, acceleration):
    """Velocity and acceleration references of the tick, of which ``yielding`` (n, 6) is what an admittance adds to the velocity."""
    for i in range(twist.shape[0]):
        for j in range(6):
            change = twist[i, j] - previous[i, j] + yielding[i, j] - rate_before[i, j]
            acceleration[i, j] = change * rate * feed[i]
            velocity[i, j] = twist[i, j] * feed[i] + yielding[i, j]
            previous[i, j], rate_before[i, j] = twist[i, j], yielding[i, j]


@njit(cache=True)
def _differentiate(twist, previous, rate, velocity, acceleration, jerk):
    """A semi-implicit velocity belongs to the middle of its tick: half a tick of the acceleration takes it to the end."""
    for i in range(twist.shape[0]):
        for j in range(6):
            change = rate * (twist[i, j] - previous[i, j])
            jerk[i, j] = rate * (change - acceleration[i, j])
            acceleration[i, j] = change
            velocity[i, j] = twist[i, j] + 0.5 / rate * change
