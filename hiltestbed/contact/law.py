"""The force law of the contact: k x + c v and everything that a real buffer or frame adds to it.

One contact's law is a row of parameters (:mod:`hiltestbed.contact.parameters`) and a row of states.
Order: the frame deflects, the touch offset and the play are subtracted, then elastic force,
damping, friction, preload, hard stop and relaxation are summed, and the sum is limited to pushing.
Elastic dry friction is a spring in series with a slider: any play lies between the port and that
spring, and moves with the slider; the frame's deflection does not act on it. Learned curves are
added: over the penetration beyond the play, over the rate, and over the stretch of a slider of
their own, on which play does not act; others change the elastic force by a fraction that depends on
penetration and rate.

Ledger, stability, the truth of an identification and warnings take one stiffness and one damping
with which a contact acts, effects included. A linear law has them; the frame's compliance is in
series. Any other law gets those of its describing function (N. Krylov, N. Bogoliubov, Introduction
to Non-Linear Mechanics, 1943): the spring and damper with the same force in phase with penetration
and rate, over the half sine x = X sin(w t) of a head-on bounce, w^2 = k/m and X = v/w.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.config.piecewise import PACKED, along, between, steepest
from hiltestbed.contact import parameters as cp
from hiltestbed.contact.parameters import ContactParameters

BRANCH, TOUCHING, DEFLECTION, DEFLECTION_RATE, SLIDER, LEARNED_SLIDER, STATES = 0, 1, 2, 3, 4, 5, 6
SLIP_SPEED = 2e-4  # [m/s] sgn(v) is tanh(v/SLIP_SPEED)
MODE_STEP = 0.05  # [rad] largest phase advance of the frame's mode in one inner step


@njit(cache=True)
def _law(x, v, branch, p, held):
    """Force [N]; `branch` [N]: of Maxwell branch and sliders; `held`: it may pull."""
    if held:
        half = 0.5 * p[cp.PLAY]
        if abs(x) <= half and half > 0.0:
            # play that moves with the slider is already in branch
            return branch if p[cp.DRAG] > 0.0 or p[cp.OVER_STRETCH] > 0.0 else 0.0
        x = x - half if x > 0.0 else x + half
    elif x <= 0.0:
        return 0.0
    depth = abs(x)
    elastic = (
        p[cp.POWER_STIFFNESS] * depth ** p[cp.EXPONENT]
        if p[cp.POWER_STIFFNESS] > 0.0
        else p[cp.STIFFNESS] * depth
    )
    if x < 0.0:
        elastic = -elastic
    if p[cp.SPRING_OVER_PENETRATION] > 0.0 or p[cp.SPRING_OVER_RATE] > 0.0:
        deep = between(p[cp.SPRING_OVER_PENETRATION : cp.SPRING_OVER_PENETRATION + PACKED], x)
        elastic *= 1.0 + (deep + between(p[cp.SPRING_OVER_RATE : cp.SPRING_OVER_RATE + PACKED], v))
    slope = abs(elastic) * p[cp.ALPHA] if p[cp.ALPHA] >= 0.0 else p[cp.DAMPING]
    force = elastic + slope * v
    if p[cp.DRY] != 0.0 and p[cp.DRAG] <= 0.0:
        force += p[cp.DRY] * math.tanh(v / SLIP_SPEED)
    if depth > p[cp.STOP]:
        force += math.copysign(p[cp.STOP_STIFFNESS] * (depth - p[cp.STOP]), x)
    if p[cp.PRELOAD] != 0.0:
        force += math.copysign(p[cp.PRELOAD], x)
    if p[cp.OVER_PENETRATION] > 0.0:
        force += along(p[cp.OVER_PENETRATION : cp.OVER_PENETRATION + PACKED], x)
    if p[cp.OVER_RATE] > 0.0:
        force += along(p[cp.OVER_RATE : cp.OVER_RATE + PACKED], v)
    force += branch
    if held:
        return force
    return max(force, -p[cp.ADHESION])


@njit(cache=True)
def contact_force(x, v, dt, p, state, held):
    """The contact force [N] at an instant.

    Args:
        x: geometric penetration [m], v: its rate [m/s], both at the instant. dt: time since the
            last instant [s].
        p: (PARAMETERS,). state: (STATES,), changed in place; zero at the start. held: whether the
            mechanism pulls as well as pushes.
    """
    memory = (state[BRANCH], state[TOUCHING], state[SLIDER], state[LEARNED_SLIDER])
    if p[cp.MODE] <= 0.0:
        force, memory = _at_rest(x - p[cp.OFFSET], v, dt, p, memory, held)
    else:
        # the frame's mode, in steps of at most MODE_STEP: drift-kick-drift (second order)
        w, zeta, mass = p[cp.MODE], p[cp.MODE_DAMPING], p[cp.MODE_MASS]
        q, rate = state[DEFLECTION], state[DEFLECTION_RATE]
        springs = p[cp.STIFFNESS] + p[cp.STOP_STIFFNESS] + p[cp.BRANCH_STIFFNESS]
        springs += steepest(p[cp.OVER_PENETRATION : cp.OVER_PENETRATION + PACKED]) + steepest(
            p[cp.OVER_STRETCH : cp.OVER_STRETCH + PACKED]
        )
        stiffest = math.sqrt(w**2 + springs / mass)
        steps = max(1, math.ceil(stiffest * dt / MODE_STEP))
        inner = dt / steps
        for s in range(steps):
            q += 0.5 * inner * rate
            moved = x - v * (dt - (s + 0.5) * inner)
            force, memory = _at_rest(moved - q - p[cp.OFFSET], v - rate, inner, p, memory, held)
            acceleration = force / mass - w**2 * q - 2.0 * zeta * w * rate
            loss = 2.0 * zeta * w + (p[cp.DAMPING] / mass if force != 0.0 else 0.0)
            # trapezoidal in the dampers: stable for any c/m
            rate += acceleration * inner / (1.0 + 0.5 * inner * loss)
            q += 0.5 * inner * rate
        if p[cp.REACTION] > 0.0:
            force = mass * (w**2 * q + 2.0 * zeta * w * rate)
        else:
            force, memory = _at_rest(x - q - p[cp.OFFSET], v - rate, 0.0, p, memory, held)
        state[DEFLECTION], state[DEFLECTION_RATE] = q, rate
    state[BRANCH], state[TOUCHING], state[SLIDER], state[LEARNED_SLIDER] = memory
    return force


@njit(cache=True)
def _at_rest(x, v, dt, p, memory, held):
    """The force without the frame's mode, and the new memory: force of the Maxwell branch, whether
    it touches, both sliders; by value, since the mode takes many steps an instant.
    """
    branch, touched, slider, learned_slider = memory
    touching = x > 0.0 or held
    if p[cp.BRANCH_STIFFNESS] > 0.0:
        if not touching:
            branch = 0.0
        else:
            since = dt
            if touched == 0.0 and v > 0.0 and not held:
                since = min(dt, x / v)
            fade = math.exp(-since / p[cp.BRANCH_TIME])
            branch = branch * fade + p[cp.BRANCH_STIFFNESS] * v * p[cp.BRANCH_TIME] * (1.0 - fade)
    carried = branch
    if p[cp.DRAG] > 0.0:
        if touching:  # a slider behind a spring and any play: within it, sticking, or slipping
            half = 0.5 * p[cp.PLAY] if held else 0.0
            reach = half + p[cp.DRY] / p[cp.DRAG]
            stretch = x - slider
            if abs(stretch) > reach:
                stretch = math.copysign(reach, stretch)
                slider = x - stretch
            carried += math.copysign(p[cp.DRAG] * max(abs(stretch) - half, 0.0), stretch)
        else:
            slider = 0.0
    if p[cp.OVER_STRETCH] > 0.0:
        if touching:  # a slider that sticks until the stretch would leave the curve's range
            curve = p[cp.OVER_STRETCH : cp.OVER_STRETCH + PACKED]
            stretch = min(max(x - learned_slider, curve[1]), curve[int(curve[0])])
            learned_slider = x - stretch
            carried += along(curve, stretch)
        else:
            learned_slider = 0.0
    rigid = _law(x, v, carried, p, held)
    force = rigid
    if p[cp.FRAME] > 0.0 and rigid != 0.0:  # with its spring in series: F = law(x - F/k_frame)
        low, high = min(rigid, 0.0), max(rigid, 0.0)
        for _ in range(60):  # the law increases with x: one root between 0 and the rigid force
            gap = _law(x - force / p[cp.FRAME], v, carried, p, held) - force
            if gap > 0.0:
                low = force
            else:
                high = force
            slope = (
                _law(x - force / p[cp.FRAME] + 1e-9, v, carried, p, held)
                - _law(x - force / p[cp.FRAME], v, carried, p, held)
            ) / 1e-9
            step = gap / (1.0 + max(slope, 0.0) / p[cp.FRAME])
            force += step
            if not low <= force <= high:
                force = 0.5 * (low + high)
            if abs(step) < 1e-9 * (1.0 + abs(force)):
                break
    return force, (branch, 1.0 if touching else 0.0, slider, learned_slider)


@njit(cache=True)
def touches(depth, push, p):
    """Whether surfaces touch at a ``depth`` [m] with a force ``push`` [N]; a frame whose reaction
    is read rings on when they have parted.
    """
    return depth > p[cp.OFFSET] or (push != 0.0 and p[cp.REACTION] == 0.0)


Pair = tuple[float, float]
PHASES = 400  # of the half sine: midpoints, error of order 1/PHASES^2
ROUNDS, SAME = 60, 1e-9  # of the iteration for w; relative change at which it has converged


def in_series(first: Pair, second: Pair) -> Pair:
    """Of two springs with dampers in series, at frequencies well below k/c."""
    (k1, c1), (k2, c2) = first, second
    total = k1 + k2
    return k1 * k2 / total, (c1 * k2 * k2 + c2 * k1 * k1) / (total * total)


def linear_law(law: ContactParameters) -> Pair | None:
    """Stiffness [N/m], damping [N s/m] of a linear law, frame included; None if not linear."""
    neutral = ContactParameters(1.0)
    if any(getattr(law, name) != getattr(neutral, name) for name in cp.NON_LINEAR):
        return None
    if any(getattr(law, name)[0] > 0.0 for name in cp.CURVES):
        return None
    own = (float(law.stiffness), float(law.damping))
    if law.frame <= 0.0:
        return own
    # the frame deflects under the force at the rate of the whole: F = k (x - F/k_frame) + c v
    share = float(law.frame) / (law.stiffness + law.frame)
    return own[0] * share, own[1] * share


def acting_law(law: ContactParameters, mass: float, speed: float) -> Pair:
    """Stiffness [N/m], damping [N s/m] in a head-on bounce of ``mass`` [kg] at ``speed`` [m/s]."""
    linear = linear_law(law)
    found = linear or (float(law.stiffness), float(law.damping))
    if linear is not None or speed <= 0.0:
        return found
    row, phase = replace(law, offset=0.0).row(), (np.arange(PHASES) + 0.5) * math.pi / PHASES
    for _ in range(ROUNDS):
        w = math.sqrt(found[0] / mass)
        size, state, dt = speed / w, np.zeros(STATES), phase[0] * 2.0 / w
        motion = [(size * math.sin(a), speed * math.cos(a)) for a in phase]
        force = np.array([contact_force(x, v, dt, row, state, True) for x, v in motion])
        half = 0.5 * PHASES  # the sum of sin^2, and of cos^2
        before = found
        found = (
            max(float(force @ np.sin(phase)) / (size * half), SAME * found[0]),
            float(force @ np.cos(phase)) / (speed * half),
        )
        if abs(found[0] - before[0]) <= SAME * found[0]:
            break
    return found
