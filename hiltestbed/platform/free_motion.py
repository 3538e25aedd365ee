"""Replacement of compensation and numerical model in the loop of a rig with freely moving bodies:
nothing is commanded.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np

from hiltestbed.compensation.measurement import Measurement
from hiltestbed.frames import Array
from hiltestbed.numerical_model.bodies import approach_state

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario


class MovedBodies(Protocol):
    """What is read of a plant whose bodies move freely: pose ``(n, 7)``, twist ``(n, 6)``, and the
    wrench ``(n, substeps, 6)`` of each physics step.
    """

    pose_act: Array
    twist_act: Array
    wrench_sub: Array


class FreeMotion:
    """The motion of `n` pairs of bodies: the recorded commanded pose is the actual one, the wrench
    used is the physical one.

    That wrench is a view of the plant's array, which may be filled only after the tick has begun.
    """

    def __init__(self, scenarios: Sequence[Scenario], plant: MovedBodies) -> None:
        start = np.array([approach_state(s) for s in scenarios])
        self.pose: Array = start[:, :7].copy()
        self.twist: Array = start[:, 7:].copy()
        self.wrench: Array = plant.wrench_sub[:, -1]
        self._plant = plant

    def advance(self, measurement: Measurement) -> None:
        """Copy pose and twist of the bodies at t_k."""
        self.pose[:], self.twist[:] = self._plant.pose_act, self._plant.twist_act
