"""Compensation after capture: all six axes push and pull at once, so there is no single line of
action along which to predict.

On each axis of the latch's reference point ``F = F_meas + k (x - x') + c (v - v')`` with k and c as
identified so far, x and v the pose and twist that the rig reached, now and (primed) when the
measured force acted; torques are about the reference point. An axis without an estimate passes the
first-order phase lead. A linear, identified contact is reconstructed exactly, and the instant of
touch is not needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hiltestbed.compensation.force_methods.phase_lead import LAG, PhaseLeadBlock
from hiltestbed.compensation.history import History
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array
from hiltestbed.identification.held import UNTURNED, add_moment, referred

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario


class CapturedContact:
    """The wrench of ``n`` captured pairs."""

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        n = len(scenarios)
        self._lead = PhaseLeadBlock(scenarios, [(s.sensor.delay + LAG, LAG) for s in scenarios])
        self._ticks = np.array([s.sensor.delay * s.rate for s in scenarios])
        self._states = History(12, self._ticks)
        self._state, self._late = np.zeros((n, 12)), np.zeros((n, 12))

    def take_over(self, measurement: Measurement, wrench: Array) -> None:
        """Replace the rows of ``wrench`` ``(n, 6)`` of the captured runs; call at every tick."""
        led = self._lead.compensate(measurement)
        m = measurement
        observe(m.pose, m.twist, m.lever, UNTURNED, self._state)
        self._states.remember(self._state)
        self._states.before(self._ticks, self._late)
        _reconstruct(
            m.captured, m.wrench, led, self._state, self._late, m.stiffness, m.damping, wrench
        )


@njit(cache=True)
def observe(pose, twist, lever, reference, out):
    """``out`` (n, 12): position, rotation vector from ``reference`` (4,) and twist of the point at
    ``lever`` (n, 3) from A, for ``pose`` (n, 7) and ``twist`` (n, 6) of A.
    """
    for i in range(pose.shape[0]):
        referred(pose[i], twist[i], lever[i], reference, out[i, 0:6], out[i, 6:12])


@njit(cache=True)
def _reconstruct(captured, measured, led, now, late, stiffness, damping, wrench):
    felt, ahead = np.empty(6), np.empty(6)
    for i in range(captured.shape[0]):
        if captured[i]:
            felt[:], ahead[:] = measured[i], led[i]
            add_moment(-1.0, late[i], felt)
            add_moment(-1.0, now[i], ahead)
            for j in range(6):
                k, c = stiffness[i, j], damping[i, j]
                change = k * (now[i, j] - late[i, j]) + c * (now[i, 6 + j] - late[i, 6 + j])
                wrench[i, j] = ahead[j] if np.isnan(k) else felt[j] + change
            add_moment(1.0, now[i], wrench[i])
