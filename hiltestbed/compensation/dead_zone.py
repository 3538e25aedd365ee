"""A dead zone, as rigs have it against the drift of the velocity under noise and bias: a force below the width is taken as none.

It is no compensation of the delay; it distorts by itself, towards divergence or convergence (Li et al., hybrid Smith predictor with
dead-zone disturbance observer).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.sections import force_section
from hiltestbed.frames import Array
from hiltestbed.scenario import Scenario


class DeadZone:
    """The dead zone on each force axis, for ``n`` runs; the torques pass while a force does."""

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        self._width = np.array([[force_section(s).width] for s in scenarios])
        self.output = np.zeros((len(scenarios), 6))

    def compensate(self, measurement: Measurement) -> Array:
        """``(n, 6)`` the wrench without what lies within the dead zone."""
        force = measurement.wrench[:, :3]
        outside = np.abs(force) > self._width
        np.multiply(force, outside, out=self.output[:, :3])
        np.multiply(measurement.wrench[:, 3:], outside.any(axis=1, keepdims=True), out=self.output[:, 3:])
        return self.output

    def buffers(self) -> dict[str, Array]:
        return {"output": self.output}
