"""Prediction of one bounce before the run: its coefficient of restitution, and the energy that the
rig makes in it.

Net damping decides whether the oscillation of a closed contact decays. A touch, however, begins
with a force step: the damper exerts c v at once, and this reaches the numerical model a lag tau
later, during which it continues at full speed. For a free flyer of mass m the rig then makes

    E = integral of F v_act - F_used v_cmd = (tau/m) integral of F^2 dt = tau k integral of v^2 dt +
    (tau c/2)(v_0^2 + v_1^2)

to first order in tau. The first term is the damping -k tau of the delay ledger; the second comes
from both ends of the contact and is of the order of c tau/m of the approach energy. A light tip in
a well-damped cone has c tau/m of 1 and more: it may rebound faster than it approached although the
net damping is far above zero. The bounce is therefore computed: in the coordinate x along the
direction, with the force F = k x + c x' (never pulling), and g the impulse response of x to the
force, through the numerical model and the rig,

    x(t) = v_0 t - integral of g(t - s) F(s) ds,   g <-> G(s) e^(-s tau)/(m s^2) + Y(s)

G and Y are those of :mod:`hiltestbed.analysis.rig_response`. The inverse transform is the closed
form of a second-order system with the same lag, plus a sum over the measured lines of the
remainder, which decreases with the third power of the frequency.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array

if TYPE_CHECKING:
    from hiltestbed.analysis.rig_response import RigResponse

STEPS = 500  # per bounce: error of e 2e-3
# half periods of the contact, and lags of the loop, that together bound the duration of a bounce
HALF_PERIODS, LAGS = 1.3, 3.0


@dataclass(frozen=True)
class Bounce:
    """rebound: speed after over before. energy: made by the rig, over the kinetic energy before."""

    rebound: float
    energy: float


def bounce(
    response: RigResponse, mass: float, stiffness: float, damping: float, delay: float
) -> Bounce:
    """A bounce of ``mass`` [kg] on [N/m], [N s/m] through a rig; the force ``delay`` [s] late."""
    lag = lag_of(response)
    span = HALF_PERIODS * math.pi * math.sqrt(mass / stiffness) + LAGS * max(delay + lag, 0.0)
    t = np.linspace(0.0, span, STEPS + 1)
    dt = float(t[1])
    g = dt * (_carried(response, lag, t - delay) / mass + _yielded(response, t))
    force = np.zeros(len(t))
    work = _met(t, g, dt, float(stiffness), float(damping), force)
    after = 1.0 - dt * (float(force.sum()) - 0.5 * force[0]) / mass
    return Bounce(float(-after), float(2.0 * work / mass - (1.0 - after * after)))


@njit(cache=True)
def _met(t, g, dt, stiffness, damping, force):
    """The force of the contact at ``t`` (N,) after an approach at 1 m/s into ``force`` (N,), zeros,
    and the work that is done on it.
    """
    place, work = 0.0, 0.0
    force[0] = damping
    for j in range(1, len(t)):
        answered = 0.0
        for i in range(1, j):
            answered += force[i] * g[j - i]
        free = t[j] - answered - 0.5 * force[0] * g[j]
        if free <= 0.0:
            break
        pushed = stiffness * free + damping * (free - place) / dt
        force[j] = pushed if pushed > 0.0 else 0.0
        work += 0.5 * (force[j] + force[j - 1]) * (free - place)
        place = free
    return work


def lag_of(response: RigResponse) -> float:
    """Lag of the rig at low frequency [s]; negative: lead."""
    return float(-np.angle(response.follows[1]) / (2.0 * math.pi * response.frequency[1]))


def _carried(response: RigResponse, lag: float, t: Array) -> Array:
    """The inverse transform of G/s^2 at ``t`` [s]."""
    after = np.maximum(t, 0.0)
    if not np.any(response.follows != 1.0):
        return after
    half = 0.5 * abs(lag)  # 1/(1 + s half)^2
    ramp = (
        after - 2.0 * half + (after + 2.0 * half) * np.exp(-after / half) if half > 0.0 else after
    )
    w = 2.0 * math.pi * response.frequency[1:]
    second = 1.0 / (1.0 + 1j * w * half) ** 2
    if lag < 0.0:  # a lead: the mirror image
        ramp, second = 2.0 * after - ramp, 2.0 - second
    rest = (response.follows[1:] - second) / -(w**2)
    return np.where(t > 0.0, ramp + _summed(response, rest, t), 0.0)


def _yielded(response: RigResponse, t: Array) -> Array:
    """The inverse transform of Y at ``t`` [s]."""
    return (
        np.zeros(len(t))
        if not np.any(response.yields)
        else _summed(response, response.yields[1:], t)
    )


def _summed(response: RigResponse, lines: NDArray[np.complex128], t: Array) -> Array:
    """The inverse transform of values at the lines above 0 Hz, for responses that decay within half
    a period of the line spacing.

    ``t`` (N,) is evenly spaced, so that its N sums are products of about sqrt(N) coarse and sqrt(N)
    fine rotations of each line.
    """
    spacing = float(response.frequency[1] - response.frequency[0])
    turns = 2j * math.pi * response.frequency[1:]
    block = math.isqrt(len(t) - 1) + 1
    fine = np.exp(np.outer(turns, (t[1] - t[0]) * np.arange(block)))
    swing = (np.exp(np.outer(t[::block], turns)) * lines) @ fine
    total = spacing * (2.0 * swing.real.ravel()[: len(t)] + lines[0].real)
    return np.where(t < 0.5 / spacing, total, 0.0)
