"""Second-order phase lead: the Taylor expansion of ``exp(tau s)`` to second order.

    G_c(s) = (1 + a1 s + a2 s^2) / (T2 s + 1)^2,   a1 = tau + 2 T2,   a2 = tau^2/2 + 2 tau T2 + T2^2

so that ``G_c exp(-tau s) = 1 + O(s^3)``. The literature prefers the first order, since the second
derivative of a measured force is dominated by noise (C. Qi et al., J. Intell. Robot. Syst. 2016):
white noise is amplified by about ``a2/T2^2``. Backward differences, as in the first-order lead.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field

from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.settings import ForceMethod, Input, force_of
from hiltestbed.compiled.jit import njit
from hiltestbed.config.validation import Positive
from hiltestbed.frames import Array
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.numerical_model.model import NumericalModel
    from hiltestbed.scenario import Scenario


@register
class SecondOrderLead(ForceMethod):
    """Second-order phase lead of the measured wrench: the second-order Taylor expansion of
    exp(delay s), over (T2 s + 1)^2.
    """

    kind: Literal["second_order_lead"] = "second_order_lead"
    lag: Positive = Field(
        default=0.0005, description="Time constant T2 of the lead's double pole [s]"
    )
    reads: ClassVar[frozenset[Input]] = frozenset({"wrench"})
    removes_delay: ClassVar[bool] = True

    @classmethod
    def start(cls, scenarios: Sequence[Scenario], model: NumericalModel) -> SecondOrderLeadBlock:
        return SecondOrderLeadBlock(scenarios)

    def memory(self) -> float:
        return self.lag


class SecondOrderLeadBlock:
    """The lead on all six components of the wrench, for ``n`` runs."""

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        n, h = len(scenarios), 1.0 / scenarios[0].rate
        delay = np.array([s.sensor.delay for s in scenarios])
        lag = np.array([force.lag for force in force_of(scenarios, SecondOrderLead)])
        first, second = delay + 2.0 * lag, 0.5 * delay**2 + 2.0 * delay * lag + lag**2
        self._up = np.stack(
            [1.0 + first / h + second / h**2, -first / h - 2.0 * second / h**2, second / h**2],
            axis=1,
        )
        self._down = np.stack(
            [
                1.0 + 2.0 * lag / h + (lag / h) ** 2,
                -2.0 * lag / h - 2.0 * (lag / h) ** 2,
                (lag / h) ** 2,
            ],
            axis=1,
        )
        self.output = np.zeros((n, 6))
        self._memory = np.zeros((n, 6, 4))  # the last two inputs, the last two outputs

    def compensate(self, measurement: Measurement) -> Array:
        """``(n, 6)`` the wrench led to second order."""
        _lead(measurement.wrench, self._up, self._down, self._memory, self.output)
        return self.output


@njit(cache=True)
def _lead(u, up, down, memory, y):
    for i in range(u.shape[0]):
        for j in range(6):
            m = memory[i, j]
            out = (
                up[i, 0] * u[i, j]
                + up[i, 1] * m[0]
                + up[i, 2] * m[1]
                - down[i, 1] * m[2]
                - down[i, 2] * m[3]
            ) / down[i, 0]
            m[1], m[0] = m[0], u[i, j]
            m[3], m[2] = m[2], out
            y[i, j] = out
