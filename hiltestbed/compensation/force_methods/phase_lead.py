"""Phase leads of the measured force, of first and second order.

First order: ``G_c(s) = (T1 s + 1)/(T2 s + 1)``: the Taylor expansion of ``exp(tau s)`` to first
order, with a pole that makes it causal (C. Qi, F. Gao, X. Zhao, Q. Wang, A. Ren, "Low-order model
based divergence compensation for hardware-in-the-loop simulation of space discrete contact", J.
Intell. Robot. Syst. 2016). Backward differences:

    y_k = (y_(k-1) T2/h + u_k + T1 (u_k - u_(k-1))/h) / (1 + T2/h)

``T1 - T2`` is the delay that it removes at low frequency: ``T1 = delay + T2`` unless ``lead`` sets
T1.

Second order: the Taylor expansion to second order,

    G_c(s) = (1 + a1 s + a2 s^2) / (T2 s + 1)^2,   a1 = tau + 2 T2,   a2 = tau^2/2 + 2 tau T2 + T2^2

so that ``G_c exp(-tau s) = 1 + O(s^3)``. The literature prefers the first order, since the second
derivative of a measured force is dominated by noise (ibid.): white noise is amplified by about
``a2/T2^2``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field

from hiltestbed.compensation.interfaces import ForceBlock, ForcePath, KernelBlock
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.settings import BlockMethod
from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.config.validation import NotNegative, Positive
from hiltestbed.frames import Array
from hiltestbed.plugins import register

LAG = 0.0005  # [s] T2 where a method does not set it


class WithLead(BlockMethod):
    """A method that passes the force, or what it does not know better, through a phase lead."""

    lead: NotNegative | None = Field(
        default=None, description="Time constant T1 of the phase lead [s]; null: sensor.delay + lag"
    )
    lag: Positive = Field(default=LAG, description="Time constant T2 of the phase lead's pole [s]")

    def time_constants(self, delay: float) -> tuple[float, float]:
        """T1 and T2 [s] for a ``delay`` of the force [s]."""
        return (delay + self.lag if self.lead is None else self.lead), self.lag

    def memory(self) -> float:
        return self.lag


@register
class PhaseLead(WithLead):
    """First-order phase lead of the measured wrench, (T1 s + 1)/(T2 s + 1)."""

    kind: Literal["phase_lead"] = "phase_lead"

    @classmethod
    def block(cls, own: Sequence[Self], path: ForcePath) -> ForceBlock:
        return lead_of(own, path)

    def removed(self, delay: float, stiffness: float) -> float:
        return self.time_constants(delay)[0] - self.lag


class PhaseLeadBlock:
    """The lead on all six components of the wrench, for ``n`` runs."""

    def __init__(self, rate: float, time_constants: Sequence[tuple[float, float]]) -> None:
        """``rate``: [Hz]. time_constants: T1 and T2 [s] of each run."""
        n = len(time_constants)
        self.lead = np.array([lead for lead, _ in time_constants])
        self.lag = np.array([lag for _, lag in time_constants])
        self.output = np.zeros((n, 6))
        self._previous = np.zeros((n, 6))
        self._lead = Call(
            _lead, GIVEN, self.lead, self.lag, 1.0 / rate, self._previous, self.output
        )

    def compensate(self, measurement: Measurement) -> Array:
        """``(n, 6)`` the wrench led by ``T1 - T2``."""
        return self.lead_wrench(measurement.wrench)

    def lead_wrench(self, wrench: Array) -> Array:
        """``(n, 6)`` a wrench ``(n, 6)`` led by ``T1 - T2``."""
        self._lead.on(wrench)()
        return self.output


def lead_of(own: Sequence[WithLead], path: ForcePath) -> PhaseLeadBlock:
    """The lead of the methods ``own``."""
    pairs = zip(own, path.delay, strict=True)
    return PhaseLeadBlock(path.rate, [force.time_constants(delay) for force, delay in pairs])


@njit(cache=True)
def _lead(u, lead, lag, h, previous, y):
    for i in range(u.shape[0]):
        a, b = lag[i] / h, lead[i] / h
        for j in range(6):
            y[i, j] = (y[i, j] * a + u[i, j] + b * (u[i, j] - previous[i, j])) / (1.0 + a)
            previous[i, j] = u[i, j]


@register
class SecondOrderLead(BlockMethod):
    """Second-order phase lead of the measured wrench: the second-order Taylor expansion of
    exp(delay s), over (T2 s + 1)^2.
    """

    kind: Literal["second_order_lead"] = "second_order_lead"
    lag: Positive = Field(default=LAG, description="Time constant T2 of the lead's double pole [s]")
    removes_delay: ClassVar[bool] = True

    @classmethod
    def block(cls, own: Sequence[Self], path: ForcePath) -> ForceBlock:
        h, delay = 1.0 / path.rate, path.delay
        lag = np.array([force.lag for force in own])
        first, second = delay + 2.0 * lag, 0.5 * delay**2 + 2.0 * delay * lag + lag**2
        a, b, c = lag / h, first / h, second / h**2
        up = np.stack([1.0 + b + c, -b - 2.0 * c, c], axis=1)
        down = np.stack([1.0 + 2.0 * lag / h + a**2, -2.0 * lag / h - 2.0 * a**2, a**2], axis=1)
        # the last two inputs, the last two outputs
        return KernelBlock(_lead_twice, ("wrench",), up, down, np.zeros((len(own), 6, 4)))

    def memory(self) -> float:
        return self.lag


@njit(cache=True)
def _lead_twice(u, up, down, memory, y):
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
