"""When the latches of a probe in its cone close."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from hiltestbed.rig.touch import Touch

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario


class LatchCondition:
    """The conditions of `n` runs: depth, alignment and speed, all at once; a run without a latch never closes."""

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        latches = [s.mechanism.latch for s in scenarios]
        never = (-np.inf, 0.0, 0.0)
        self._limits = np.array([(la.depth, np.cos(np.radians(la.angle_deg)), la.speed) if la else never for la in latches])
        self._closing = np.zeros(len(scenarios), dtype=bool)

    def close(self, touch: Touch) -> None:
        """Latch the runs whose condition holds at the state of the last update."""
        pose, twist = touch.relative()
        if _due(pose, twist, self._limits, touch.latched, self._closing):
            touch.close(self._closing)


@njit(cache=True)
def _due(pose, twist, limits, latched, due):
    """Mark in ``due`` (n,) the runs that are to latch now; True where there is one."""
    some = False
    for i in range(pose.shape[0]):
        aligned = 1.0 - 2.0 * (pose[i, 3] ** 2 + pose[i, 4] ** 2)  # cosine between the axes
        speed2 = twist[i, 0] ** 2 + twist[i, 1] ** 2 + twist[i, 2] ** 2
        due[i] = not latched[i] and pose[i, 2] >= -limits[i, 0] and aligned >= limits[i, 1] and speed2 <= limits[i, 2] ** 2
        some |= due[i]
    return some
