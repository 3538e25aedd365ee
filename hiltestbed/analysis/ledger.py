"""The delay ledger: every delay in the loop, and the damping that it removes from the contact.

A delay tau of the force acts on a contact of stiffness k as a damping -k tau, since ``F(t - tau) ~
F - tau k v``; one bounce of two free bodies of reduced mass mu then has ``ln e = -pi c_eff/(2
sqrt(k mu))``, hence ``ln(e/e_ref) = (pi/2) w sum(tau)`` with ``w = sqrt(k/mu)``. Accurate to 0.01
in ln e for w tau <= 0.25.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from hiltestbed.analysis.metrics import ContactFigures
from hiltestbed.analysis.trial import corrected_log_error
from hiltestbed.contact.directions import acting_along_z
from hiltestbed.effects.table import by_link
from hiltestbed.numerical_model.bodies import effective_mass
from hiltestbed.scenario import Scenario


@dataclass(frozen=True)
class Delay:
    """One entry: its source, the delay [s], and the equivalent damping [N s/m]."""

    source: str
    delay: float
    equivalent_damping: float


def delay_ledger(scenario: Scenario, figures: ContactFigures) -> list[Delay]:
    """Every delay from the contact to the model's motion (leads are negative), and their sum."""
    # The force is read at t_k, the model steps, the rig moves linearly to its pose until t_(k+1):
    # the semi-implicit step makes up for the tick.
    compensation, w = scenario.compensation, contact_frequency(scenario)
    if scenario.rig.platform.physical:  # no loop: the bodies themselves move
        return [Delay("total", 0.0, 0.0)]
    delays = [
        *_sensor(scenario, w),
        *_compensation(scenario),
        ("coupling", 0.0),
        *_effects(scenario, w, "dynamics"),
    ]
    model = scenario.numerical_model
    if model.ticks_late:
        delays.append((f"numerical_model.{model.kind}", model.ticks_late * scenario.tick))
    tracking = scenario.rig.platform.tracking
    if tracking in ("servo", "response") or by_link(scenario.effects, "platform"):
        source = tracking if tracking in ("servo", "response") else "effects"
        delays.append((f"platform.{source}", figures.tracking_delay or 0.0))
    platform = sum(delay for source, delay in delays if source.startswith("platform."))
    if compensation.force.corrects_platform:
        delays.append(("compensation.platform", -platform))
    elif corrects_platform(scenario):
        # by simulation, because the contact is not known when it begins; all of it without one
        force, removed = sum(delay for _, delay in delays) - platform, platform
        if (error := corrected_log_error(scenario, force)) is not None:
            removed += max(force, 0.0) - error / (0.5 * math.pi * w)
        delays.append(("compensation.platform", -removed))
    delays.append(("total", sum(delay for _, delay in delays)))
    k, _ = acting_along_z(scenario.impact)
    return [Delay(source, delay, 0.0 - k * delay) for source, delay in delays]


def corrects_platform(scenario: Scenario) -> bool:
    """Whether a method compensates the platform in the first contact: one that corrects the force
    by what is identified along z needs a contact that is identified there before a capture.
    """
    mechanism, compensation = scenario.mechanism, scenario.compensation
    identified = compensation.motion.corrects_force and (mechanism.flat or mechanism.captured)
    return compensation.force.corrects_platform or identified


def force_path_delay(scenario: Scenario, compensated: bool) -> float:
    """Delay [s] of the force that drives the model: sensor and effects, minus compensation."""
    w = contact_frequency(scenario)
    parts = [
        *_sensor(scenario, w),
        *_effects(scenario, w, "dynamics"),
        *(_compensation(scenario) if compensated else ()),
    ]
    return sum(delay for _, delay in parts)


def _sensor(scenario: Scenario, w: float) -> Iterator[tuple[str, float]]:
    sensor = scenario.sensor
    yield "sensor.delay", sensor.delay
    if sensor.lowpass is not None:
        yield "sensor.lowpass", 1.0 / (2.0 * math.pi * sensor.lowpass)
    if sensor.time_constant is not None:  # a high-pass leads: phase 1/(w T)
        yield "sensor.time_constant", -1.0 / (w * w * sensor.time_constant)
    yield from _effects(scenario, w, "sensor")


def _effects(scenario: Scenario, w: float, link: str) -> Iterator[tuple[str, float]]:
    for effect in by_link(scenario.effects, link):
        delay = effect.worth(scenario.tick, w)
        if delay is not None:
            yield f"effects.{effect.kind}", delay


def _compensation(scenario: Scenario) -> Iterator[tuple[str, float]]:
    """What the method removes at low frequency, once it knows the contact that it needs."""
    return (
        (f"compensation.{name}", -delay)
        for name, delay in scenario.compensation.force.removes(scenario).items()
    )


def contact_frequency(scenario: Scenario) -> float:
    """``w = sqrt(k/mu)`` [rad/s] of the contact with both bodies free."""
    return math.sqrt(acting_along_z(scenario.impact)[0] / effective_mass(scenario.spacecraft))


def predicted_log_error(scenario: Scenario, ledger: list[Delay]) -> float:
    """Change of ``ln e`` by the ledger's sum: ``(pi/2) w sum(tau)``."""
    return 0.5 * math.pi * contact_frequency(scenario) * ledger[-1].delay
