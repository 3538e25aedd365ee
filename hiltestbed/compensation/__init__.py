"""Compensation of the delay: between the measured wrench and the motion that the rig is told to make.

A *drive* turns what the rig measured at t_k into the motion that the rig is to reach at t_(k+1). Most methods correct the wrench
and drive the numerical model with it: they are a class with ``compensate(measurement) -> (n, 6)`` behind :class:`ForceDrive`.
A method that drives the model in another way (a second copy of it, a prediction, a correction of the commanded pose) is a drive
of its own with the same five names: ``pose``, ``twist``, ``wrench``, ``advance``, ``buffers``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from hiltestbed.compensation.contact_correction import ContactCorrection
from hiltestbed.compensation.cor_designed import CorDesigned
from hiltestbed.compensation.dead_zone import DeadZone
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.none import Uncompensated
from hiltestbed.compensation.passivity import NormalisedPassivity, PassivityControl
from hiltestbed.compensation.phase_lead import PhaseLead
from hiltestbed.compensation.polynomial import PolynomialExtrapolation
from hiltestbed.compensation.reconstruction import Reconstruction, SmithPredictor
from hiltestbed.compensation.resynchronised import Resynchronised
from hiltestbed.compensation.second_order_lead import SecondOrderLead
from hiltestbed.compensation.virtual_contact import VirtualContact
from hiltestbed.effects.access import effects_of
from hiltestbed.effects.numerical_model import DepartingSpacecraft
from hiltestbed.frames import Array
from hiltestbed.scenario import Scenario
from hiltestbed.spacecraft import Spacecraft


class ForceCompensation(Protocol):
    """A method that corrects the wrench."""

    def compensate(self, measurement: Measurement) -> Array:
        """``(n, 6)`` the wrench to drive the numerical model with."""
        ...

    def buffers(self) -> dict[str, Array]:
        """The arrays that make up the state."""
        ...


class Drive(Protocol):
    """From what was measured at t_k to the motion commanded for t_(k+1).

    Attributes:
        pose: ``(n, 7)`` pose of A in P, commanded.
        twist: ``(n, 6)`` its velocity.
        wrench: ``(n, 6)`` the wrench that explains the numerical model's motion over the tick.
    """

    pose: Array
    twist: Array
    wrench: Array

    def advance(self, measurement: Measurement) -> None:
        """Move on by one tick."""
        ...

    def buffers(self) -> dict[str, Array]:
        """The arrays that make up the state."""
        ...


class ForceDrive:
    """Correct the wrench, drive the numerical model with it, command where it goes."""

    def __init__(self, spacecraft: Spacecraft, method: ForceCompensation, correction: ContactCorrection | None = None) -> None:
        self.spacecraft = spacecraft
        self.method = method
        self.correction = correction
        self.pose = spacecraft.pose
        self.twist = spacecraft.twist
        self.wrench = spacecraft.twist * 0.0

    def advance(self, measurement: Measurement) -> None:
        self.wrench[:] = self.method.compensate(measurement)
        if self.correction:
            self.correction.add(measurement, self.pose, self.twist, self.wrench)
        self.spacecraft.advance(self.wrench)

    def buffers(self) -> dict[str, Array]:
        return {"wrench": self.wrench} | self.spacecraft.buffers() | self.method.buffers()


def make_drive(scenarios: Sequence[Scenario]) -> Drive:
    """The drive that ``compensation`` names; one kind for all runs of a batch."""
    departs = any(effects_of(s, "dynamics") for s in scenarios)
    spacecraft = DepartingSpacecraft(scenarios) if departs else Spacecraft(scenarios)
    if scenarios[0].compensation.force.kind == "resynchronised":
        return Resynchronised(spacecraft, scenarios)
    correction = ContactCorrection() if scenarios[0].compensation.motion.kind == "contact_correction" else None
    return ForceDrive(spacecraft, make_method(scenarios, spacecraft), correction)


def make_method(scenarios: Sequence[Scenario], spacecraft: Spacecraft) -> ForceCompensation:
    """The method that corrects the wrench."""
    match scenarios[0].compensation.force.kind:
        case "none":
            return Uncompensated()
        case "phase_lead":
            return PhaseLead(scenarios)
        case "second_order_lead":
            return SecondOrderLead(scenarios)
        case "polynomial":
            return PolynomialExtrapolation(scenarios)
        case "reconstruction":
            return Reconstruction(scenarios)
        case "smith_predictor":
            return SmithPredictor(scenarios)
        case "virtual_contact":
            return VirtualContact(scenarios)
        case "cor_designed":
            return CorDesigned(scenarios)
        case "dead_zone":
            return DeadZone(scenarios)
        case "passivity_control":
            return PassivityControl(scenarios, spacecraft)
        case "normalised_passivity":
            return NormalisedPassivity(scenarios, spacecraft)
        case kind:
            raise ValueError(f"compensation.force.kind {kind!r} has no method")
