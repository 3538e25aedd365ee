"""The boundary beyond which the rig adds energy to the contact: closed forms for a linear contact
felt with a pure delay.

In units of the contact (w = sqrt(k/mu), zeta = c/(2 sqrt(k mu)), speeds in approach speeds) the
relative motion obeys x'' = -f(t - w tau), f = x + 2 zeta x', x(0) = 0, x'(0) = 1. By Laplace
transform, exactly,

    x(t) = sum_n (-1)^n sum_j C(n, j) (2 zeta)^j (t - n w tau)_+^(2n + 1 - j)/(2n + 1 - j)!

The ports separate where the force would become a pull, f = 0; the delayed force does not yet
include this before then. A delay preserves the impulse, so that e = integral of f up to separation,
minus one. For zeta = 0 this is the series of one undamped bounce.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np

from hiltestbed.analysis.spring_damper import SpringDamper
from hiltestbed.contact.directions import acting_along_z
from hiltestbed.frames import Array
from hiltestbed.numerical_model.bodies import effective_mass
from hiltestbed.scenario import Scenario
from hiltestbed.sensor.parameters import SensorParameters

TERMS = 28  # of the sum over n: the rest is below 1e-16 for t <= 6
LONGEST = 6.0  # in units of 1/w; an undamped bounce takes pi
_STEPS = 61
# damping ratio up to which these formulas have been compared with simulations
HIGHEST_DAMPING = 0.6


def bounce_delay(stiffness: float, damping: float, mass: float) -> float:
    """The delay [s] at which a contact that cannot pull rebounds with its approach speed, e = 1."""
    zeta = damping / (2 * math.sqrt(stiffness * mass))
    if zeta > HIGHEST_DAMPING:
        raise ValueError(f"damping ratio {zeta:g}; known up to {HIGHEST_DAMPING:g}")
    return float(_neutral_curve()(zeta)) / math.sqrt(stiffness / mass)


@cache
def _neutral_curve():
    """w tau at which e = 1, as a spline over the damping ratio, accurate to 1e-6."""
    from scipy.interpolate import CubicSpline

    dampings = np.linspace(0.0, HIGHEST_DAMPING, 25)
    return CubicSpline(dampings, [neutral(float(zeta)) for zeta in dampings])


def neutral(zeta: float) -> float:
    """w tau at which e = 1, for a contact that cannot pull."""
    from scipy.optimize import brentq

    if zeta == 0.0:
        return 0.0
    found: Any = brentq(
        lambda w_tau: bounce_cor(zeta, w_tau) - 1.0, 0.5 * zeta, 2.0 * zeta + 0.01, xtol=1e-10
    )
    return float(found)


def bounce_cor(zeta: float, w_tau: float, pulls: bool = False) -> float:
    """Coefficient of restitution of one bounce; `pulls` lets the contact pull until x = 0."""
    from scipy.optimize import brentq

    times = np.linspace(0.0, LONGEST, _STEPS)[1:]
    position, speed, _ = motion(times, zeta, w_tau)
    level = position if pulls else position + 2 * zeta * speed
    after = np.flatnonzero(level[1:] < 0.0)
    if not after.size:
        raise ValueError(f"no separation within {LONGEST}/w (zeta {zeta:g}, w tau {w_tau:g})")

    def held(time: float) -> float:
        position, speed, _ = motion(np.array([time]), zeta, w_tau)
        return float(position[0] if pulls else position[0] + 2 * zeta * speed[0])

    parting = brentq(held, times[after[0]], times[after[0] + 1], xtol=1e-13)
    position, _, integral = motion(np.array([parting]), zeta, w_tau)
    return float(integral[0] + 2 * zeta * position[0] - 1.0)


def motion(times: Array, zeta: float, w_tau: float) -> tuple[Array, Array, Array]:
    """Position, speed and integral of the position in contact at `times` (units of 1/w)."""
    position, speed, integral = (np.zeros_like(times) for _ in range(3))
    for n in range(TERMS):
        late = np.maximum(times - n * w_tau, 0.0)
        if not late.any():
            break
        for j in range(n + 1):
            power = 2 * n + 1 - j
            factor = (-1) ** n * math.comb(n, j) * (2 * zeta) ** j / math.factorial(power)
            before = late ** (power - 1) if power > 1 else (late > 0.0).astype(float)
            speed += factor * power * before
            position += factor * before * late
            integral += factor * before * late**2 / (power + 1)
    return position, speed, integral


def applies(scenario: Scenario) -> bool:
    """Whether the closed forms hold: linear contact, pure delay, bare loop, ideal tracking."""
    sensor = scenario.sensor
    return (
        scenario.mechanism.flat
        and scenario.rig.platform.tracking == "ideal"
        and scenario.compensation.force.kind == "none"
        and sensor.lowpass is None
        and sensor.time_constant is None
        and not any(scenario.approach.offset)
        and all(
            effect.kind in ("sensor.delay", "contact.stiffness", "contact.damping")
            for effect in scenario.effects
        )
    )


def margin(scenario: Scenario) -> tuple[float, float]:
    """The delay beyond the limits of closed contact and bounce [s]; positive: energy is added."""
    delay = SensorParameters.believed(scenario.sensor).with_effects(scenario.effects).delay
    law = (*acting_along_z(scenario), effective_mass(scenario))
    return delay - SpringDamper(*law).critical_delay, delay - bounce_delay(*law)
