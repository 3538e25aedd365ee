"""The delay ledger: every delay in the loop, and the damping that it takes out of the contact.

A delay tau of the force acts on a contact of stiffness k as a damping -k tau, since ``F(t - tau) ~ F - tau k v``; one bounce of two
free bodies of reduced mass mu then has ``ln e = -pi c_eff/(2 sqrt(k mu))``, hence ``ln(e/e_ref) = (pi/2) w sum(tau)`` with
``w = sqrt(k/mu)``. Good to 0.01 in ln e while w tau <= 0.25.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from hiltestbed.compensation.phase_lead import lead_and_lag
from hiltestbed.effects.access import effects_of
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
    """Every delay between the contact and the numerical model's motion, what leads as negative, their sum last."""
    # Read at t_k, step the model, run linearly to its pose by t_(k+1): the semi-implicit step makes up for the tick.
    delays = [*_sensor(scenario), *_compensation(scenario), ("coupling", 0.0), *_numerical_model(scenario)]
    if scenario.rig.platform.tracking == "servo":
        delays.append(("platform.servo", figures.tracking_delay or 0.0))
    elif effects_of(scenario, "platform"):
        delays.append(("platform.effects", figures.tracking_delay or 0.0))
    compensation = scenario.compensation
    if compensation.force.kind == "resynchronised" or compensation.motion.kind == "contact_correction":
        # these correct the force for where the platform is
        delays.append(("compensation.platform", -sum(delay for source, delay in delays if source.startswith("platform."))))
    delays.append(("total", sum(delay for _, delay in delays)))
    k = scenario.mechanism.contact.stiffness
    return [Delay(source, delay, 0.0 - k * delay) for source, delay in delays]


def _sensor(scenario: Scenario) -> Iterator[tuple[str, float]]:
    sensor, w = scenario.sensor, contact_frequency(scenario)
    yield "sensor.delay", sensor.delay
    if sensor.lowpass is not None:
        yield "sensor.lowpass", 1.0 / (2.0 * math.pi * sensor.lowpass)
    if sensor.time_constant is not None:  # a high-pass leads: phase 1/(w T)
        yield "sensor.time_constant", -1.0 / (w * w * sensor.time_constant)
    for kind, given in effects_of(scenario, "sensor"):
        match kind:
            case "sensor.delay":
                yield "effects.sensor.delay", given["delay"]
            case "sensor.lag":
                yield "effects.sensor.lag", given["time_constant"]
            case "sensor.highpass":
                yield "effects.sensor.highpass", -1.0 / (w * w * given["time_constant"])


def _compensation(scenario: Scenario) -> Iterator[tuple[str, float]]:
    """What the method takes out at low frequency, once it knows the contact that it needs to know."""
    sensor, force = scenario.sensor, scenario.compensation.force
    match force.kind:
        case "phase_lead":
            lead, lag = lead_and_lag(scenario)
            yield "compensation.phase_lead", lag - lead
        case "second_order_lead" | "polynomial" | "reconstruction" | "cor_designed" | "normalised_passivity":
            yield f"compensation.{force.kind}", -sensor.delay
        case "smith_predictor":
            yield "compensation.smith_predictor", -sensor.delay * force.stiffness / scenario.mechanism.contact.stiffness
        case "resynchronised":  # it plays the low-pass through as well
            lowpass = 0.0 if sensor.lowpass is None else 1.0 / (2.0 * math.pi * sensor.lowpass)
            yield "compensation.resynchronised", -sensor.delay - lowpass
            if force.delay == "estimate":
                late = sum(given["delay"] for kind, given in effects_of(scenario, "sensor") if kind == "sensor.delay")
                yield "compensation.resynchronised.estimate", -late
        case "virtual_contact":  # a damper b is worth a lead of b/k
            yield "compensation.virtual_contact", -force.damping / scenario.mechanism.contact.stiffness


def _numerical_model(scenario: Scenario) -> Iterator[tuple[str, float]]:
    for kind, given in effects_of(scenario, "dynamics"):
        match kind:
            case "dynamics.step_delay":
                yield "effects.dynamics.step_delay", given["ticks"] * scenario.tick
            case "dynamics.integrator":  # explicit Euler is a step late
                yield "effects.dynamics.integrator", scenario.tick


def contact_frequency(scenario: Scenario) -> float:
    """``w = sqrt(k/mu)`` [rad/s] of the contact with both bodies free."""
    return math.sqrt(scenario.mechanism.contact.stiffness / effective_mass(scenario))


def predicted_log_error(scenario: Scenario, ledger: list[Delay]) -> float:
    """What the ledger's sum does to ``ln e``: ``(pi/2) w sum(tau)``."""
    return 0.5 * math.pi * contact_frequency(scenario) * ledger[-1].delay
