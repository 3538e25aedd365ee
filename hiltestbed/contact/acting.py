"""Stiffness and damping with which a contact acts, effects included: one pair of numbers for
ledger, stability, truth of an identification and warnings.

A linear law has them; the frame's compliance is in series. Any other law gets those of its
describing function (N. Krylov, N. Bogoliubov, Introduction to Non-Linear Mechanics, 1943): the
spring and damper with the same force in phase with penetration and rate, over the half sine x = X
sin(w t) of a head-on bounce, w^2 = k/m and X = v/w.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hiltestbed.contact.law import STATES, contact_force
from hiltestbed.contact.parameters import CURVES, ContactParameters, believed_contacts

if TYPE_CHECKING:
    from hiltestbed.scenario.like import ScenarioLike as Scenario

Pair = tuple[float, float]
# terms that make a law non-linear, beside learned curves
NON_LINEAR = (
    "power_stiffness",
    "alpha",
    "dry",
    "stop_stiffness",
    "branch_stiffness",
    "play",
    "mode",
)
PHASES = 400  # of the half sine: midpoints, error of order 1/PHASES^2
ROUNDS, SAME = 60, 1e-9  # of the iteration for w; relative change at which it has converged


def acting_contacts(scenario: Scenario) -> list[ContactParameters]:
    """The contact of each rule of the mechanism, and last of its latch, effects included."""
    return [c.with_effects(scenario.effects) for c in believed_contacts(scenario.mechanism)]


def in_series(first: Pair, second: Pair) -> Pair:
    """Stiffness and damping, at frequencies well below k/c, of two springs with dampers in
    series.
    """
    (k1, c1), (k2, c2) = first, second
    total = k1 + k2
    return k1 * k2 / total, (c1 * k2 * k2 + c2 * k1 * k1) / (total * total)


def linear_law(law: ContactParameters) -> Pair | None:
    """Stiffness [N/m] and damping [N s/m] of a linear law, wherever its touch is, with the frame's
    compliance; None if it is not linear.
    """
    neutral = ContactParameters(1.0)
    if any(getattr(law, name) != getattr(neutral, name) for name in NON_LINEAR):
        return None
    if any(getattr(law, name)[0] > 0.0 for name in CURVES):
        return None
    own = (float(law.stiffness), float(law.damping))
    if law.frame <= 0.0:
        return own
    # the frame deflects under the force at the rate of the whole: F = k (x - F/k_frame) + c v
    share = float(law.frame) / (law.stiffness + law.frame)
    return own[0] * share, own[1] * share


def acting_law(law: ContactParameters, mass: float, speed: float) -> Pair:
    """Stiffness [N/m] and damping [N s/m] with which a law acts in a head-on bounce of ``mass``
    [kg] at ``speed`` [m/s]; without speed those of its linear terms.
    """
    linear = linear_law(law)
    if linear is not None or speed <= 0.0:
        return linear or (float(law.stiffness), float(law.damping))
    row, found = replace(law, offset=0.0).row(), (float(law.stiffness), float(law.damping))
    phase = (np.arange(PHASES) + 0.5) * math.pi / PHASES
    for _ in range(ROUNDS):
        w = math.sqrt(found[0] / mass)
        size, state = speed / w, np.zeros(STATES)
        force = np.array(
            [
                contact_force(
                    size * math.sin(a), speed * math.cos(a), phase[0] * 2.0 / w, row, state, True
                )
                for a in phase
            ]
        )
        half = 0.5 * PHASES  # the sum of sin^2, and of cos^2
        before = found
        found = (
            max(float(force @ np.sin(phase)) / (size * half), SAME * found[0]),
            float(force @ np.cos(phase)) / (speed * half),
        )
        if abs(found[0] - before[0]) <= SAME * found[0]:
            break
    return found
