"""Physics steps that a contact needs: the default physics rate, and the error of a coarser one.

Euler's method with n steps in half a period of the contact has an error of the coefficient of
restitution of about 1/(4 n): measured 1.4 % with 19 steps and 0.24 % with 99. What counts is the
fastest motion that the contact drives: that of both bodies on the contact, or of a light part
between a wall and its spring.
"""

from __future__ import annotations

import math

from hiltestbed.contact.directions import acting_along_z
from hiltestbed.contact.touch import Impact, first_touch
from hiltestbed.scenario.like import HIGHEST

# steps in half a period of the fastest motion: an error of 0.25 %
STEPS = 100.0
# relative error of the rebound up to which a reference counts as converged: that of half as many
# steps
TOLERANCE = 1.0 / (4.0 * 0.5 * STEPS)
# steps of the physics in a tick, at least: a force between two readings
LEAST = 2


def error_bound(impact: Impact, physics_rate: float) -> float:
    """Relative error of the first rebound with steps at ``physics_rate`` [Hz]: 1/(4 n)."""
    return _fastest(impact) / (4.0 * math.pi * physics_rate)


def rate_for_comparison(impact: Impact, physics_rate: float) -> float | None:
    """Twice the ``physics_rate`` [Hz]; None if that is enough, or cannot be doubled."""
    rate = 2.0 * physics_rate
    return rate if error_bound(impact, physics_rate) > TOLERANCE and rate <= HIGHEST else None


def converged(cor: float | None, halved: float | None) -> bool:
    """Whether rebounds with a step and with half of it agree: the error is twice the difference."""
    if cor is None or halved is None:
        return cor is halved
    return cor == halved or (
        min(cor, halved) > 0.0 and 2.0 * abs(math.log(cor / halved)) <= TOLERANCE
    )


def sufficient_rate(impact: Impact, rate: float) -> float:
    """Lowest physics rate [Hz] with :data:`STEPS`, a power of two times the loop's ``rate``."""
    least = rate * LEAST
    most = max(0, math.floor(math.log2(HIGHEST / least)))
    needed = STEPS * _fastest(impact) / math.pi
    return least * 2 ** (min(most, math.ceil(math.log2(needed / least))) if needed > least else 0)


def _fastest(impact: Impact) -> float:
    """[rad/s] of the bodies on the contact, or of a part of the mechanism in its first touch."""
    contact = math.sqrt(acting_along_z(impact)[0] / impact.mass)
    if impact.sides.rigid:
        return contact
    touches = (first_touch(i) for i in (impact.centred(), impact))
    return max(contact, *(0.0 if t is None else t.fastest for t in touches))
