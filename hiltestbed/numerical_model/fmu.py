"""The numerical model as the user's FMU: stepped once per tick by FMPy, with one instance per
run.
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hiltestbed.devices.cosimulation import POSE, TWIST, WRENCH, CoSimulation
from hiltestbed.devices.interface import UNIT_LENGTH, DeviceError
from hiltestbed.errors import InputError
from hiltestbed.frames import Array, twist_between
from hiltestbed.numerical_model.model import NumericalModel

if TYPE_CHECKING:
    from hiltestbed.scenario.like import ScenarioLike

# [m], [rad], [m/s], [rad/s] largest difference between the FMU's start and that of the approach
APART = 1e-6


class FmuModel(NumericalModel):
    """A :class:`NumericalModel` whose motion is the FMU's; its bodies are the nominal ones."""

    def __init__(self, scenarios: Sequence[ScenarioLike], files: Sequence[Path]) -> None:
        """``files``: the FMU of each run. Raises MissingExtra, DeviceError; InputError if the FMU
        lacks a variable or does not start at ``approach``.
        """
        super().__init__(scenarios)
        inputs = [f"wrench.{name}" for name in WRENCH]
        outputs = [*(f"pose.{name}" for name in POSE), *(f"twist.{name}" for name in TWIST)]
        self._parts: list[CoSimulation] = []
        for file in files:
            part = CoSimulation(file, inputs, outputs)
            part.open()
            weakref.finalize(self, part.close)
            self._parts.append(part)
        apart = np.empty(6)
        for i, part in enumerate(self._parts):
            values = part.outputs()
            twist_between(self.pose[i], values[:7], 1.0, apart)
            if np.abs(apart).max() > APART or np.abs(values[7:] - self.twist[i]).max() > APART:
                raise InputError(
                    f"numerical_model.file: {part.path} starts elsewhere than approach says (pose "
                    f"{values[:7].round(6).tolist()}, twist "
                    f"{values[7:].round(6).tolist()}; approach: {self.pose[i].round(6).tolist()}, "
                    f"{self.twist[i].round(6).tolist()}); "
                    "give both the same start"
                )

    def advance(self, wrench: Array) -> None:
        for i, part in enumerate(self._parts):
            if i in self.ended:
                continue
            values = part.step(wrench[i], self.tick)
            if not abs(math.hypot(*values[3:7]) - 1.0) <= UNIT_LENGTH:
                given = ", ".join(f"{value:.4g}" for value in values[3:7])
                raise DeviceError(
                    f"{part.path}: pose.qx ... qw is no rotation at t = {part.time:.6f} s (got "
                    f"{given}); allowed are quaternions of length 1"
                )
            self.pose[i], self.twist[i] = values[:7], values[7:]
            if part.ended is not None:
                self.ended[i] = (
                    f"{part.path} has ended the simulation at t = {part.ended:.6f} s "
                    f"(terminateSimulation)"
                )
