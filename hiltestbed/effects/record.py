"""What happens to the measured wrench beside the sensor: small forces that are not passed on, a record that is stamped late."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from hiltestbed.effects.access import effects_of
from hiltestbed.frames import Array
from hiltestbed.scenario import Scenario
from hiltestbed.signals import Trace


class InputDeadZone:
    """``loop.deadzone``: what the compensation is given of a reading, for ``n`` runs.

    Attributes:
        active: whether any run has one. wrench: ``(n, 6)`` what is left of the last reading.
    """

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        self._width = np.array([max((p["width"] for kind, p in effects_of(s) if kind == "loop.deadzone"), default=0.0) for s in scenarios])
        self.active = bool(self._width.any())
        self.wrench = np.zeros((len(scenarios), 6))

    def update(self, reading: Array) -> None:
        """Take in a reading ``(n, 6)``: a force component below the width is zero, torques pass."""
        _dead(reading, self._width, self.wrench)


@njit(cache=True)
def _dead(reading, width, out):
    for i in range(reading.shape[0]):
        for j in range(6):
            out[i, j] = 0.0 if j < 3 and abs(reading[i, j]) < width[i] else reading[i, j]


def stamp_late(trace: Trace, scenarios: Sequence[Scenario]) -> None:
    """``log.skew``: put the reading of t - delay into the row of t, zero before the start; between rows linearly."""
    rows = np.arange(len(trace.t))
    for i, scenario in enumerate(scenarios):
        delay = sum(p["delay"] for kind, p in effects_of(scenario) if kind == "log.skew")
        if delay > 0.0:
            at = rows - delay * scenario.rate
            record = trace["wrench_meas"][:, i].copy()
            for j in range(6):
                trace["wrench_meas"][:, i, j] = np.interp(at, rows, record[:, j], left=0.0)
