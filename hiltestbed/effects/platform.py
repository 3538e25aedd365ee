"""What the motion platform makes of its command, on the three translations.

The command runs linearly over each tick to `pose_cmd`; before the start it is the uniform approach. It passes, in this order, a
transport delay, a speed limit, a second-order lag, a structural mode shaken at its base, play, stiction and a scale error. Lag and
mode are linear, and their input is linear between two instants: they are advanced exactly, so that the result does not depend on
how finely a tick is divided.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit

from hiltestbed.effects.access import effects_of
from hiltestbed.effects.vocabulary import AXES
from hiltestbed.frames import Array

DELAY, SPEED, LAG, MODE, MODE_DAMPING, PLAY, STICK, SCALE = 0, 1, 2, 3, 4, 5, 6, 7  # SCALE: three columns
PARAMETERS = 10
LAG_DAMPING = 0.7
LIMITED, LAGGED, LAGGED_RATE, SHAKEN, SHAKEN_RATE, PLAYED, HELD, STATES = 0, 1, 2, 3, 4, 5, 6, 7


def platform_parameters(effects: Sequence[tuple[str, dict]]) -> Array:
    """(PARAMETERS,) of one platform: delay [s], speed limit [m/s], lag and mode [rad/s], damping ratio, play and stick [m], scales."""
    p = np.zeros(PARAMETERS)
    p[SPEED] = np.inf
    p[SCALE:] = 1.0
    for kind, given in effects:
        match kind:
            case "platform.delay":
                p[DELAY] += given["delay"]
            case "platform.speed_limit":
                p[SPEED] = min(p[SPEED], given["speed"])
            case "platform.lag":
                p[LAG] = 2.0 * math.pi * given["bandwidth"]
            case "platform.mode":
                p[MODE], p[MODE_DAMPING] = 2.0 * math.pi * given["frequency"], given["damping_ratio"]
            case "platform.backlash":
                p[PLAY] += given["width"]
            case "platform.friction":
                p[STICK] += given["stick"]
            case "platform.scale":
                p[SCALE + AXES.index(given["axis"])] *= given["factor"]
    return p


@njit(cache=True)
def second_order(w, zeta, dt, base, out):
    """Exact advance of x'' = w^2 (u - x) - 2 zeta w (x' - base u') over dt, for u linear in time.

    out: (6,) e11, e12, e21, e22 of the homogeneous motion, then the steady lag behind a ramp per unit speed, 0.
    base: 1 for damping on the velocity relative to the command, 0 for damping on the absolute velocity.
    """
    s = w * math.sqrt(max(1.0 - zeta * zeta, 1e-12))
    decay = math.exp(-zeta * w * dt)
    cosine, sine = math.cos(s * dt), math.sin(s * dt)
    out[0] = decay * (cosine + zeta * w / s * sine)
    out[1] = decay * sine / s
    out[2] = -decay * w * w / s * sine
    out[3] = decay * (cosine - zeta * w / s * sine)
    out[4] = 2.0 * zeta / w * (1.0 - base)
    out[5] = 0.0


@njit(cache=True)
def _advance_second_order(e, before, after, dt, state, position):
    rate = (after - before) / dt
    error = state[position] - (before - e[4] * rate)
    slip = state[position + 1] - rate
    state[position] = after - e[4] * rate + e[0] * error + e[1] * slip
    state[position + 1] = rate + e[2] * error + e[3] * slip
    return state[position]


@njit(cache=True)
def start_axis(position, speed, p, state):
    """Put the state (STATES,) of one axis on the approach at t = 0."""
    for i in range(STATES):
        state[i] = position
    state[LAGGED_RATE] = speed
    state[SHAKEN_RATE] = speed


@njit(cache=True)
def follow(before, after, dt, p, scale, lag, mode, state):
    """One axis over dt, the (already delayed) command running from `before` to `after` [m].

    lag, mode: (6,) from `second_order`. state: (STATES,), changed in place. Returns the position reached [m].
    """
    if p[SPEED] < np.inf:
        held = state[LIMITED]
        step = p[SPEED] * dt
        state[LIMITED] = held + min(max(after - held, -step), step)
        before, after = held, state[LIMITED]
    if p[LAG] > 0.0:
        held = state[LAGGED]
        after = _advance_second_order(lag, before, after, dt, state, LAGGED)
        before = held
    if p[MODE] > 0.0:
        after = _advance_second_order(mode, before, after, dt, state, SHAKEN)
    if p[PLAY] > 0.0:
        state[PLAYED] = min(max(state[PLAYED], after - 0.5 * p[PLAY]), after + 0.5 * p[PLAY])
        after = state[PLAYED]
    if p[STICK] > 0.0:
        if abs(after - state[HELD]) > p[STICK]:
            state[HELD] = after
        after = state[HELD]
    return scale * after


@njit(cache=True)
def commanded(command, start, velocity, axis, k, part, h):
    """The command on one axis at t_k + part h: linear over each tick, the uniform approach before t = 0.

    command: (N, >= 3), row j reached at t_(j+1).
    """
    whole = math.floor(part)
    k += int(whole)
    part -= whole
    if k < 0:
        return start[axis] + velocity[axis] * (k + part) * h
    low = start[axis] if k == 0 else command[k - 1, axis]
    if part == 0.0:
        return low
    return low + part * (command[k, axis] - low)


@njit(cache=True)
def replay_platform(command, start, velocity, h, substeps, p, out, wanted=(True, True, True)):
    """The positions that a platform reaches on a recorded command.

    Args:
        command: (N, >= 3) pose_cmd; row k is to be reached at t_(k+1). start: (3,) at t = 0. velocity: (3,) approach [m/s].
        h: tick [s]. substeps: instants a tick. p: (PARAMETERS,).
        out: (N, 3) position at t_k. wanted: whether each axis is asked for; one that is not stays at its start.
    """
    n = command.shape[0]
    dt = h / substeps
    lag, mode = np.zeros(6), np.zeros(6)
    if p[LAG] > 0.0:
        second_order(p[LAG], LAG_DAMPING, dt, 0.0, lag)
    if p[MODE] > 0.0:
        second_order(p[MODE], p[MODE_DAMPING], dt, 1.0, mode)
    late = p[DELAY] / h
    state = np.empty(STATES)
    for axis in range(3):
        if not wanted[axis]:
            out[:, axis] = start[axis]
            continue
        start_axis(start[axis], velocity[axis], p, state)
        out[0, axis] = start[axis]
        before = commanded(command, start, velocity, axis, 0, -late, h)
        if late > 0.0:  # what lies behind the delay starts where the delayed command is
            start_axis(before, velocity[axis], p, state)
            out[0, axis] = before
        for k in range(n - 1):
            for s in range(substeps):
                after = commanded(command, start, velocity, axis, k, (s + 1.0) / substeps - late, h)
                reached = follow(before, after, dt, p, p[SCALE + axis], lag, mode, state)
                before = after
            out[k + 1, axis] = reached


class PlatformPath:
    """The platforms of `n` runs: from the commanded pose to the positions within the tick that follows.

    Attributes:
        path: (n, m, 3) position of A in P at the m instants of the tick, the last of which is t_(k+1) [m].
        active: whether any run carries a platform effect; without one the path is the command's own.
    """

    def __init__(self, scenarios: Sequence) -> None:
        n, first = len(scenarios), scenarios[0]
        self.substeps = first.substeps
        self.tick = 1.0 / first.rate
        effects = [effects_of(s, "platform") for s in scenarios]
        self.active = any(effects)
        self.parameters = np.array([platform_parameters(e) for e in effects])
        self._late = self.parameters[:, DELAY] / self.tick
        self.path = np.zeros((n, self.substeps, 3))
        self.ring = np.zeros((n, math.ceil(float(self._late.max())) + 3, 3))  # command reached at t_j in slot j modulo its length
        self.state = np.zeros((n, 3, STATES))
        self._kernel = np.zeros((n, 2, 6))
        dt = self.tick / self.substeps
        for i, (p, s) in enumerate(zip(self.parameters, scenarios, strict=True)):
            self.begin(i, np.array([*s.approach.offset, -s.approach.gap]), np.asarray(s.approach.velocity, dtype=float))
            if p[LAG] > 0.0:
                second_order(p[LAG], LAG_DAMPING, dt, 0.0, self._kernel[i, 0])
            if p[MODE] > 0.0:
                second_order(p[MODE], p[MODE_DAMPING], dt, 1.0, self._kernel[i, 1])

    def begin(self, i: int, start: Array, velocity: Array) -> None:
        """Put the platform of run ``i`` on a uniform motion that is at ``start`` (3,) [m] with ``velocity`` (3,) [m/s] at t = 0."""
        for back in range(self.ring.shape[1]):
            self.ring[i, -back % self.ring.shape[1]] = start - velocity * self.tick * back
        p = self.parameters[i]
        for axis in range(3):
            start_axis(start[axis] - velocity[axis] * p[DELAY], velocity[axis], p, self.state[i, axis])

    def advance(self, k: int, pose_cmd: Array) -> Array:
        """The path (n, m, 3) from t_k to t_(k+1) on the command (n, 7) to be reached at t_(k+1)."""
        _advance_paths(k, pose_cmd, self.ring, self._late, self.tick / self.substeps, self.parameters, self._kernel, self.state, self.path)
        return self.path

    def buffers(self) -> dict[str, Array]:
        """The arrays that make up the state."""
        return {"ring": self.ring, "state": self.state}


@njit(cache=True)
def _ring_at(ring, axis, at):
    first = math.floor(at)
    part = at - first
    low = ring[int(first) % ring.shape[0], axis]
    if part == 0.0:
        return low
    return low + part * (ring[int(first + 1) % ring.shape[0], axis] - low)


@njit(cache=True)
def _advance_paths(k, pose_cmd, ring, late, dt, parameters, kernel, state, path):
    substeps = path.shape[1]
    for i in range(path.shape[0]):
        for axis in range(3):
            ring[i, (k + 1) % ring.shape[1], axis] = pose_cmd[i, axis]
            before = _ring_at(ring[i], axis, k - late[i])
            for s in range(substeps):
                after = _ring_at(ring[i], axis, k + (s + 1.0) / substeps - late[i])
                path[i, s, axis] = follow(
                    before, after, dt, parameters[i], parameters[i, SCALE + axis], kernel[i, 0], kernel[i, 1], state[i, axis]
                )
                before = after
