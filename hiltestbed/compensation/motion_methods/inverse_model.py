"""Model-based inverse feed-forward of the commanded pose.

    x_c = x + a1 dx/dt + a2 d2x/dt2 + a3 d3x/dt3,   1 + a1 s + a2 s^2 + a3 s^3 = (1 + T s)(1 + 2
    zeta s/w + s^2/w^2) to ``order``

the inverse of a platform with that response (third-order platform and second-order position lead:
C. Qi et al., J. Intell. Robot. Syst. 2016; in real-time hybrid simulation the feed-forward of B. M.
Phillips, B. F. Spencer, J. Eng. Mech. 139, 2013). It differentiates a computed pose, so that sensor
noise enters only through the force that drives the numerical model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from hiltestbed.compensation.interfaces import Derivatives
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.settings import Input, MotionMethod, motion_of
from hiltestbed.compiled.jit import njit
from hiltestbed.config.validation import NotNegative, Positive
from hiltestbed.frames import Array, pose_step
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario


@register
class InverseModel(MotionMethod):
    """Inverse model: the command passes the platform's inverse response (1 + T s)(1 + 2 zeta s/w +
    s^2/w^2), truncated at an order.
    """

    kind: Literal["inverse_model"] = "inverse_model"
    order: Annotated[int, Field(ge=1, le=3)] = Field(
        default=2, description="Order at which the inverse response is truncated"
    )
    bandwidth: Positive = Field(
        default=40.0, description="Bandwidth w/(2 pi) of the platform's response [Hz]"
    )
    damping_ratio: Positive = Field(
        default=1.0, description="Damping ratio zeta of the platform's response [-]"
    )
    time_constant: NotNegative = Field(
        default=0.0,
        description="Time constant T of the platform's response [s], which makes it third-order; "
        "0: second-order",
    )
    reads: ClassVar[frozenset[Input]] = frozenset()

    @classmethod
    def start(cls, scenarios: Sequence[Scenario]) -> InverseModelBlock:
        return InverseModelBlock(scenarios)


class InverseModelBlock:
    """The inverse response on all six axes, for ``n`` runs."""

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        self.rate = None
        self._coefficients = np.array([inverse_coefficients(s) for s in scenarios])

    def command(
        self, pose: Array, derivatives: Derivatives, measurement: Measurement, out: Array
    ) -> None:
        """Write to ``out`` (n, 7) the pose commanded to the platform."""
        _apply(pose, *derivatives, self._coefficients, out)


def inverse_coefficients(scenario: Scenario) -> tuple[float, float, float]:
    """a1 [s], a2 [s^2], a3 [s^3]."""
    (motion,) = motion_of([scenario], InverseModel)
    w, T = 2.0 * math.pi * motion.bandwidth, motion.time_constant
    a, b = 2.0 * motion.damping_ratio / w, 1.0 / w**2
    return T + a, (a * T + b) * (motion.order >= 2), b * T * (motion.order >= 3)


@njit(cache=True)
def _apply(pose, velocity, acceleration, jerk, coefficients, out):
    ahead = np.empty(6)
    for i in range(pose.shape[0]):
        a1, a2, a3 = coefficients[i]
        for j in range(6):
            ahead[j] = a1 * velocity[i, j] + a2 * acceleration[i, j] + a3 * jerk[i, j]
        pose_step(pose[i], ahead, 1.0, out[i])
