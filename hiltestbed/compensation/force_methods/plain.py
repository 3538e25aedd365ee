"""The measured wrench as it is, or without what is small in it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, Self

import numpy as np
from pydantic import Field

from hiltestbed.compensation.interfaces import ForceBlock, ForcePath, KernelBlock
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.settings import BlockMethod
from hiltestbed.config.validation import NotNegative
from hiltestbed.frames import Array
from hiltestbed.plugins import register


@register
class NoForceCompensation(BlockMethod):
    """No compensation: the measured wrench drives the numerical model unchanged."""

    kind: Literal["none"] = "none"

    @classmethod
    def block(cls, own: Sequence[Self], path: ForcePath) -> ForceBlock:
        return UncompensatedBlock()


class UncompensatedBlock:
    """Passes the measured wrench on."""

    def compensate(self, measurement: Measurement) -> Array:
        """``(n, 6)`` the measured wrench itself."""
        return measurement.wrench


@register
class DeadZone(BlockMethod):
    """A dead zone: a measured force below the width is taken as zero. It does not compensate the
    delay.

    Rigs use it against the velocity drift caused by noise and bias. By itself it distorts the
    response, towards divergence or convergence (Li et al., hybrid Smith predictor with dead-zone
    disturbance observer).
    """

    kind: Literal["dead_zone"] = "dead_zone"
    width: NotNegative = Field(description="Force below which an axis is taken as zero [N]")

    @classmethod
    def block(cls, own: Sequence[Self], path: ForcePath) -> ForceBlock:
        width = np.array([[force.width] for force in own])
        return KernelBlock(_without_small, ("wrench",), width)


def _without_small(wrench: Array, width: Array, out: Array) -> None:
    """The torques pass while any force axis does."""
    outside = np.abs(wrench[:, :3]) > width
    np.multiply(wrench[:, :3], outside, out=out[:, :3])
    np.multiply(wrench[:, 3:], outside.any(axis=1, keepdims=True), out=out[:, 3:])
