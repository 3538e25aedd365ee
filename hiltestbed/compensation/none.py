"""No compensation: the numerical model is driven with the wrench as measured."""

from __future__ import annotations

from hiltestbed.compensation.measurement import Measurement
from hiltestbed.frames import Array


class Uncompensated:
    """Hands the measured wrench on."""

    def compensate(self, measurement: Measurement) -> Array:
        """``(n, 6)`` the measured wrench itself."""
        return measurement.wrench

    def buffers(self) -> dict[str, Array]:
        return {}
