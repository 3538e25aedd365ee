"""Compliant contact: the platform yields along the insertion so that the contact force stays under a limit.

An admittance in series with the contact, a damper ``d = T k`` that gives way under what the force has above the limit:

    ddelta/dt = -(F - F_limit)/(T k),   delta <= 0,   F = k (x + delta - x0) + c v

F is not the measured force, which is late, but that of the contact as identified, at the pose that is commanded; the rise that comes
within T is anticipated. The numerical model is not told: a drive that corrects the force for where the platform is (resynchronised
prediction, contact correction) still gets the force of the unlimited contact, any other the limited one. Until k is identified
nothing yields (N. Hogan, "Impedance control", ASME J. Dyn. Syst. Meas. Control 107, 1985, for the admittance).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from hiltestbed.compensation.measurement import Measurement
from hiltestbed.frames import Array
from hiltestbed.scenario import Scenario

AXIAL = 2


class Admittance:
    """The yielding platform, for ``n`` runs.

    Attributes:
        rate: ``(n, 6)`` velocity that it adds to the command.
        offset: ``(n,)`` [m] by which the platform has yielded, <= 0.
    """

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        n = len(scenarios)
        motion = [s.compensation.motion for s in scenarios]
        self._tick = 1.0 / scenarios[0].rate
        self._limit = np.array([m.limit for m in motion])
        self._time = np.array([max(m.time_constant, self._tick) for m in motion])
        self.offset = np.zeros(n)
        self.rate = np.zeros((n, 6))

    def command(self, pose: Array, derivatives: tuple[Array, Array, Array], measurement: Measurement, out: Array) -> None:
        """Write the pose ``out`` (n, 7) to tell the platform."""
        out[:] = pose
        stiffness, damping = measurement.stiffness[:, AXIAL], measurement.damping[:, AXIAL]
        _yield(self._tick, self._limit, self._time, stiffness, damping, derivatives[0], self.offset, self.rate, out)

    def buffers(self) -> dict[str, Array]:
        return {"offset": self.offset, "offset_rate": self.rate}


@njit(cache=True)
def _yield(h, limit, time, stiffness, damping, velocity, offset, rate, out):
    for i in range(out.shape[0]):
        k, before = stiffness[i], offset[i]
        if k > 0.0:
            v = velocity[i, AXIAL]
            force = k * (out[i, AXIAL] + before + max(v, 0.0) * time[i]) + max(damping[i], 0.0) * v
            offset[i] = min(0.0, before - h / time[i] * (force - limit[i]) / k)
        rate[i, AXIAL] = (offset[i] - before) / h
        out[i, AXIAL] += offset[i]
