"""The delay ledger: every delay in the loop, and the damping that it takes out of the contact.

A delay tau of the force acts on a contact of stiffness k as a damping -k tau, since ``F(t - tau) ~ F - tau k v``; one bounce of two
free bodies of reduced mass mu then has ``ln e = -pi c_eff/(2 sqrt(k mu))``, hence ``ln(e/e_ref) = (pi/2) w sum(tau)`` with
``w = sqrt(k/mu)``. Good to 0.01 in ln e while w tau <= 0.25.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from hiltestbed.compensation.phase_lead import lead_and_lag
from hiltestbed.metrics import ContactFigures
from hiltestbed.scenario import Scenario
from hiltestbed.spacecraft import effective_mass


@dataclass(frozen=True)
class Delay:
    """One entry: where from, how late [s], and the damping that this is worth [N s/m]."""

    source: str
    delay: float
    equivalent_damping: float


def delay_ledger(scenario: Scenario, figures: ContactFigures) -> list[Delay]:
    """Every delay between the contact and the numerical model's motion, leads as negative ones, their sum last."""
    sensor = scenario.sensor
    k = scenario.mechanism.contact.stiffness
    delays = [("sensor.delay", sensor.delay)]
    if sensor.lowpass is not None:
        delays.append(("sensor.lowpass", 1.0 / (2.0 * math.pi * sensor.lowpass)))
    if sensor.time_constant is not None:  # a high-pass leads: phase 1/(w T)
        w = contact_frequency(scenario)
        delays.append(("sensor.time_constant", -1.0 / (w * w * sensor.time_constant)))
    if scenario.compensation.force.kind == "phase_lead":
        lead, lag = lead_and_lag(scenario)
        delays.append(("compensation.phase_lead", lag - lead))
    # Read at t_k, step the model, run linearly to its pose by t_(k+1): the semi-implicit step makes up for the tick.
    delays.append(("coupling", 0.0))
    if scenario.rig.platform.tracking == "servo":
        delays.append(("platform.servo", figures.tracking_delay or 0.0))
    delays.append(("total", sum(delay for _, delay in delays)))
    return [Delay(source, delay, 0.0 - k * delay) for source, delay in delays]


def contact_frequency(scenario: Scenario) -> float:
    """``w = sqrt(k/mu)`` [rad/s] of the contact with both bodies free."""
    return math.sqrt(scenario.mechanism.contact.stiffness / effective_mass(scenario))


def predicted_log_error(scenario: Scenario, ledger: list[Delay]) -> float:
    """What the ledger's sum does to ``ln e``: ``(pi/2) w sum(tau)``."""
    return 0.5 * math.pi * contact_frequency(scenario) * ledger[-1].delay
