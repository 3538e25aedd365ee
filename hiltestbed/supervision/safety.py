"""The rig's safety limits: if one is exceeded, the run stops within the tick.

The monitored quantities are those of a rig's own electronics: the sliders and limbs of the
platform, its tracking error, the sensor's load before any delay (its overload relay is analogue),
and the energy that the rig has created so far, the integral of ``F . v_act - F_used . v_cmd``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array
from hiltestbed.platform.facilities.limbs import slider
from hiltestbed.platform.facilities.pss33 import shipped_limbs
from hiltestbed.scenario.safety import SafetyLimits

if TYPE_CHECKING:
    from hiltestbed.platform.plant import Plant

LIMITS = {  # what is said beyond each, and its unit
    "stroke": ("a slider is {value:.4g} m from home", "m"),
    "speed": ("a slider moves at {value:.4g} m/s", "m/s"),
    "acceleration": ("a slider accelerates at {value:.4g} m/s^2", "m/s^2"),
    "limb_angle_deg": ("a limb leans {value:.4g} deg from its slider", "deg"),
    "tracking_error": ("the platform is {value:.4g} m from its command", "m"),
    "force": ("the sensor carries {value:.4g} N", "N"),
    "torque": ("the sensor carries {value:.4g} N m", "N m"),
    "energy": ("the rig has created {value:.4g} J", "J"),
}


class Safety:
    """The safety limits of ``n`` runs.

    Attributes:
        quantities: ``(n, 8)`` the largest value at this tick of each quantity in :data:`LIMITS`.
    """

    def __init__(self, limits: Sequence[SafetyLimits], tick: float, joints_stated: bool) -> None:
        """``joints_stated``: whether the platform states limits of its joints, which
        :meth:`Plant.joint_limit` checks; sliders and limbs of other platforms are checked here.
        """
        n, self._tick = len(limits), tick
        rows = [[getattr(own, name) for name in LIMITS] for own in limits]
        self._limits = np.array(
            [[math.inf if limit is None else limit for limit in row] for row in rows]
        )
        self._limbs = shipped_limbs()[: 0 if joints_stated else 6]
        self._plant: Plant | None = None
        self.quantities = np.zeros((n, len(LIMITS)))
        self._sliders = np.zeros((n, 2, 6))  # positions and speeds at the previous tick
        self._ticks = np.zeros(n, dtype=np.int64)
        self._watch = Call(
            _watch,
            (self._tick, self._limbs, self._limits),
            *(GIVEN,) * 6,
            (self._ticks, self._sliders, self.quantities),
        )

    def passed(self, plant: Plant, pose_before: Array, energy: Array) -> bool:
        """Whether a run has exceeded a limit at this tick.

        Args:
            plant: at t_k. pose_before: ``(n, 7)`` that had been commanded for this tick. energy:
                ``(n,)`` created so far [J].
        """
        self._plant = plant
        passed = plant.joint_limit_passed()
        look = self._watch.on(
            plant.slider_act, plant.pose_W, plant.pose_act, pose_before, plant.wrench_sub, energy
        )
        return look() or passed

    def reason(self, i: int) -> str | None:
        """The limit that run ``i`` has exceeded, with the value; None if it has exceeded none."""
        for j, (name, (said, unit)) in enumerate(LIMITS.items()):
            value, limit = self.quantities[i, j], self._limits[i, j]
            if value > limit:
                return f"{said.format(value=value)}; safety.{name} is {limit:g} {unit}"
        return self._plant.joint_limit(i) if self._plant is not None else None


@njit(cache=True)
def _watch(rig, sliders, pose_W, pose, pose_before, wrench_sub, energy, state):
    """``rig``: tick [s], limbs, limits (n, 8); ``state``: ticks, sliders before, quantities."""
    h, limbs, limits = rig
    ticks, before, q = state
    passed = False
    arm = np.empty(3)
    for i in range(sliders.shape[0]):
        q[i] = 0.0
        steepest = 1.0  # cosine of the angle between the limb that leans most and its slider
        for j in range(limbs.shape[0]):
            speed = (sliders[i, j] - before[i, 0, j]) / h if ticks[i] > 0 else 0.0
            acceleration = (speed - before[i, 1, j]) / h if ticks[i] > 1 else 0.0
            before[i, 0, j], before[i, 1, j] = sliders[i, j], speed
            q[i, 0] = max(q[i, 0], abs(sliders[i, j]))
            q[i, 1] = max(q[i, 1], abs(speed))
            q[i, 2] = max(q[i, 2], abs(acceleration))
            s = slider(limbs[j], pose_W[i], arm)
            along = 0.0
            for c in range(3):
                along += limbs[j, 3 + c] * (pose_W[i, c] + arm[c] - limbs[j, c])
            steepest = min(steepest, (along - s) / limbs[j, 9])
        q[i, 3] = math.degrees(math.acos(max(steepest, -1.0)))
        error = 0.0
        for c in range(3):
            error += (pose_before[i, c] - pose[i, c]) ** 2
        q[i, 4] = math.sqrt(error)
        for s in range(wrench_sub.shape[1]):
            w = wrench_sub[i, s]
            q[i, 5] = max(q[i, 5], math.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2))
            q[i, 6] = max(q[i, 6], math.sqrt(w[3] ** 2 + w[4] ** 2 + w[5] ** 2))
        q[i, 7] = energy[i]
        ticks[i] += 1
        for c in range(q.shape[1]):
            passed = passed or q[i, c] > limits[i, c]
    return passed
