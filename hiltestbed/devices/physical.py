"""The physical side of a scenario alone: rig, mechanism and force sensor, in the order of the loop,
without the numerical model.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hiltestbed.errors import HiltestbedError
from hiltestbed.frames import Array, twist_between
from hiltestbed.loop import simulated
from hiltestbed.numerical_model.bodies import approach_state
from hiltestbed.scenario import Scenario, load_scenario


class SimulatedRig:
    """The simulated rig, commanded with poses only: velocity and acceleration, where the scenario
    feeds them forward, are derived from them.

    Attributes:
        period: of a tick [s].
        pose: (7,) of A in P, reached at t_k. wrench: (6,) read by the sensor at t_k, in P at P.
    """

    def __init__(self, scenario: Scenario, moving: bool = False) -> None:
        """``moving``: start with a uniform approach, as a run does; otherwise at rest."""
        self.scenario, self.period = scenario, scenario.tick
        self._sensor, self._plant, _ = simulated([scenario], 1)
        state = approach_state(scenario.approach)
        # one view for all ticks: the sensor's kernels are bound to it
        self._felt = self._plant.wrench_sub[:, -1]
        self.pose: Array = self._plant.pose_act[0]
        self.wrench: Array = np.zeros(6)
        self._feed = float(scenario.compensation.motion.feeds)
        self._k = 0
        self._goal, self._before = np.zeros((1, 7)), state[:7].copy()
        self._twist, self._acceleration = np.zeros((1, 6)), np.zeros((1, 6))
        self._slope, self._slope_before = np.zeros(6), state[7:] * moving
        self._plant.reset(state[None, :7], self._slope_before[None])
        self._read()

    def step(self, pose_cmd: Array) -> None:
        """Advance by one tick, at whose end ``pose_cmd`` (7,) of A in P is to be reached. Raises
        HiltestbedError if the rig has diverged.
        """
        twist_between(self._before, pose_cmd, self.period, self._slope)
        self._goal[0] = self._before[:] = pose_cmd
        self._twist[0] = self._feed * self._slope
        self._acceleration[0] = self._feed * (self._slope - self._slope_before) / self.period
        self._slope_before[:] = self._slope
        self._plant.begin(self._goal, self._twist, self._acceleration)
        self._sensor.feel(self._k, self._felt)
        self._plant.finish()
        if self._plant.diverged[0]:
            raise HiltestbedError(
                f"the rig diverged at t = {self._k * self.period:.6f} s: "
                f"{self._plant.divergence(0)}"
            )
        self._k += 1
        self._read()

    def _read(self) -> None:
        self.wrench[:] = self._sensor.read(self._k, self._plant.wrench_sub)[0]

    @property
    def touching(self) -> bool:
        """Whether the mechanisms touch."""
        return bool(self._plant.contact[0])

    @property
    def true_wrench(self) -> Array:
        """(6,) the contact wrench itself, in P at P's origin."""
        return self._plant.wrench_sub[0, -1]


def from_file(path: Path) -> SimulatedRig:
    """The rig of a scenario file, moving as at the start of a run, for an FMU."""
    return SimulatedRig(load_scenario(path), moving=True)
