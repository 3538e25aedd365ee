"""From the numerical model's motion to the references of the platform's servo."""

from __future__ import annotations

import numpy as np

from hiltestbed.compensation.interfaces import PoseBlock
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array


class MotionCommand:
    """Pose, velocity and acceleration references of the platform for ``n`` runs.

    With ``compensation.motion: feedforward`` (and with an admittance, which includes it) the servo
        receives the velocity and acceleration of the coming tick as feed-forward; otherwise it
        receives the pose alone, changed by the method if any, and follows with its own lag.

    Attributes:
        pose: ``(n, 7)`` pose reference for the end of the tick.
        twist: ``(n, 6)`` velocity reference over the tick.
        acceleration: ``(n, 6)`` rate of change of the velocity reference.
    """

    def __init__(self, rate: float, feed: Array, method: PoseBlock | None) -> None:
        """``rate`` [Hz]; feed: (n,) 1 with feed-forward, else 0; method: changes the pose."""
        n = len(feed)
        self._rate, self._feed, self._method = rate, feed, method
        self.pose = np.zeros((n, 7))
        self.twist = np.zeros((n, 6))
        self.acceleration = np.zeros((n, 6))
        self._previous = np.zeros((n, 6))
        self._rate_before, self._still = np.zeros((n, 6)), np.zeros((n, 6))
        self._velocity = np.zeros((n, 6))
        self._accel = np.zeros((n, 6))
        self._jerk = np.zeros((n, 6))
        self._pass_pose = Call(
            _pass_pose,
            GIVEN,
            GIVEN,
            self.pose,
            self._still,
            self._rate,
            self._feed,
            self._previous,
            self._rate_before,
            self.twist,
            self.acceleration,
        )

    def start(self, twist: Array) -> None:
        """The twist ``(n, 6)`` before the first tick."""
        self._previous[:] = twist

    def update(self, pose: Array, twist: Array, measurement: Measurement) -> None:
        """Set the references from pose ``(n, 7)`` and twist ``(n, 6)`` of the coming tick."""
        if self._method is None:
            self._pass_pose.on(pose, twist)()
            return
        derivatives = (self._velocity, self._accel, self._jerk)
        _differentiate(twist, self._previous, self._rate, *derivatives)
        self._method.command(pose, derivatives, measurement, self.pose)
        yielding = self._still if self._method.rate is None else self._method.rate
        _refer(
            twist,
            yielding,
            self._rate,
            self._feed,
            self._previous,
            self._rate_before,
            self.twist,
            self.acceleration,
        )


@njit(cache=True)
def _pass_pose(pose, twist, commanded, *references):
    """Command the pose unchanged, with its references."""
    for i in range(pose.shape[0]):
        for j in range(7):
            commanded[i, j] = pose[i, j]
    _refer(twist, *references)


@njit(cache=True)
def _refer(twist, yielding, rate, feed, previous, rate_before, velocity, acceleration):
    """Velocity and acceleration references; ``yielding`` (n, 6): velocity of an admittance."""
    for i in range(twist.shape[0]):
        for j in range(6):
            change = twist[i, j] - previous[i, j] + yielding[i, j] - rate_before[i, j]
            acceleration[i, j] = change * rate * feed[i]
            velocity[i, j] = twist[i, j] * feed[i] + yielding[i, j]
            previous[i, j], rate_before[i, j] = twist[i, j], yielding[i, j]


@njit(cache=True)
def _differentiate(twist, previous, rate, velocity, acceleration, jerk):
    """At the end of the tick: the semi-implicit velocity is that at its middle."""
    for i in range(twist.shape[0]):
        for j in range(6):
            change = rate * (twist[i, j] - previous[i, j])
            jerk[i, j] = rate * (change - acceleration[i, j])
            acceleration[i, j] = change
            velocity[i, j] = twist[i, j] + 0.5 / rate * change
