"""Passivity: damping is injected when the contact would return more energy than it took.

:class:`PassivityControlBlock` is the time-domain observer and controller (B. Hannaford, J.-H. Ryu,
"Time-domain passivity control of haptic interfaces", IEEE T-RA 18, 2002; for contact on such rigs
M. De Stefano, J. Artigas, C. Secchi et al., EPOS and OOS-SIM, T-RO 2020): ``E_k = sum of h F_used .
v``, the energy that the simulated contact has taken from the relative motion, must not be negative;
when it is, ``alpha = -E/(h v^2)`` makes it zero. This is a safety net: it acts only once there is
excess energy, and any restitution up to 1 passes, correct or not.

:class:`NormalisedPassivityBlock` acts before that (C. Insam, L. D. H. Peiris, D. J. Rixen,
"Normalized passivity control for hardware-in- the-loop with contact", Int. J. Dynamics and Control
9, 2021): the power that the transfer system generates, divided by the magnitude of its signals and
smoothed, sets a damping force. The transfer system here is the sensor's delay, whose power to first
order is ``(F(t) - F_meas) v ~ tau F_meas' v``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field

from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.settings import ForceMethod, Input, force_of
from hiltestbed.compiled.jit import njit
from hiltestbed.config.validation import NotNegative, Positive
from hiltestbed.frames import Array
from hiltestbed.numerical_model.model import NumericalModel
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.numerical_model.model import NumericalModel
    from hiltestbed.scenario import Scenario

DAMPING_LIMIT = 0.5  # times the damping that would reverse the velocity within one tick


@register
class PassivityControl(ForceMethod):
    """Time-domain passivity observer and controller: damping is injected once the contact has
    returned more energy than it took.
    """

    kind: Literal["passivity_control"] = "passivity_control"
    adds_force: ClassVar[bool] = True
    reads: ClassVar[frozenset[Input]] = frozenset({"wrench", "model"})

    @classmethod
    def start(cls, scenarios: Sequence[Scenario], model: NumericalModel) -> PassivityControlBlock:
        return PassivityControlBlock(scenarios, model)


@register
class NormalisedPassivity(ForceMethod):
    """Normalised passivity control: a damping force proportional to the normalised power that the
    delay generates.
    """

    kind: Literal["normalised_passivity"] = "normalised_passivity"
    adds_force: ClassVar[bool] = True
    gain: NotNegative = Field(
        default=1.0,
        description="Gain of the damping force [-]; 1 balances the delay to first order",
    )
    smoothing: Positive = Field(
        default=0.005, description="Time constant of the low-pass on the power [s]"
    )
    reads: ClassVar[frozenset[Input]] = frozenset({"wrench", "pose", "model"})
    removes_delay: ClassVar[bool] = True

    @classmethod
    def start(
        cls, scenarios: Sequence[Scenario], model: NumericalModel
    ) -> NormalisedPassivityBlock:
        return NormalisedPassivityBlock(scenarios, model)


class PassivityControlBlock:
    """Passivity observer and controller on the relative translation, for ``n`` runs.

    Attributes:
        energy: ``(n,)`` [J] taken from the relative motion so far, including the injected damping.
    """

    def __init__(self, scenarios: Sequence[Scenario], model: NumericalModel) -> None:
        n = len(scenarios)
        self._model = model
        self._tick = model.tick
        self._limit = DAMPING_LIMIT / (model.tick * (1.0 / model.mass).sum(axis=1))
        self.energy = np.zeros(n)
        self.output = np.zeros((n, 6))

    def compensate(self, measurement: Measurement) -> Array:
        """``(n, 6)`` the measured wrench plus the injected damping force."""
        _observe_and_control(
            measurement.wrench, self._model.twist, self._tick, self._limit, self.energy, self.output
        )
        return self.output


class NormalisedPassivityBlock:
    """A damping force along the insertion from the delay's normalised power, for ``n`` runs."""

    def __init__(self, scenarios: Sequence[Scenario], model: NumericalModel) -> None:
        n, h = len(scenarios), model.tick
        force = force_of(scenarios, NormalisedPassivity)
        self._model = model
        self._gain = np.array([f.gain for f in force])
        self._smooth = np.array([1.0 - math.exp(-h / f.smoothing) for f in force])
        self._per_tick = np.array([s.sensor.delay for s in scenarios]) / h
        # last force, its smoothed derivative times the delay, smoothed power, smoothed |F v|
        self._memory = np.zeros((n, 4))
        self.output = np.zeros((n, 6))

    def compensate(self, measurement: Measurement) -> Array:
        """``(n, 6)`` the measured wrench plus the damping force."""
        _normalise(
            measurement.wrench,
            measurement.pose,
            self._model.twist,
            self._gain,
            self._smooth,
            self._per_tick,
            self._memory,
            self.output,
        )
        return self.output


@njit(cache=True)
def _observe_and_control(wrench, twist, h, limit, energy, out):
    for i in range(wrench.shape[0]):
        speed = twist[i, 0] ** 2 + twist[i, 1] ** 2 + twist[i, 2] ** 2
        for j in range(6):
            out[i, j] = wrench[i, j]
            energy[i] += h * wrench[i, j] * twist[i, j]
        if energy[i] < 0.0 and speed > 0.0:
            alpha = min(-energy[i] / (h * speed), limit[i])
            for j in range(3):
                out[i, j] += alpha * twist[i, j]
            energy[i] += h * alpha * speed


@njit(cache=True)
def _normalise(wrench, pose, twist, gain, smooth, delay, memory, out):
    for i in range(wrench.shape[0]):
        m = memory[i]
        force, v = wrench[i, 2], twist[i, 2]
        m[1] += smooth[i] * (delay[i] * (force - m[0]) - m[1])
        m[0] = force
        m[2] += smooth[i] * (m[1] * v - m[2])
        m[3] += smooth[i] * (abs(force * v) - m[3])
        ratio = min(max(m[2] / m[3], 0.0), 1.0) if m[3] > 0.0 else 0.0
        extra = gain[i] * ratio * abs(force) * (1.0 if v > 0.0 else -1.0)
        for j in range(6):
            out[i, j] = wrench[i, j]
        out[i, 2] += extra
        out[i, 3] += pose[i, 1] * extra
        out[i, 4] -= pose[i, 0] * extra
