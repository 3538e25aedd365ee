"""Admittance: the platform yields along the insertion so that the contact force stays below a
limit.

The admittance is that of a preloaded slider in series with the contact: it stays at its stop until
the force reaches the limit, then yields so that the force stays there (N. Hogan, "Impedance
control", ASME J. Dyn. Syst. Meas. Control 107, 1985, for the admittance). With the identified
spring and damper of the contact, at the commanded pose, the yield delta <= 0 of a tick h follows
from

    k (x + delta) + c (v + (delta - delta_before)/h) = F_limit

F is not the measured force, which is delayed. The platform does not yield until k is identified.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field

from hiltestbed.compensation.interfaces import Derivatives
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.settings import Input, MotionMethod
from hiltestbed.compiled.jit import njit
from hiltestbed.config.validation import Positive
from hiltestbed.contact.active_ring import AXIAL
from hiltestbed.frames import Array
from hiltestbed.plugins import register

AIM = 0.95  # of the limit: the margin covers the error of the identified k


@register
class Admittance(MotionMethod):
    """Admittance: feed-forward, and the platform yields along the insertion so that the contact
    force stays below a limit.
    """

    kind: Literal["admittance"] = "admittance"
    limit: Positive = Field(description="Contact force at which the platform begins to yield [N]")
    speed: Positive = Field(
        default=0.1, description="Highest speed at which the platform yields [m/s]"
    )
    reads: ClassVar[frozenset[Input]] = frozenset({"identified"})
    feeds: ClassVar[bool] = True

    @classmethod
    def block(cls, own: Sequence[Self], rate: float) -> AdmittanceBlock:
        limits, speeds = np.array([m.limit for m in own]), np.array([m.speed for m in own])
        return AdmittanceBlock(1.0 / rate, limits, speeds)


class AdmittanceBlock:
    """The yielding platform, for ``n`` runs.

    Attributes:
        rate: ``(n, 6)`` velocity that it adds to the command.
        offset: ``(n,)`` [m] by which the platform has yielded, <= 0.
    """

    def __init__(self, tick: float, limit: Array, speed: Array) -> None:
        """``tick``: [s]. limit: (n,) [N] where it yields. speed: (n,) [m/s] at most."""
        n = len(limit)
        self._tick, self._limit, self._speed = tick, limit, speed
        self.offset = np.zeros(n)
        self.rate = np.zeros((n, 6))

    def command(
        self, pose: Array, derivatives: Derivatives, measurement: Measurement, out: Array
    ) -> None:
        """Write to ``out`` (n, 7) the pose commanded to the platform."""
        out[:] = pose
        stiffness, damping = measurement.stiffness[:, AXIAL], measurement.damping[:, AXIAL]
        _yield(
            self._tick,
            self._limit,
            self._speed,
            stiffness,
            damping,
            derivatives[0],
            self.offset,
            self.rate,
            out,
        )


@njit(cache=True)
def _yield(h, limit, speed, stiffness, damping, velocity, offset, rate, out):
    for i in range(out.shape[0]):
        k, before = stiffness[i], offset[i]
        if k > 0.0:
            c = max(damping[i], 0.0)
            held = (AIM * limit[i] - k * out[i, AXIAL] - c * (velocity[i, AXIAL] - before / h)) / (
                k + c / h
            )
            offset[i] = min(0.0, before + min(max(held - before, -speed[i] * h), speed[i] * h))
        rate[i, AXIAL] = (offset[i] - before) / h
        out[i, AXIAL] += offset[i]
