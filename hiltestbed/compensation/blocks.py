"""What stands between the measured wrench and the commanded motion of the rig: the drive of a
method that corrects the force (:mod:`hiltestbed.compensation.interfaces`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiltestbed.compensation.interfaces import ForceBlock
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.motion_methods.contact_correction import Gate, correct_for_platform
from hiltestbed.errors import InputError
from hiltestbed.frames import Array
from hiltestbed.plugins import calling, is_users

if TYPE_CHECKING:
    from hiltestbed.numerical_model.model import NumericalModel


class ForceDrive:
    """Corrects the wrench, drives the numerical model with it and commands the model's motion."""

    def __init__(self, model: NumericalModel, method: ForceBlock, gate: Gate | None = None) -> None:
        """``gate``: where the force is corrected for the platform's error; None: nowhere."""
        self.model = model
        self.method = method
        self._gate = gate
        self.pose = model.pose
        self.twist = model.twist
        self.wrench = np.zeros_like(model.twist)
        self._foreign = is_users(type(method))

    def _looked_at(self, measurement: Measurement) -> Array:
        """``(n, 6)`` the output of a user's method. Raises InputError unless it is finite, or
        raises.
        """
        name = f"compensation.force: {type(self.method).__name__}.compensate"
        with calling(type(self.method), name):
            given = self.method.compensate(measurement)
        if getattr(given, "shape", None) != self.wrench.shape:
            what = (
                f"an array {given.shape}" if isinstance(given, np.ndarray) else type(given).__name__
            )
            raise InputError(
                f"{name}: gave {what}; allowed is an array {self.wrench.shape}, one wrench per "
                f"run; return that"
            )
        if (
            not np.isfinite(given).all()
            and np.isfinite(measurement.wrench).all()
            and np.isfinite(self.pose).all()
        ):
            raise InputError(
                f"{name}: gave NaN or infinity for readings that are finite; look for 0/0 in it"
            )
        return given

    def advance(self, measurement: Measurement) -> None:
        self.wrench[:] = (
            self._looked_at(measurement) if self._foreign else self.method.compensate(measurement)
        )
        if self._gate is not None:
            correct_for_platform(measurement, self.pose, self.twist, self._gate, self.wrench)
        self.model.advance(self.wrench)
