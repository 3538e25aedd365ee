"""The last check of a pose before it is sent: finite, and within the limits of position, speed and
acceleration.
"""

from __future__ import annotations

import math

import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.devices.section import MotionLimits
from hiltestbed.frames import Array, rotation_vector, twist_between

_SAID = (
    ("position", "A is commanded {value:.4g} m from the nominal touch", "m"),
    ("angle_deg", "A is commanded to turn by {value:.4g} deg", "deg"),
    ("speed", "A is commanded to move at {value:.4g} m/s", "m/s"),
    ("rate_deg", "A is commanded to turn at {value:.4g} deg/s", "deg/s"),
    ("acceleration", "A is commanded to accelerate at {value:.4g} m/s^2", "m/s^2"),
)


class Guard:
    """Checks each commanded pose (7,) of A in P against the limits, one per ``tick`` [s]."""

    def __init__(self, limits: MotionLimits, tick: float) -> None:
        self._tick = tick
        given = [getattr(limits, name) for name, *_ in _SAID]
        self._limits = np.array([math.inf if limit is None else limit for limit in given])
        self._quantities = np.zeros(len(_SAID))
        self._before, self._twist = np.zeros(7), np.zeros(6)
        self.start(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))
        self.refusal(self._before)  # compile now, not in the first cycle

    def start(self, pose: Array) -> None:
        """Start from rest at ``pose`` (7,)."""
        self._before[:], self._twist[:] = pose, 0.0

    def refusal(self, pose: Array) -> str | None:
        """Why ``pose`` (7,) must not be sent; None if it may be, and it then counts as sent."""
        if _within(pose, self._before, self._twist, self._tick, self._limits, self._quantities):
            return None
        if not np.isfinite(pose).all():
            return f"a pose that is not finite was commanded ({pose})"
        i = int(np.argmax(self._quantities > self._limits))
        name, text, unit = _SAID[i]
        return (
            f"{text.format(value=self._quantities[i])}; devices.limits.{name} is "
            f"{self._limits[i]:g} {unit}"
        )


@njit(cache=True)
def _within(pose, before, twist, tick, limits, q):
    slope, turn = np.empty(6), np.empty(3)
    twist_between(before, pose, tick, slope)
    rotation_vector(pose[3:7], turn)
    q[0] = max(abs(pose[0]), abs(pose[1]), abs(pose[2]))
    q[1] = math.degrees(math.sqrt(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2))
    q[2] = math.sqrt(slope[0] ** 2 + slope[1] ** 2 + slope[2] ** 2)
    q[3] = math.degrees(math.sqrt(slope[3] ** 2 + slope[4] ** 2 + slope[5] ** 2))
    q[4] = (
        math.sqrt(
            (slope[0] - twist[0]) ** 2 + (slope[1] - twist[1]) ** 2 + (slope[2] - twist[2]) ** 2
        )
        / tick
    )
    for i in range(q.shape[0]):
        if not q[i] <= limits[i]:  # true for NaN as well
            return False
    before[:] = pose
    twist[:] = slope
    return True
