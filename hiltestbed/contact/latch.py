"""The condition for the latches of a probe in its cone to close."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.contact.engagement import Engagement
from hiltestbed.frames import Array

if TYPE_CHECKING:
    from hiltestbed.scenario.like import ScenarioLike as Scenario


def latch_limits(scenarios: Sequence[Scenario]) -> Array:
    """``(n, 3)`` limits at which latches close: depth [m] (pz >= -depth), least cosine between the
    axes, highest speed [m/s]; without a latch they are never met.
    """
    latches = [s.mechanism.latch for s in scenarios]
    never = (-np.inf, 2.0, 0.0)
    return np.array(
        [(la.depth, np.cos(np.radians(la.angle_deg)), la.speed) if la else never for la in latches]
    )


class LatchCondition:
    """The closing conditions of `n` runs: depth, alignment and speed, all at once."""

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        self._limits = latch_limits(scenarios)
        self._closing = np.zeros(len(scenarios), dtype=bool)
        self._due = Call(_due, GIVEN, GIVEN, self._limits, GIVEN, self._closing)

    def close(self, engagement: Engagement) -> None:
        """Latch the runs whose condition holds at the state of the last update."""
        if self._due.on(*engagement.relative(), engagement.latched)():
            engagement.capture(self._closing)


@njit(cache=True)
def closes(pose, twist, limits):
    """Whether a latch closes; ``limits`` (3,) as in :func:`latch_limits`."""
    aligned = 1.0 - 2.0 * (pose[3] ** 2 + pose[4] ** 2)  # cosine between the axes
    speed2 = twist[0] ** 2 + twist[1] ** 2 + twist[2] ** 2
    return pose[2] >= -limits[0] and aligned >= limits[1] and speed2 <= limits[2] ** 2


@njit(cache=True)
def _due(pose, twist, limits, latched, due):
    """Mark in ``due`` (n,) the runs that are to latch now; returns whether there is any."""
    some = False
    for i in range(pose.shape[0]):
        due[i] = not latched[i] and closes(pose[i], twist[i], limits[i])
        some |= due[i]
    return some
