"""From the numerical model's motion to what the platform's servo is told."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hiltestbed.frames import Array
from hiltestbed.scenario import Scenario


class MotionCommand:
    """Pose, velocity and acceleration references of the platform for ``n`` runs.

    With ``compensation.motion: feedforward`` the servo is told the velocity and the acceleration of the tick that it is to run;
    with ``none`` it is told the pose alone and follows with its own lag.

    Attributes:
        twist: ``(n, 6)`` velocity reference over the tick.
        acceleration: ``(n, 6)`` change of the velocity reference a second.
    """

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        n = len(scenarios)
        self._rate = scenarios[0].rate
        self._feed = np.array([[float(s.compensation.motion.kind == "feedforward")] for s in scenarios])
        self.twist = np.zeros((n, 6))
        self.acceleration = np.zeros((n, 6))
        self._previous = np.zeros((n, 6))

    def start(self, twist: Array) -> None:
        """The twist ``(n, 6)`` before the first tick."""
        self._previous[:] = twist

    def update(self, twist: Array) -> None:
        """Set the references from the twist ``(n, 6)`` commanded for the coming tick."""
        np.subtract(twist, self._previous, out=self.acceleration)
        self.acceleration *= self._rate * self._feed
        np.multiply(twist, self._feed, out=self.twist)
        self._previous[:] = twist

    def buffers(self) -> dict[str, Array]:
        return {"twist": self.twist, "acceleration": self.acceleration, "previous": self._previous}
