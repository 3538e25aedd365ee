"""The wrench that the nominal mechanism exerts at the poses that the platform reached."""

from __future__ import annotations

from typing import Any

import numpy as np

from hiltestbed.frames import Array
from hiltestbed.platform.plant import Plant
from hiltestbed.scenario import Scenario, resolved, scenario_from


class Expected:
    """Wrench on P over time, from the poses reached.

    Attributes:
        wrench: (N m, 6) at the physics instants, in P at P's origin; the last of each tick is t_k.
    """

    def __init__(self, scenario: Scenario, poses: Array) -> None:
        """``poses`` (N, 7) of A in P at t_k."""
        data: dict[str, Any] = resolved(scenario) | {"effects": []}
        data["rig"]["platform"]["tracking"] = data["rig"]["upper"]["tracking"] = "ideal"
        believed = scenario_from(data)
        plant = Plant([believed])
        still = np.zeros((1, 6))
        plant.reset(poses[None, 0], still)
        self._substeps, self._tick = believed.substeps, believed.tick
        self.wrench = np.zeros((len(poses) * self._substeps, 6))
        self.wrench[: self._substeps] = plant.wrench_sub[0, -1]
        for k in range(1, len(poses)):
            plant.advance(poses[None, k], still, still)
            self.wrench[k * self._substeps : (k + 1) * self._substeps] = plant.wrench_sub[0]

    def at(self, ticks: Array, delay: float) -> Array:
        """(K, 6) the wrench ``delay`` [s] before each of the ``ticks`` (K,), interpolated linearly
        between instants.
        """
        m = self._substeps
        instant = np.clip(m * ticks + m - 1 - delay / self._tick * m, 0.0, len(self.wrench) - 1.0)
        low = np.floor(instant).astype(int)
        high = np.minimum(low + 1, len(self.wrench) - 1)
        return self.wrench[low] + (instant - low)[:, None] * (self.wrench[high] - self.wrench[low])
