"""Reconstruction of the force with a contact model: ``F = F_meas + M(x, v) - M(x, v at t - tau)``.

M is the spring and damper of the contact; x and v are the pose and rate that the rig reached, now
and when the force acted. With k and c identified in the loop this is the compensation by identified
parameters of the literature (Qi et al.; F. He et al., Chin. J. Mech. Eng. 35:149, 2022: "the
identified k, c modify the force"); with k and c given it is a Smith predictor whose predicted part
is the contact (O. J. M. Smith, "Closer control of loops with dead time", Chem. Eng. Progress 53,
1957). Until there is an estimate, the force passes the first-order phase lead; with ``lead_rest:
true`` so does the part of it that the Smith predictor's model does not explain.

After capture all six axes push and pull at once, so there is no single line of action along which
to predict. On each axis of the latch's reference point ``F = F_meas + k (x - x') + c (v - v')``
with k and c as identified so far, x and v the pose and twist that the rig reached, now and (primed)
when the measured force acted; torques are about the reference point. An axis without an estimate
passes the first-order phase lead.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field

from hiltestbed.compensation.force_methods.phase_lead import LAG, PhaseLeadBlock, WithLead, lead_of
from hiltestbed.compensation.history import History
from hiltestbed.compensation.interfaces import ForcePath
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.settings import Input
from hiltestbed.compiled.jit import copied, njit
from hiltestbed.config.validation import NotNegative, Positive
from hiltestbed.frames import Array, add_moment
from hiltestbed.identification.held import UNTURNED, referred
from hiltestbed.plugins import register


@register
class Reconstruction(WithLead):
    """The measured force plus the change of an identified spring and damper M over the delay:
    F_meas + M(x, v) - M(x, v at t - delay).

    An axis that has no estimate yet passes the first-order phase lead.
    """

    kind: Literal["reconstruction"] = "reconstruction"
    reads: ClassVar[frozenset[Input]] = frozenset({"wrench", "pose", "twist", "identified"})
    removes_delay: ClassVar[bool] = True

    @classmethod
    def block(cls, own: Sequence[Self], path: ForcePath) -> ReconstructionBlock:
        captured = CapturedContact(path.delay, path.rate) if path.captures else None
        return ReconstructionBlock(lead_of(own, path), path.delay * path.rate, captured)


@register
class SmithPredictor(WithLead):
    """Smith predictor: the measured force plus the change of a given spring and damper along the
    insertion over the delay.
    """

    kind: Literal["smith_predictor"] = "smith_predictor"
    stiffness: Positive = Field(description="Contact stiffness in the predictor [N/m]")
    damping: NotNegative = Field(
        default=0.0, description="Contact damping in the predictor [N s/m]"
    )
    lead_rest: bool = Field(
        default=False,
        description="Whether the part of the force that the predictor does not explain passes the "
        "phase lead",
    )
    reads: ClassVar[frozenset[Input]] = frozenset({"wrench", "pose", "twist"})

    @classmethod
    def block(cls, own: Sequence[Self], path: ForcePath) -> SmithPredictorBlock:
        spring = np.array([(f.stiffness, f.damping) for f in own]).T.copy()
        lead = lead_of(own, path) if own[0].lead_rest else None
        return SmithPredictorBlock(spring, path.delay * path.rate, lead)

    def removed(self, delay: float, stiffness: float) -> float:
        return delay * self.stiffness / stiffness


class ReconstructionBlock:
    """M with k and c as identified so far, on six axes."""

    def __init__(
        self, lead: PhaseLeadBlock, ticks: Array, captured: CapturedContact | None
    ) -> None:
        """``lead``: without an estimate; ticks: (n,) delay; captured: if it captures."""
        n = len(ticks)
        self._lead, self._ticks, self._captured = lead, ticks, captured
        self._states, self._state = History(12, ticks), np.zeros((n, 12))
        self._at_A, self.output = np.zeros((n, 3)), np.zeros((n, 6))

    def compensate(self, measurement: Measurement) -> Array:
        """``(n, 6)`` the reconstructed wrench; an axis without an estimate passes the lead."""
        m, led = measurement, self._lead.compensate(measurement)
        observe(m.pose, m.twist, self._at_A, UNTURNED, self._state)
        self._states.remember(self._state)
        late = self._states.before(self._ticks)
        _reconstruct(m.wrench, led, self._state, late, m.stiffness, m.damping, self.output)
        if self._captured is not None:
            self._captured.take_over(measurement, self.output)
        return self.output


class SmithPredictorBlock:
    """M with a given k and c along the insertion."""

    def __init__(self, spring: Array, ticks: Array, lead: PhaseLeadBlock | None) -> None:
        """``spring``: (2, n) k and c; ticks: (n,) delay; lead: of what is not explained."""
        n, (self._stiffness, self._damping) = len(ticks), spring
        self._ticks, self._lead = ticks, lead
        self._model = History(6, ticks)
        self._now, self._rest, self.output = np.zeros((3, n, 6))

    def compensate(self, measurement: Measurement) -> Array:
        """``(n, 6)`` the model's force now, plus the measured less the model's one delay ago."""
        _spring(measurement.pose, measurement.twist, self._stiffness, self._damping, self._now)
        self._model.remember(self._now)
        np.subtract(measurement.wrench, self._model.before(self._ticks), out=self._rest)
        rest = self._rest if self._lead is None else self._lead.lead_wrench(self._rest)
        np.add(self._now, rest, out=self.output)
        return self.output


@njit(cache=True)
def _reconstruct(wrench, led, now, late, stiffness, damping, out):
    """Along z the spring only pushes, beyond the touch; other axes act while fz is positive."""
    for i in range(wrench.shape[0]):
        pressing = wrench[i, 2] > 0.0
        for j in range(6):
            k, c = stiffness[i, j], damping[i, j]
            if np.isnan(k) or (not pressing and j != 2):
                out[i, j] = led[i, j]
                continue
            if j == 2:
                force = max(0.0, k * now[i, 2] + c * now[i, 8]) if now[i, 2] > 0.0 else 0.0
                force -= max(0.0, k * late[i, 2] + c * late[i, 8]) if late[i, 2] > 0.0 else 0.0
            else:
                force = k * (now[i, j] - late[i, j]) + c * (now[i, 6 + j] - late[i, 6 + j])
            out[i, j] = wrench[i, j] + force


@njit(cache=True)
def _spring(pose, twist, stiffness, damping, out):
    """The wrench at P's origin of a spring and damper at A along z, beyond the touch."""
    for i in range(pose.shape[0]):
        x, v = pose[i, 2], twist[i, 2]
        force = max(0.0, stiffness[i] * x + damping[i] * v) if x > 0.0 else 0.0
        for j in range(6):
            out[i, j] = 0.0
        out[i, 2] = force
        out[i, 3] = pose[i, 1] * force
        out[i, 4] = -pose[i, 0] * force


class CapturedContact:
    """The wrench of ``n`` captured pairs."""

    def __init__(self, delay: Array, rate: float) -> None:
        """``delay``: (n,) of the force [s]; ``rate``: [Hz]."""
        n = len(delay)
        self._lead = PhaseLeadBlock(rate, [(d + LAG, LAG) for d in delay])
        self._ticks = delay * rate
        self._states, self._state = History(12, self._ticks), np.zeros((n, 12))

    def take_over(self, measurement: Measurement, wrench: Array) -> None:
        """Replace the rows of ``wrench`` ``(n, 6)`` of the captured runs; call at every tick."""
        m, led = measurement, self._lead.compensate(measurement)
        observe(m.pose, m.twist, m.lever, UNTURNED, self._state)
        self._states.remember(self._state)
        late = self._states.before(self._ticks)
        _reconstruct_held(
            m.captured, m.wrench, led, self._state, late, m.stiffness, m.damping, wrench
        )


@njit(cache=True)
def observe(pose, twist, lever, reference, out):
    """``out`` (n, 12): position, rotation vector and twist of the point at ``lever`` from A."""
    for i in range(pose.shape[0]):
        referred(pose[i], twist[i], lever[i], reference, out[i, 0:6], out[i, 6:12])


@njit(cache=True)
def _reconstruct_held(captured, measured, led, now, late, stiffness, damping, wrench):
    felt, ahead = np.empty(6), np.empty(6)
    for i in range(captured.shape[0]):
        if captured[i]:
            copied(measured[i], felt)
            copied(led[i], ahead)
            add_moment(-1.0, late[i], felt)
            add_moment(-1.0, now[i], ahead)
            for j in range(6):
                k, c = stiffness[i, j], damping[i, j]
                change = k * (now[i, j] - late[i, j]) + c * (now[i, 6 + j] - late[i, 6 + j])
                wrench[i, j] = ahead[j] if np.isnan(k) else felt[j] + change
            add_moment(1.0, now[i], wrench[i])
