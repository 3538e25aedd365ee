"""One bounce of two free bodies on a spring and damper, in closed form.

    mu x'' = -F,   F = k x + c x' while x > 0 and never negative,   mu = m1 m2/(m1 + m2)

With w = sqrt(k/mu), z = c/(2 sqrt(k mu)) and s = sqrt(1 - z^2) the bodies touch at x = 0 with the
speed v0 and part where F = 0. F is mu v0 (w/s) exp(-z w t) sin(s w t + 2 asin z), so that

    contact time   t1 = 2 acos(z)/(s w)            CoR   e = exp(-z w t1)
    peak of F      at (pi/2 - 3 asin z)/(s w), at once where that is negative: c v0
    penetration    v0/w exp(-(z/s) acos z)

Beyond critical damping acos(z)/s continues as acosh(z)/sqrt(z^2 - 1). A force that is late by tau
acts as the damping -k tau: a closed contact diverges beyond

    tau_c = atan(c w_c/k)/w_c,   w_c^2 = (c^2 + sqrt(c^4 + 4 mu^2 k^2))/(2 mu^2)
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.errors import InputError
from hiltestbed.frames import Array

PHASES = 32  # of the touch within a step, over which the worst error of a step is taken
STEPS = 4000  # of a contact, for a bounce with a late force: its CoR is right to 1e-3
# damping ratio at which a rebound is 1e-9 of the approach: e is 1/(4 z^2) of an over-damped contact
LARGEST_RATIO = 1.6e4


@dataclass(frozen=True)
class SpringDamper:
    """A contact ``stiffness`` [N/m], ``damping`` [N s/m] of bodies of a reduced ``mass`` [kg]."""

    stiffness: float
    damping: float
    mass: float

    @property
    def frequency(self) -> float:
        """w [rad/s]."""
        return math.sqrt(self.stiffness / self.mass)

    @property
    def damping_ratio(self) -> float:
        """z [-]."""
        return self.damping / (2.0 * math.sqrt(self.stiffness * self.mass))

    @property
    def contact_time(self) -> float:
        """[s] from the touch until the force is zero."""
        return 2.0 * _angle_over_root(self.damping_ratio) / self.frequency

    @property
    def cor(self) -> float:
        """Coefficient of restitution [-]: rebound speed over approach speed."""
        return math.exp(-self.damping_ratio * self.frequency * self.contact_time)

    def penetration(self, speed: float) -> float:
        """[m] the largest, for an approach ``speed`` [m/s]."""
        z = self.damping_ratio
        return speed / self.frequency * math.exp(-z * _angle_over_root(z))

    def peak_force(self, speed: float) -> float:
        """[N] the largest, for an approach ``speed`` [m/s]."""
        z = self.damping_ratio
        if z >= 0.5:  # it falls from the touch on
            return self.damping * speed
        share = (0.5 * math.pi - 3.0 * math.asin(z)) / math.sqrt(1.0 - z * z)
        return math.sqrt(self.stiffness * self.mass) * speed * math.exp(-z * share)

    @property
    def critical_delay(self) -> float:
        """[s] of the force, beyond which a closed contact diverges; 0 without damping."""
        k, c, m = self.stiffness, self.damping, self.mass
        crossing = math.sqrt((c * c + math.sqrt(c**4 + 4.0 * m * m * k * k)) / (2.0 * m * m))
        return math.atan(c * crossing / k) / crossing

    @property
    def neutral_delay(self) -> float:
        """[s] of the force, beyond which a bounce gains speed (CoR = 1); 0 without damping."""
        if self.damping == 0.0:
            return 0.0

        from scipy.optimize import brentq

        def gain(delay: float) -> float:
            return self.late_cor(delay) - 1.0

        high = 2.0 * self.damping_ratio / self.frequency  # to first order
        while gain(high) < 0.0:
            high *= 2.0
        found: Any = brentq(gain, 0.0, high, xtol=1e-4 * high)
        return float(found)

    def late_cor(self, delay: float) -> float:
        """CoR of a bounce whose force acts ``delay`` [s] late, stepped semi-implicitly."""
        step = self.contact_time / STEPS
        return float(_late_rebound(self.stiffness, self.damping, self.mass, step, delay / step))

    def stepped_errors(self, step: float) -> Array:
        """``(PHASES,)`` relative errors of the CoR where the contact is stepped by ``step`` [s], of
        touches at any instant within a step. The velocity is stepped first, with the force at the
        start of the step, as by MuJoCo's Euler integrator.
        """
        x = -step * (np.arange(PHASES) + 0.5) / PHASES
        v, touched = np.ones(PHASES), np.zeros(PHASES, dtype=bool)
        k, c, m = self.stiffness, self.damping, self.mass
        for _ in range(2 + math.ceil(4.0 * self.contact_time / step)):
            force = np.where(x > 0.0, np.maximum(k * x + c * v, 0.0), 0.0)
            touched |= x > 0.0
            v = v - force / m * step
            x = x + v * step
            if (touched & (x <= 0.0)).all():
                break
        return np.abs(-v / self.cor - 1.0)

    def largest_step(self, error: float) -> float:
        """[s] the largest step whose CoR is off by at most ``error``, wherever the touch falls."""
        high = self.contact_time
        low = high
        while self.stepped_errors(low).max() > error:
            high, low = low, 0.5 * low
        for _ in range(12):  # to a part in 4,000
            middle = 0.5 * (low + high)
            if self.stepped_errors(middle).max() > error:
                high = middle
            else:
                low = middle
        return low


@njit(cache=True)
def _late_rebound(k, c, m, step, late):
    """Rebound speed of a mass that touches with 1 m/s; the force acts ``late`` steps later."""
    whole = int(late)
    part = late - whole
    length = whole + 2
    past = np.zeros(length)
    x, v, n = 0.0, 1.0, 0
    while x >= 0.0 or past.any():
        past[n % length] = max(k * x + c * v, 0.0) if x >= 0.0 else 0.0
        force = (1.0 - part) * past[(n - whole) % length] + part * past[(n + 1) % length]
        v -= force / m * step
        x += v * step
        n += 1
    return -v


def _angle_over_root(ratio: float) -> float:
    """acos(z)/sqrt(1 - z^2), continued beyond z = 1."""
    if ratio < 1.0:
        return math.acos(ratio) / math.sqrt(1.0 - ratio * ratio)
    return 1.0 if ratio == 1.0 else math.acosh(ratio) / math.sqrt(ratio * ratio - 1.0)


def reduced_mass(first: float, second: float) -> float:
    """[kg] of two bodies; one of them may be infinitely heavy."""
    return 1.0 / (1.0 / first + 1.0 / second)


def with_cor(stiffness: float, cor: float, mass: float) -> SpringDamper:
    """The contact of ``stiffness`` [N/m] with the coefficient of restitution ``cor``. Raises
    InputError unless it is above 0 and at most 1.
    """
    if not 0.0 < cor <= 1.0:
        raise InputError(
            f"--cor: must be above 0 and at most 1 (got {cor:g}); no spring and damper makes a "
            f"rebound faster than its approach"
        )
    from scipy.optimize import brentq

    unit = 2.0 * math.sqrt(stiffness * mass)  # [N s/m] of critical damping

    def off(ratio: float) -> float:
        return math.log(SpringDamper(stiffness, ratio * unit, mass).cor / cor)

    if off(LARGEST_RATIO) > 0.0:
        raise InputError(f"--cor: is too small (got {cor:g}); allowed is 1e-9 and more")
    ratio: Any = 0.0 if cor == 1.0 else brentq(off, 0.0, LARGEST_RATIO, xtol=1e-14)
    return SpringDamper(stiffness, ratio * unit, mass)
