"""Identification of stiffness and damping, axis by axis, while the contact lasts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from hiltestbed.compensation.phase_lead import PhaseLead
from hiltestbed.compensation.sections import identification_section
from hiltestbed.frames import Array
from hiltestbed.identification.hunt_crossley import HuntCrossley
from hiltestbed.identification.instrumental import InstrumentVariables
from hiltestbed.identification.kalman import AdaptiveKalman
from hiltestbed.identification.least_squares import RecursiveLeastSquares
from hiltestbed.identification.samples import ContactSamples
from hiltestbed.scenario import Scenario


class Identification(Protocol):
    """An estimator of ``F = k x + c v`` on six axes, for ``n`` runs.

    Attributes:
        stiffness, damping: ``(n, 6)`` running estimates, NaN before the first.
        samples: ``(n, 6)`` number of contact samples used.
        source: what it takes its samples from.
    """

    source: ContactSamples

    stiffness: Array
    damping: Array
    samples: Array

    def update(self, wrench: Array, pose: Array, twist: Array) -> None:
        """Take in what was measured at t_k: wrench ``(n, 6)``, pose ``(n, 7)``, twist ``(n, 6)``."""
        ...

    def buffers(self) -> dict[str, Array]:
        """The arrays that make up the state."""
        ...


def make_identification(scenarios: Sequence[Scenario]) -> Identification | None:
    """The estimator that ``identification`` names, or None; one kind for all runs of a batch."""
    identification = identification_section(scenarios[0])
    match identification.kind:
        case "none":
            return None
        case "rls":
            return RecursiveLeastSquares(scenarios, ContactSamples(scenarios, estimate=identification.delay == "estimate"))
        case "rls_raw":
            return RecursiveLeastSquares(scenarios, ContactSamples(scenarios, aligned=False))
        case "rls_lead":
            constants = [(s.sensor.delay + identification_section(s).lag, identification_section(s).lag) for s in scenarios]
            return RecursiveLeastSquares(scenarios, ContactSamples(scenarios, aligned=False), PhaseLead(scenarios, constants))
        case "kalman":
            return AdaptiveKalman(scenarios)
        case "hunt_crossley":
            return HuntCrossley(scenarios)
        case "instrumental":
            return InstrumentVariables(scenarios)
        case kind:
            raise ValueError(f"identification.kind {kind!r} has no estimator")
