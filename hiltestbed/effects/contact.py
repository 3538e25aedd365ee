"""The force law of the contact, with everything that a real buffer or a real frame adds to k x + c v.

One run's law is a row of parameters and a row of states; the kernel serves the plant, instant by instant, and the diagnosis, over a
record. Order: the frame gives way, the touch is shifted, play is taken out, then elastic force, damping, friction, preload, hard
stop and relaxation add up, and the sum is kept from pulling. Dry friction that gives before it slips is a spring that drags a slider:
play, where there is any, lies between the port and that spring, and travels with the slider; the frame's give is not felt by it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit

from hiltestbed.effects.access import effects_of
from hiltestbed.frames import Array

(
    STIFFNESS, DAMPING, POWER_STIFFNESS, EXPONENT, ALPHA, DRY, PRELOAD, STOP, STOP_STIFFNESS, BRANCH_STIFFNESS, BRANCH_TIME,
    ADHESION, FRAME, OFFSET, CAPTURED, PLAY, MODE, MODE_DAMPING, MODE_MASS, FRICTION, TILT_X, TILT_Y, LEVER, REACTION, DRAG,
) = range(25)  # fmt: skip
PARAMETERS = 25
BRANCH, TOUCHING, DEFLECTION, DEFLECTION_RATE, SLIDER, STATES = 0, 1, 2, 3, 4, 5
SLIP_SPEED = 2e-4  # [m/s] sgn(v) is tanh(v/SLIP_SPEED)
SLIDE_SPEED = 1e-4  # [m/s] tangential friction is regularised below it
MODE_STEP = 0.05  # [rad] largest phase that the frame's mode advances in one inner step


def contact_parameters(stiffness: float, damping: float, friction: float, captured: bool, effects: Sequence[tuple[str, dict]]) -> Array:
    """(PARAMETERS,) of one contact: nominal k [N/m], c [N s/m], mu, whether the mechanism pulls as well as pushes; its effects."""
    p = np.zeros(PARAMETERS)
    p[STIFFNESS], p[DAMPING], p[FRICTION], p[CAPTURED] = stiffness, damping, friction, float(captured)
    p[ALPHA], p[STOP] = -1.0, np.inf
    p[LEVER] = 0.5
    for kind, given in effects:
        match kind:
            case "contact.stiffness":
                p[STIFFNESS] *= given["factor"]
            case "contact.damping":
                p[DAMPING] *= given["factor"]
            case "contact.power_law":
                p[EXPONENT], p[POWER_STIFFNESS] = given["exponent"], given["stiffness"]
            case "contact.hunt_crossley":
                p[ALPHA] = given["alpha"]
            case "contact.dry_friction":
                p[DRY] += given["force"]
                p[DRAG] = given.get("stiffness", 0.0)
            case "contact.preload":
                p[PRELOAD] += given["force"]
            case "contact.hard_stop":
                p[STOP], p[STOP_STIFFNESS] = given["position"], given["stiffness"]
            case "contact.relaxation":
                p[BRANCH_STIFFNESS], p[BRANCH_TIME] = given["stiffness"], given["time_constant"]
            case "contact.adhesion":
                p[ADHESION] += given["force"]
            case "contact.surface_friction":
                p[FRICTION] = given["coefficient"]
            case "contact.touch_offset":
                p[OFFSET] += given["offset"]
            case "contact.backlash":
                p[PLAY] += given["width"]
            case "contact.misalignment":
                p[TILT_X] += math.radians(given["angles_deg"][0])
                p[TILT_Y] += math.radians(given["angles_deg"][1])
            case "frame.compliance":
                p[FRAME] = given["stiffness"]
            case "frame.mode":
                p[MODE], p[MODE_DAMPING], p[MODE_MASS] = 2.0 * math.pi * given["frequency"], given["damping_ratio"], given["mass"]
    return p


@njit(cache=True)
def _law(x, v, branch, p):
    """Force [N] at penetration x [m] and rate v [m/s], Maxwell branch and slider carrying `branch` [N]; zero out of touch."""
    if p[CAPTURED] > 0.0:
        half = 0.5 * p[PLAY]
        if abs(x) <= half and half > 0.0:
            return branch if p[DRAG] > 0.0 else 0.0  # play that travels with the slider is in the branch
        x = x - half if x > 0.0 else x + half
    elif x <= 0.0:
        return 0.0
    depth = abs(x)
    elastic = p[POWER_STIFFNESS] * depth ** p[EXPONENT] if p[POWER_STIFFNESS] > 0.0 else p[STIFFNESS] * depth
    if x < 0.0:
        elastic = -elastic
    force = elastic * (1.0 + p[ALPHA] * v) if p[ALPHA] >= 0.0 else elastic + p[DAMPING] * v
    if p[DRY] != 0.0 and p[DRAG] <= 0.0:
        force += p[DRY] * math.tanh(v / SLIP_SPEED)
    if depth > p[STOP]:
        force += math.copysign(p[STOP_STIFFNESS] * (depth - p[STOP]), x)
    if p[PRELOAD] != 0.0:
        force += math.copysign(p[PRELOAD], x)
    force += branch
    if p[CAPTURED] > 0.0:
        return force
    return max(force, -p[ADHESION])


@njit(cache=True)
def _with_frame(x, v, branch, p):
    """The force with the frame's spring in series, at the rate v of the whole: the root of F = law(x - F/k_frame)."""
    rigid = _law(x, v, branch, p)
    if p[FRAME] <= 0.0 or rigid == 0.0:
        return rigid
    low, high = min(rigid, 0.0), max(rigid, 0.0)
    force = rigid
    for _ in range(60):  # the law rises with x: one root between 0 and the rigid force
        gap = _law(x - force / p[FRAME], v, branch, p) - force
        if gap > 0.0:
            low = force
        else:
            high = force
        slope = (_law(x - force / p[FRAME] + 1e-9, v, branch, p) - _law(x - force / p[FRAME], v, branch, p)) / 1e-9
        step = gap / (1.0 + max(slope, 0.0) / p[FRAME])
        force += step
        if not low <= force <= high:
            force = 0.5 * (low + high)
        if abs(step) < 1e-9 * (1.0 + abs(force)):
            break
    return force


@njit(cache=True)
def contact_force(x, v, dt, p, state):
    """The contact force [N] at an instant.

    Args:
        x: penetration [m] by geometry, v: its rate [m/s], both at the instant. dt: time since the last instant [s].
        p: (PARAMETERS,). state: (STATES,), changed in place; zero at the start.
    """
    if p[MODE] > 0.0:
        return _ringing(x, v, dt, p, state)
    return _at_rest(x - p[OFFSET], v, dt, p, state)


@njit(cache=True)
def _at_rest(x, v, dt, p, state):
    touching = x > 0.0 or p[CAPTURED] > 0.0
    if p[BRANCH_STIFFNESS] > 0.0:
        if not touching:
            state[BRANCH] = 0.0
        else:
            since = dt
            if state[TOUCHING] == 0.0 and v > 0.0 and p[CAPTURED] == 0.0:
                since = min(dt, x / v)
            fade = math.exp(-since / p[BRANCH_TIME])
            state[BRANCH] = state[BRANCH] * fade + p[BRANCH_STIFFNESS] * v * p[BRANCH_TIME] * (1.0 - fade)
    state[TOUCHING] = 1.0 if touching else 0.0
    carried = state[BRANCH]
    if p[DRAG] > 0.0:
        carried += _dragged(x, p, state) if touching else 0.0
        if not touching:
            state[SLIDER] = 0.0
    return _with_frame(x, v, carried, p)


@njit(cache=True)
def _dragged(x, p, state):
    """Friction [N] of a slider that a spring drags, through the play of a captured mechanism: within the play, stuck, or slipping."""
    half = 0.5 * p[PLAY] if p[CAPTURED] > 0.0 else 0.0
    reach = half + p[DRY] / p[DRAG]
    stretch = x - state[SLIDER]
    if abs(stretch) > reach:
        stretch = math.copysign(reach, stretch)
        state[SLIDER] = x - stretch
    return math.copysign(p[DRAG] * max(abs(stretch) - half, 0.0), stretch)


@njit(cache=True)
def _ringing(x, v, dt, p, state):
    """The frame's mode in steps of at most MODE_STEP, drift, kick, drift (second order), under the force that it feels."""
    stiffest = math.sqrt(p[MODE] ** 2 + (p[STIFFNESS] + p[STOP_STIFFNESS] + p[BRANCH_STIFFNESS]) / p[MODE_MASS])
    steps = max(1, math.ceil(stiffest * dt / MODE_STEP))
    inner = dt / steps
    for s in range(steps):
        state[DEFLECTION] += 0.5 * inner * state[DEFLECTION_RATE]
        moved = x - v * (dt - (s + 0.5) * inner)
        force = _at_rest(moved - state[DEFLECTION] - p[OFFSET], v - state[DEFLECTION_RATE], inner, p, state)
        acceleration = force / p[MODE_MASS] - p[MODE] ** 2 * state[DEFLECTION] - 2.0 * p[MODE_DAMPING] * p[MODE] * state[DEFLECTION_RATE]
        loss = 2.0 * p[MODE_DAMPING] * p[MODE] + (p[DAMPING] / p[MODE_MASS] if force != 0.0 else 0.0)
        state[DEFLECTION_RATE] += acceleration * inner / (1.0 + 0.5 * inner * loss)  # trapezoidal in the dampers: stable for any c/m
        state[DEFLECTION] += 0.5 * inner * state[DEFLECTION_RATE]
    if p[REACTION] > 0.0:
        return p[MODE_MASS] * (p[MODE] ** 2 * state[DEFLECTION] + 2.0 * p[MODE_DAMPING] * p[MODE] * state[DEFLECTION_RATE])
    return _at_rest(x - state[DEFLECTION] - p[OFFSET], v - state[DEFLECTION_RATE], 0.0, p, state)


@njit(cache=True)
def contact_normal(p, out):
    """out: (3,) the surface's normal in P, along +z when not tilted: R_y R_x e_z."""
    out[0] = math.sin(p[TILT_Y]) * math.cos(p[TILT_X])
    out[1] = -math.sin(p[TILT_X])
    out[2] = math.cos(p[TILT_Y]) * math.cos(p[TILT_X])


@njit(cache=True)
def plane_wrench(position, velocity, dt, p, normal, state, out):
    """out: (6,) the wrench of a tip on a plane through P's origin.

    Args:
        position, velocity: (3,) of the tip in P [m], [m/s]. normal: (3,). Others as for `contact_force`.
    """
    x = position[0] * normal[0] + position[1] * normal[1] + position[2] * normal[2]
    v = velocity[0] * normal[0] + velocity[1] * normal[1] + velocity[2] * normal[2]
    force = contact_force(x, v, dt, p, state)
    for j in range(3):
        out[j] = force * normal[j]
    if p[FRICTION] > 0.0:
        slide = 0.0
        for j in range(3):
            slide += (velocity[j] - v * normal[j]) ** 2
        drag = p[FRICTION] * abs(force) / math.sqrt(slide + SLIDE_SPEED**2)
        for j in range(3):
            out[j] += drag * (velocity[j] - v * normal[j])
    lift = (1.0 - p[LEVER]) * x  # the force acts between the tip and the undeformed surface
    a, b, c = position[0] - lift * normal[0], position[1] - lift * normal[1], position[2] - lift * normal[2]
    out[3] = b * out[2] - c * out[1]
    out[4] = c * out[0] - a * out[2]
    out[5] = a * out[1] - b * out[0]


@njit(cache=True)
def replay_contact(position, before, h, parts, p, out):
    """The wrench of a recorded motion: linear between rows, its rate the slope of the row interval that ends there.

    Args:
        position: (N, 3) of the tip in P at t_k. before: (3,) at t_(-1). h: tick [s].
        parts: (m,) rising, the instants within a tick as parts of it; the last is 1, which is t_k.
        out: (N, m, 6) at these instants.
    """
    state = np.zeros(STATES)
    normal, at, rate = np.empty(3), np.empty(3), np.empty(3)
    contact_normal(p, normal)
    may_skip = p[CAPTURED] == 0.0 and p[MODE] == 0.0
    x_now = before[0] * normal[0] + before[1] * normal[1] + before[2] * normal[2] - p[OFFSET]
    for k in range(position.shape[0]):
        last = before if k == 0 else position[k - 1]
        x_last = x_now
        x_now = position[k, 0] * normal[0] + position[k, 1] * normal[1] + position[k, 2] * normal[2] - p[OFFSET]
        if may_skip and x_last <= 0.0 and x_now <= 0.0:  # the way between is straight: no touch
            state[:] = 0.0
            out[k] = 0.0
            continue
        for j in range(3):
            rate[j] = (position[k, j] - last[j]) / h
        passed = 0.0
        for s in range(len(parts)):
            for j in range(3):
                at[j] = last[j] + parts[s] * (position[k, j] - last[j]) if parts[s] < 1.0 else position[k, j]
            plane_wrench(at, rate, h * (parts[s] - passed), p, normal, state, out[k, s])
            passed = parts[s]


class ContactForce:
    """The force laws of `n` runs, for a plant that asks for the normal force instant by instant.

    Attributes:
        active: whether any run departs from k x + c v. parameters: (n, PARAMETERS). state: (n, STATES).
    """

    def __init__(self, scenarios: Sequence) -> None:
        effects = [effects_of(s, "contact") for s in scenarios]
        self.active = any(effects)
        self.dt = 1.0 / scenarios[0].physics_rate
        contacts = [s.mechanism.contact for s in scenarios]
        self.parameters = np.array([
            contact_parameters(c.stiffness, c.damping, c.friction, s.mechanism.kind == "latched", e)
            for s, c, e in zip(scenarios, contacts, effects, strict=True)
        ])  # fmt: skip
        self.state = np.zeros((len(scenarios), STATES))
        self._force = np.zeros(len(scenarios))

    def force(self, x: Array, v: Array) -> Array:
        """(n,) normal force [N] from penetration x (n,) [m] and rate v (n,) [m/s]; called once a physics step."""
        _forces(x, v, self.dt, self.parameters, self.state, self._force)
        return self._force

    def buffers(self) -> dict[str, Array]:
        """The arrays that make up the state."""
        return {"state": self.state}


@njit(cache=True)
def _forces(x, v, dt, p, state, out):
    for i in range(x.shape[0]):
        out[i] = contact_force(x[i], v[i], dt, p[i], state[i])
