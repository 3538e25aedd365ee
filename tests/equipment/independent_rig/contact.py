"""The contact law of this rig along one normal: it pushes, or in a latch also pulls.

Every law is evaluated at any instant from the position then, the rate of that tick and the states
of the contact; no force is interpolated across a touch.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hiltestbed.compiled.jit import njit

# states: Maxwell force [N], frame [m], [m/s], time since the touch [s], slider [m]
BRANCH, FRAME, FRAME_V, AGE, SLIDER = range(5)
STATES = 5
SLIDING = 1e-4  # m/s, regularisation speed of the tangential friction
REVERSAL = 2e-4  # m/s, regularisation speed of the buffer's friction
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
STRAIGHT = np.ones(2)


class Contact(NamedTuple):
    """The contact law; zero switches a term off. SI, in P."""

    stiffness: float
    damping: float
    friction: float
    latched: bool = False
    exponent: float = 0.0
    power: float = 0.0  # N/m^exponent
    hunt: float = -1.0  # s/m; negative: k x + c v
    dry: float = 0.0
    preload: float = 0.0
    stop_at: float = 0.0
    stop_stiffness: float = 0.0
    branch_stiffness: float = 0.0
    branch_time: float = 1.0
    adhesion: float = 0.0
    touch: float = 0.0
    play: float = 0.0  # m, full width
    frame_stiffness: float = 0.0
    # point of application along the penetration: 1 at the tip, 0 at the undeformed surface
    lever: float = 1.0
    # a compliant frame K divides the contact's rate by (1 + k/K) to this power
    frame_rate: float = 0.0
    mode_w: float = 0.0
    mode_zeta: float = 0.0
    mode_mass: float = 0.0
    mode_read: bool = False  # whether the sensor is below the vibrating mass instead of above it
    unloading: float = 0.0  # foreign: fraction of the spring's force that is lost during unloading
    ageing: float = 0.0  # 1/s, foreign: relative change of the spring during the contact
    # s/m, foreign: relative increase of the spring with speed, in both directions
    speeding: float = 0.0
    ripple: float = 0.0  # N, foreign: periodic force over penetration, as of teeth
    ripple_period: float = 1.0  # m
    # 1/m, foreign: force along x as a fraction of the normal force, proportional to penetration
    side: float = 0.0
    tilt: np.ndarray = UPRIGHT  # (4,) attitude of the passive port
    # 1/N, foreign: relative increase of the friction coefficient with the normal force
    friction_load: float = 0.0
    line: float = 0.0  # foreign: relative amplitude of an oscillation of the force during contact
    line_w: float = 0.0  # rad/s
    # (m,) foreign: factors of the elastic force, evenly spaced over the depth, linear in between
    curve: np.ndarray = STRAIGHT
    curve_depth: float = 0.0  # m
    # N/m of the spring in series with the slider of the dry friction; 0: rigid
    dry_stiffness: float = 0.0


@njit(cache=True)
def _law(law, x, v, branch, age):
    """Force [N] in touch at penetration x [m] of the spring and rate v [m/s]."""
    side = -1.0 if law.latched and x < 0.0 else 1.0
    elastic = law.stiffness * (1.0 + law.ageing * age) * (1.0 + law.speeding * abs(v)) * x
    if law.exponent > 0.0:
        elastic = side * law.power * max(side * x, 0.0) ** law.exponent
    if law.curve_depth > 0.0:
        last = len(law.curve) - 1  # beyond the curve's end, too
        at = min(abs(x) / law.curve_depth, 1.0) * last
        i = min(int(at), last - 1)
        elastic *= law.curve[i] + (at - i) * (law.curve[i + 1] - law.curve[i])
    if law.line > 0.0:
        elastic *= 1.0 + law.line * math.sin(law.line_w * age)
    if v * side < 0.0:
        elastic *= 1.0 - law.unloading
    # dissipates also while a latch pulls
    force = elastic + (abs(elastic) * law.hunt if law.hunt >= 0.0 else law.damping) * v
    rub = law.dry * math.tanh(v / REVERSAL) if law.dry_stiffness == 0.0 else 0.0
    force += rub + side * law.preload + branch
    if law.stop_stiffness > 0.0 and x > law.stop_at:
        force += law.stop_stiffness * (x - law.stop_at)
    if law.ripple > 0.0:
        force += law.ripple * math.sin(2.0 * math.pi * x / law.ripple_period)
    return force


@njit(cache=True)
def _series(law, x, v, branch, age):
    """Force of contact and compliant frame K in series: the root of F = law(x - F/K)."""
    soft = 1.0 / law.frame_stiffness
    rate = v * (1.0 + law.stiffness * soft) ** -law.frame_rate
    low = high = _law(law, x, rate, branch, age)
    low, high = min(low, 0.0), max(high, 0.0)
    # the law increases with x: there is one root, between zero and the force with a rigid frame
    for _ in range(60):
        mid = 0.5 * (low + high)
        if _law(law, x - mid * soft, rate, branch, age) > mid:
            low = mid
        else:
            high = mid
    return 0.5 * (low + high)


@njit(cache=True)
def force_on(law, x, v, state):
    """Normal force [N] at penetration x [m] and rate v [m/s]; contact is decided by x, whatever the
    frame's deflection.
    """
    if law.mode_w > 0.0:
        x, v = x - state[FRAME], v - state[FRAME_V]
    within_play = x == 0.0 and law.play > 0.0
    if within_play or (x <= 0.0 and not law.latched):  # a latch also damps at zero deflection
        return 0.0
    given = law.frame_stiffness > 0.0 and law.mode_w == 0.0
    branch = state[BRANCH]
    if law.dry_stiffness > 0.0:
        branch += min(max(law.dry_stiffness * (x - state[SLIDER]), -law.dry), law.dry)
    force = _series(law, x, v, branch, state[AGE]) if given else _law(law, x, v, branch, state[AGE])
    return force if law.latched else max(force, -law.adhesion)


@njit(cache=True)
def carried(law, force, state):
    """The normal force [N] at the sensor, which is above the vibrating mass or below it."""
    if law.mode_w > 0.0 and law.mode_read:
        rate = law.mode_w * state[FRAME] + 2.0 * law.mode_zeta * state[FRAME_V]
        return law.mode_mass * law.mode_w * rate
    return force


@njit(cache=True)
def _ring(law, x0, x1, v, state, dt):
    """Runge-Kutta step of the frame's mode with the contact force."""
    q, qv = state[FRAME], state[FRAME_V]
    trial = state.copy()
    dq = dqv = 0.0
    for stage in range(4):
        part = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
        force = force_on(law, x0 + part * (x1 - x0), v, trial)
        a = force / law.mode_mass - law.mode_w * (
            law.mode_w * trial[FRAME] + 2.0 * law.mode_zeta * trial[FRAME_V]
        )
        weight = dt / 6.0 if stage in (0, 3) else dt / 3.0
        dq += weight * trial[FRAME_V]
        dqv += weight * a
        ahead = 0.5 * dt if stage < 2 else dt
        trial[FRAME], trial[FRAME_V] = q + ahead * trial[FRAME_V], qv + ahead * a
    state[FRAME], state[FRAME_V] = q + dq, qv + dqv


@njit(cache=True)
def advance_along(law, x0, x1, v, state, dt):
    """Advance the contact's `state` (STATES,) over dt in which the penetration changes from x0 to x1
    [m] at the rate v [m/s].
    """
    if law.mode_w > 0.0:
        _ring(law, x0, x1, v, state, dt)
    touching = dt
    if not law.latched:
        if x1 <= 0.0:
            state[BRANCH] = state[AGE] = state[SLIDER] = 0.0
            return
        if x0 <= 0.0:
            touching = dt * x1 / (x1 - x0)
    state[AGE] += touching
    if law.dry_stiffness > 0.0:
        reach = law.dry / law.dry_stiffness
        state[SLIDER] = min(max(state[SLIDER], x1 - reach), x1 + reach)
    if law.branch_stiffness > 0.0:
        fade = math.exp(-touching / law.branch_time)
        drive = law.branch_stiffness * v * law.branch_time
        state[BRANCH] = state[BRANCH] * fade + drive * (1.0 - fade)
