"""Physics steps that a contact needs: the default physics rate, and the error of a coarser one.

Euler's method with n steps in half a period of the contact has an error of the coefficient of
restitution of about 1/(4 n): measured 1.4 % with 19 steps and 0.24 % with 99. What counts is the
fastest motion that the contact drives: that of both bodies on the contact, or of a light part
between a wall and its spring.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeVar

from hiltestbed.contact.directions import acting_along_z
from hiltestbed.contact.sides import sides_of
from hiltestbed.contact.touch import first_touch
from hiltestbed.numerical_model.bodies import effective_mass
from hiltestbed.scenario.like import HIGHEST

if TYPE_CHECKING:
    from hiltestbed.scenario.like import ScenarioLike as Scenario

SomeScenario = TypeVar("SomeScenario", bound="Scenario")

# steps in half a period of the fastest motion: an error of 0.25 %
STEPS = 100.0
# relative error of the rebound up to which a reference counts as converged: that of half as many
# steps
TOLERANCE = 1.0 / (4.0 * 0.5 * STEPS)
# steps of the physics in a tick, at least: a force between two readings
LEAST = 2


def error_bound(scenario: Scenario) -> float:
    """Relative error of the rebound that the physics step may cause in the first contact: 1/(4 n)
    for n steps in half a period of the fastest motion.
    """
    return _fastest(scenario) / (4.0 * math.pi * scenario.physics_rate)


def with_half_the_step(scenario: SomeScenario) -> SomeScenario | None:
    """The scenario with half the physics step, for comparison; None if the step is short enough by
    :func:`error_bound`, or cannot be halved.
    """
    rate = 2.0 * scenario.physics_rate
    if error_bound(scenario) <= TOLERANCE or rate > HIGHEST:
        return None
    return scenario.model_copy(update={"stated_physics_rate": rate})


def unconverged(scenario: Scenario, cor: float | None, halved: float | None) -> str | None:
    """The warning that a reference's rebound is not that of a shorter physics step: ``cor``, and
    with the step ``halved``; Euler's error is twice their difference. None if it is small.
    """
    if cor is None or halved is None:
        same = cor is halved
    else:
        same = cor == halved or (
            min(cor, halved) > 0.0 and 2.0 * abs(math.log(cor / halved)) <= TOLERANCE
        )
    if same:
        return None
    before, after = ("none" if e is None else f"{e:.4g}" for e in (cor, halved))
    return (
        f"the physics step of {1e3 / scenario.physics_rate:.3g} ms is too long for this contact: "
        f"half of it changes the coefficient of restitution of the reference from {before} to "
        f"{after}; use a physics_rate of {sufficient_rate(scenario):g} Hz or leave it out"
    )


def sufficient_rate(scenario: Scenario) -> float:
    """Lowest physics rate [Hz] that has :data:`STEPS`, as a power of two times the loop's rate, so
    that few rates occur in a campaign.
    """
    least = scenario.rate * LEAST
    most = max(0, math.floor(math.log2(HIGHEST / least)))
    needed = STEPS * _fastest(scenario) / math.pi
    return least * 2 ** (min(most, math.ceil(math.log2(needed / least))) if needed > least else 0)


def _fastest(scenario: Scenario) -> float:
    """[rad/s] of the bodies on the contact, or of a part of the mechanism in its first touch."""
    contact = math.sqrt(acting_along_z(scenario)[0] / effective_mass(scenario))
    if sides_of(scenario.mechanism).rigid:
        return contact
    touches = (first_touch(scenario, centred) for centred in (True, False))
    return max(contact, *(0.0 if t is None else t.fastest for t in touches))
