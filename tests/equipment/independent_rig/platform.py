"""The motion platform of this rig: its response to the command, axis by axis, on a grid of
sub-steps.

The command is linear from one tick to the next; before t = 0 it is the uniform approach,
extrapolated backwards. Effects are applied in the order delay, speed limit, lag, mode, play,
stiction, scale.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hiltestbed.compiled.jit import njit

LIMITED, LAG, LAG_V, MODE, MODE_V, PLAY, HELD, COMMAND, SLEWED, SLEWED_V = range(10)
STATES = 10
# schemes of the filters; AS_COARSE: given by `coarse`
AS_COARSE, RUNGE_KUTTA, SEMI_IMPLICIT, TRAPEZOIDAL = range(4)


class Platform(NamedTuple):
    """Deviations of the platform; zero switches one off. SI."""

    scale: np.ndarray  # (3,)
    delay: float = 0.0
    lag_w: float = 0.0  # rad/s, damping ratio 0.7
    lag_w_back: float = 0.0  # rad/s, foreign: the same for negative velocities
    mode_w: float = 0.0  # rad/s
    mode_zeta: float = 0.0
    play: float = 0.0  # m, full width
    stick: float = 0.0  # m
    speed: float = 0.0  # m/s
    quantum: float = 0.0  # m, foreign: steps of the encoder
    ripple: float = 0.0  # m, foreign: error periodic in position
    ripple_period: float = 1.0  # m
    give: float = 0.0  # m/N, foreign: compliance to the contact force
    acceleration: float = 0.0  # m/s^2, foreign: limit
    # semi-implicit Euler with the command at the end of the sub-step, instead of Runge-Kutta
    coarse: bool = False
    scheme: int = AS_COARSE


@njit(cache=True)
def command_at(node, velocity, t, h):
    """Command (3,) at `t` [s]; node (ticks + 1, 3) contains it at whole ticks, the start first."""
    if t <= 0.0:
        return node[0] + velocity * t
    k = min(int(t / h), len(node) - 2)
    part = t / h - k
    return node[k] + part * (node[k + 1] - node[k])


@njit(cache=True)
def initial(start, velocity):
    """States (3, STATES) of a platform at the start pose, moving with the approach velocity."""
    state = np.zeros((3, STATES))
    for a in range(3):
        for i in (LIMITED, LAG, MODE, PLAY, HELD, SLEWED):
            state[a, i] = start[a]
        state[a, LAG_V] = state[a, MODE_V] = state[a, SLEWED_V] = velocity[a]
    return state


@njit(cache=True)
def _oscillate(x, v, u, u_rate, dt, w, zeta, base):
    """Runge-Kutta step of x'' = w^2 (u - x) - 2 zeta w (x' - base u') with u linear over dt: the
    new x and v.
    """
    xs, vs = x, v
    dx = dv = 0.0
    for stage in range(4):
        part = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
        a = w * w * (u + part * dt * u_rate - xs) - 2.0 * zeta * w * (vs - base * u_rate)
        weight = dt / 6.0 if stage in (0, 3) else dt / 3.0
        dx += weight * vs
        dv += weight * a
        ahead = 0.5 * dt if stage < 2 else dt
        xs, vs = x + ahead * vs, v + ahead * a
    return x + dx, v + dv


@njit(cache=True)
def _trapezoid(x, v, u, u_rate, dt, w, zeta, base):
    """Trapezoidal step of the same equation."""
    loss = 2.0 * zeta * w
    now = w * w * (u - x) - loss * (v - base * u_rate)
    # at the end, without terms in the new velocity
    free = w * w * (u + dt * u_rate - x - 0.5 * dt * v) + loss * base * u_rate
    after = (v + 0.5 * dt * (now + free)) / (1.0 + 0.5 * dt * (loss + 0.5 * dt * w * w))
    return x + 0.5 * dt * (v + after), after


@njit(cache=True)
def respond(platform, x, v, u, u_rate, dt, w, zeta, base):
    """A second-order response over dt with the platform's scheme: the new x and v."""
    if platform.scheme == TRAPEZOIDAL:
        return _trapezoid(x, v, u, u_rate, dt, w, zeta, base)
    if platform.scheme == SEMI_IMPLICIT or (platform.scheme == AS_COARSE and platform.coarse):
        v += dt * (w * w * (u + dt * u_rate - x) - 2.0 * zeta * w * (v - base * u_rate))
        return x + dt * v, v
    return _oscillate(x, v, u, u_rate, dt, w, zeta, base)


@njit(cache=True)
def _slew(state, u, dt, limit):
    """An axis with an acceleration limit, at the highest speed from which it can still brake."""
    gap = u - state[SLEWED]
    wanted = math.copysign(math.sqrt(2.0 * limit * abs(gap)), gap) + state[COMMAND]
    if abs(gap) < limit * dt * dt * 4.0:
        wanted = state[COMMAND]
    change = min(max(wanted - state[SLEWED_V], -limit * dt), limit * dt)
    state[SLEWED_V] += change
    state[SLEWED] += dt * state[SLEWED_V]
    return state[SLEWED]


@njit(cache=True)
def follow(platform, state, u0, u1, dt, a):
    """Position of axis `a` after dt in which its command moves from u0 to u1."""
    rate = (u1 - u0) / dt
    if platform.acceleration > 0.0:
        state[COMMAND] = rate
        u1 = _slew(state, u1, dt, platform.acceleration)
    if platform.speed > 0.0:
        before = state[LIMITED]
        state[LIMITED] += min(max(u1 - before, -platform.speed * dt), platform.speed * dt)
        u0, u1 = before, state[LIMITED]
        rate = (u1 - u0) / dt
    if platform.lag_w > 0.0:
        before = state[LAG]
        w = platform.lag_w_back if rate < 0.0 and platform.lag_w_back > 0.0 else platform.lag_w
        state[LAG], state[LAG_V] = respond(
            platform, before, state[LAG_V], u0, rate, dt, w, 0.7, 0.0
        )
        u0, u1 = before, state[LAG]
        rate = (u1 - u0) / dt
    if platform.mode_w > 0.0:
        mode = platform.mode_w, platform.mode_zeta, 1.0
        state[MODE], state[MODE_V] = respond(
            platform, state[MODE], state[MODE_V], u0, rate, dt, *mode
        )
        u1 = state[MODE]
    if platform.play > 0.0:
        state[PLAY] = min(max(state[PLAY], u1 - 0.5 * platform.play), u1 + 0.5 * platform.play)
        u1 = state[PLAY]
    if platform.stick > 0.0:
        if abs(u1 - state[HELD]) > platform.stick:
            state[HELD] = u1
        u1 = state[HELD]
    if platform.quantum > 0.0:
        u1 = platform.quantum * math.floor(u1 / platform.quantum + 0.5)
    if platform.ripple > 0.0:
        u1 += platform.ripple * math.sin(2.0 * math.pi * u1 / platform.ripple_period)
    return platform.scale[a] * u1
