"""Warnings on scenarios whose numbers are valid individually but implausible in combination: what
is unreliable, and what to change.

They include keys that were given but have no effect.

Such scenarios are not refused. The warnings are in the output of `hiltestbed check`, on standard
error of `hiltestbed run` and in summary.json.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from hiltestbed.contact.directions import acting_along_z
from hiltestbed.scenario.idle import given_in_vain

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario

# ticks of the loop per contact; with fewer, the measured force does not represent the contact
FEWEST_TICKS = 2.0
# physics steps per contact; with fewer, the impulse is wrong by about a percent: (pi/n)^2/24 of it
FEWEST_INSTANTS = 8.0
MASS_RATIO = 1e6  # above it, differences of the two motions lose half of the digits
# part of the relative speed that the damper removes in one physics step; above it an explicit force
# overshoots
STIFF_DAMPER = 1.0


def warnings(scenario: Scenario) -> tuple[str, ...]:
    """What is unreliable in a run of this scenario."""
    return tuple(_warnings(scenario))


def _warnings(scenario: Scenario) -> Iterator[str]:
    (stiffness, damping), mass = acting_along_z(scenario.impact), scenario.impact.mass
    frequency = math.sqrt(stiffness / mass)  # [rad/s]
    lasts = math.pi / frequency
    ticks, instants = lasts * scenario.rate, lasts * scenario.physics_rate
    if not scenario.mechanism.captured:
        if ticks < FEWEST_TICKS:
            yield (
                f"the contact lasts {ticks:.2g} ticks of the loop ({lasts:.3g} s at "
                f"{scenario.rate:g} Hz): the numerical model is driven with another force than the "
                f"contact's, rebound and energy are meaningless; use a rate above "
                f"{8.0 / lasts:.3g} Hz"
            )
        elif instants < FEWEST_INSTANTS:
            yield (
                f"the contact lasts {instants:.2g} steps of the physics: its peak and impulse are "
                f"wrong by some percent; use a physics_rate above "
                f"{4 * FEWEST_INSTANTS / lasts:.3g} Hz"
            )
        yield from _too_far(scenario)
        yield from _drowned(scenario, frequency)
    late = scenario.sensor.delay + sum(
        float(getattr(e, "delay", 0.0)) for e in scenario.effects if e.link != "log"
    )
    if late > lasts:
        yield (
            f"the delay of {late:.3g} s is longer than the contact ({lasts:.3g} s): the force "
            f"arrives when the bodies have separated, no compensation helps; use a delay below "
            f"{lasts / 10:.2g} s or a softer contact"
        )
    pair = scenario.spacecraft.chaser.mass, scenario.spacecraft.target.mass
    if max(pair) >= MASS_RATIO * min(pair):
        yield (
            f"one vehicle has {max(pair) / min(pair):.3g} times the mass of the other: the motion "
            "of the heavy one is below the numerical resolution, so that momentum and energy of "
            "the pair are meaningless"
        )
    removed = damping / (mass * scenario.physics_rate)
    if removed > STIFF_DAMPER:
        yield (
            f"the damper removes {removed:.3g} times the relative speed in one physics step: "
            f"the contact chatters; use a physics_rate above {4 * damping / mass:.3g} Hz "
            f"or less damping"
        )
    yield from _too_deep(scenario, frequency)
    for keys, why in given_in_vain(scenario):
        yield f"{', '.join(keys)}: {'has' if len(keys) == 1 else 'have'} no effect: {why}"


def _too_far(scenario: Scenario) -> Iterator[str]:
    """A head-on approach that does not lead to a touch before the run ends."""
    approach = scenario.approach
    speed, gap = approach.velocity[2], 1e3 * approach.gap
    if speed < 0.0 < approach.gap:
        yield (
            f"nothing touches: at {speed:.3g} m/s the sides, {gap:.3g} mm apart, move away from "
            "each other; a positive approach.velocity.2 brings them together"
        )
    if not scenario.mechanism.flat or any((*approach.attitude_deg, *approach.rate_deg)):
        return
    if speed > 0.0 and approach.gap / speed >= scenario.duration:
        yield (
            f"nothing touches: the gap of {gap:.3g} mm takes {approach.gap / speed:.3g} s at "
            f"{speed:.3g} m/s, the run lasts {scenario.duration:.3g} s; use a longer duration or a "
            "smaller gap"
        )


def _drowned(scenario: Scenario, frequency: float) -> Iterator[str]:
    """A force that never exceeds the sensor's noise."""
    peak = acting_along_z(scenario.impact)[0] * abs(scenario.approach.velocity[2]) / frequency
    if 0.0 < peak < scenario.sensor.noise:
        yield (
            f"the sensor's noise, {scenario.sensor.noise:.3g} N, is more than the contact's peak "
            f"of about {peak:.3g} N: noise drives the loop, and rebound and energy are not those "
            "of the contact; the verdict on stability is that for a sensor without noise"
        )


def _too_deep(scenario: Scenario, frequency: float) -> Iterator[str]:
    """A penetration v/omega larger than the tip, beyond the validity of the contact surfaces."""
    if scenario.mechanism.captured:
        return
    share = min(1.0, acting_along_z(scenario.impact)[0] / scenario.mechanism.contact.stiffness)
    deepest, tip = share * abs(scenario.approach.velocity[2]) / frequency, _tip(scenario)
    if tip is not None and deepest > 2 * tip:
        yield (
            f"the contact goes {1e3 * deepest:.3g} mm deep, the tip is {2e3 * tip:.3g} mm across: "
            "it is completely inside the other side, where there is no contact; use a slower "
            "approach or a stiffer contact"
        )


def _tip(scenario: Scenario) -> float | None:
    """[m] the smallest radius of a ball or rod on the active side; None if it has none."""
    import mujoco

    active, _ = scenario.mechanism.sides()
    round_ones = (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE)
    radii = [float(g.size[0]) for g in active.geoms if g.type in round_ones and g.size[0] > 0]
    return min(radii, default=None)
