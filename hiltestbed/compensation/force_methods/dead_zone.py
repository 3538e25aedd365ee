"""A dead zone, as used on rigs against the velocity drift caused by noise and bias: a force below
the width is taken as zero.

It does not compensate the delay, and by itself distorts the response, towards divergence or
convergence (Li et al., hybrid Smith predictor with dead-zone disturbance observer).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field

from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.settings import ForceMethod, Input, force_of
from hiltestbed.config.validation import NotNegative
from hiltestbed.frames import Array
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.numerical_model.model import NumericalModel
    from hiltestbed.scenario import Scenario


@register
class DeadZone(ForceMethod):
    """A dead zone: a measured force below the width is taken as zero. It does not compensate the
    delay.
    """

    kind: Literal["dead_zone"] = "dead_zone"
    width: NotNegative = Field(description="Force below which an axis is taken as zero [N]")
    reads: ClassVar[frozenset[Input]] = frozenset({"wrench"})

    @classmethod
    def start(cls, scenarios: Sequence[Scenario], model: NumericalModel) -> DeadZoneBlock:
        return DeadZoneBlock(scenarios)


class DeadZoneBlock:
    """The dead zone of each force axis; the torques pass while any force axis does."""

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        self._width = np.array([[force.width] for force in force_of(scenarios, DeadZone)])
        self.output = np.zeros((len(scenarios), 6))

    def compensate(self, measurement: Measurement) -> Array:
        """``(n, 6)`` the wrench with components within the dead zone set to zero."""
        force = measurement.wrench[:, :3]
        outside = np.abs(force) > self._width
        np.multiply(force, outside, out=self.output[:, :3])
        np.multiply(
            measurement.wrench[:, 3:], outside.any(axis=1, keepdims=True), out=self.output[:, 3:]
        )
        return self.output
