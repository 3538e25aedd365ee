"""Response of the motion platform to its command, on the three translations.

The command is linear over each tick and ends at `pose_cmd`; before the start it is the uniform
approach. It passes through, in this order, a transport delay, a learned response, a speed limit, a
drive against dry friction, second-order lags, structural modes excited at their base, play,
stiction and a scale error. Their input is linear between two instants: drives, lags and modes are
advanced exactly, so that the result does not depend on how finely a tick is divided.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array
from hiltestbed.platform.drive import PLACE, RATE, STATE, drive_over
from hiltestbed.platform.parameters import (
    PlatformParameters,
    ResponseParameters,
    W,
    longest_memory,
    stack,
    summed_over,
)

# state of an axis [m]: outputs of speed limit, play and stiction
LIMITED, PLAYED, HELD, MEMORY = 0, 1, 2, 3


@njit(cache=True)
def second_order(w, zeta, dt, base, out):
    """Exact advance of x'' = w^2 (u - x) - 2 zeta w (x' - base u') over dt, for u linear in time.

    out: (5,) e11, e12, e21, e22 of the homogeneous motion, then the steady lag behind a ramp per
        unit speed.
    base: 1 for damping on the velocity relative to the command, 0 for damping on the absolute
        velocity.
    """
    if zeta < 1.0:
        s = w * math.sqrt(max(1.0 - zeta * zeta, 1e-12))
        decay = math.exp(-zeta * w * dt)
        cosine, sine = math.cos(s * dt), math.sin(s * dt)
    else:  # critically damped at 1, two real poles beyond
        s = w * math.sqrt(max(zeta * zeta - 1.0, 1e-12))
        decay = math.exp(-zeta * w * dt)
        cosine, sine = math.cosh(s * dt), math.sinh(s * dt)
    out[0] = decay * (cosine + zeta * w / s * sine)
    out[1] = decay * sine / s
    out[2] = -decay * w * w / s * sine
    out[3] = decay * (cosine - zeta * w / s * sine)
    out[4] = 2.0 * zeta / w * (1.0 - base)


@njit(cache=True)
def _advance_second_order(e, before, after, dt, state):
    """One response over dt to an input; ``state`` (2,) position and rate, updated in place."""
    rate = (after - before) / dt
    error = state[0] - (before - e[4] * rate)
    slip = state[1] - rate
    state[0] = after - e[4] * rate + e[0] * error + e[1] * slip
    state[1] = rate + e[2] * error + e[3] * slip
    return state[0]


@njit(cache=True)
def _limited(held, before, after, dt, speed):
    """Position after dt of an axis limited to ``speed``, starting at ``held``, while its command
    runs from ``before`` to ``after``.

    It moves towards the command at the limit. Once it has met the command it follows it, at the
    limit where the command is faster.
    """
    step = speed * dt
    way = after - before
    if abs(way) > step and (before - held) * way < 0.0 and abs(before - held) < abs(way) + step:
        # fraction of dt after which it meets the command and reverses
        met = (before - held) / (math.copysign(step, before - held) - way)
        return held + math.copysign(step, way) * (1.0 - 2.0 * met)
    return held + min(max(after - held, -step), step)


@njit(cache=True)
def follow(before, after, dt, limits, lag, mode, state):
    """One axis over dt, while its (already delayed) command runs from `before` to `after` [m].

    limits: speed limit [m/s], play and stick [m]. lag, mode: (S, 5) from `second_order`; a first
        element of 0 means none. state: of lags and modes (S, 2), MEMORY (3,) and of the drive
        (STATE,), updated in place. Returns the position reached [m], before the scale error.
    """
    speed, play, stick = limits
    lagged, shaken, memory, _ = state
    if speed < np.inf:
        held = memory[LIMITED]
        memory[LIMITED] = after = _limited(held, before, after, dt, speed)
        before = held
    for s in range(lag.shape[0]):
        if lag[s, 0] != 0.0:
            held = lagged[s, 0]
            after = _advance_second_order(lag[s], before, after, dt, lagged[s])
            before = held
    for s in range(mode.shape[0]):
        if mode[s, 0] != 0.0:
            held = shaken[s, 0]
            after = _advance_second_order(mode[s], before, after, dt, shaken[s])
            before = held
    if play > 0.0:
        memory[PLAYED] = min(max(memory[PLAYED], after - 0.5 * play), after + 0.5 * play)
        after = memory[PLAYED]
    if stick > 0.0:
        if abs(after - memory[HELD]) > stick:
            memory[HELD] = after
        after = memory[HELD]
    return after


@njit(cache=True)
def follow_behind(before, after, dt, limits, drive, lag, mode, state):
    """:func:`follow`, behind a drive (NUMBERS,) where there is one.

    It is separate from :func:`follow` because drives are rare and that function is called for every
    row of every hypothesis.
    """
    speed, play, stick = limits
    if drive[W] > 0.0:
        _, _, memory, driven = state
        if speed < np.inf:
            held = memory[LIMITED]
            memory[LIMITED] = after = _limited(held, before, after, dt, speed)
            before = held
        held = driven[PLACE]
        after = drive_over(before, after, dt, drive, driven)
        before, speed = held, np.inf
    return follow(before, after, dt, (speed, play, stick), lag, mode, state)


class PlatformPaths(NamedTuple):
    """The platforms of n runs.

    Attributes:
        dt: [s] between two instants. late: (n,) delay [ticks]. numbers: their parameters. lag,
            mode: (n, S, 5) of :func:`second_order`.
        ring: (n, slots, 3) command reached at t_j in slot j modulo their number; sums: its integral
            over time up to t_j [m s].
        lagged, shaken: (n, 3, S, 2), memory: (n, 3, 3), driven: (n, 3, STATE): state of each axis.
        path: (n, m, 3) position of A in P at the m instants of the tick, the last of which is
            t_(k+1) [m].
    """

    dt: float
    late: Array
    numbers: ResponseParameters
    lag: Array
    mode: Array
    ring: Array
    sums: Array
    lagged: Array
    shaken: Array
    memory: Array
    driven: Array
    path: Array


class PlatformResponse:
    """The platforms of `n` runs: from the commanded pose to the positions within the following
    tick.

    Attributes:
        path: see :class:`PlatformPaths`. active: whether any platform alters its command; otherwise
            the path equals the command.
    """

    def __init__(
        self,
        parameters: Sequence[PlatformParameters],
        start: Array,
        substeps: int,
        active: bool = True,
    ) -> None:
        """``start`` (n, 13): pose and twist of the uniform approach. ``substeps``: instants of a
        tick.
        """
        n, self.tick, self.substeps, self.active = len(start), parameters[0].tick, substeps, active
        p, late = stack(parameters), np.array([each.delay for each in parameters]) / self.tick
        slots = math.ceil(float(late.max()) + longest_memory(p.step) / self.tick) + 3
        lags, modes = p.lag.shape[1], p.mode.shape[1]
        self._paths = paths = PlatformPaths(
            dt=self.tick / self.substeps,
            late=late,
            numbers=p,
            lag=np.zeros((n, lags, 5)),
            mode=np.zeros((n, modes, 5)),
            ring=np.zeros((n, slots, 3)),
            sums=np.zeros((n, slots, 3)),
            lagged=np.zeros((n, 3, lags, 2)),
            shaken=np.zeros((n, 3, modes, 2)),
            memory=np.zeros((n, 3, MEMORY)),
            driven=np.zeros((n, 3, STATE)),
            path=np.zeros((n, self.substeps, 3)),
        )
        self.path = paths.path
        for kernel, numbers, base in ((paths.lag, p.lag, 0.0), (paths.mode, p.mode, 1.0)):
            for i, s in np.argwhere(numbers[..., 0] > 0.0):
                second_order(*numbers[i, s], paths.dt, base, kernel[i, s])
        self._advance = Call(_advance_paths, ..., GIVEN, paths)
        for i, state in enumerate(start):
            self.begin(i, state[:3], state[7:10])

    def begin(self, i: int, start: Array, velocity: Array) -> None:
        """Start run ``i`` in a uniform motion: ``start`` (3,) [m], ``velocity`` (3,) [m/s]."""
        paths, p, slots = self._paths, self._paths.numbers, self._paths.ring.shape[1]
        for back in range(slots):
            paths.ring[i, -back % slots] = start - velocity * self.tick * back
            paths.sums[i, -back % slots] = (
                self.tick * back * (0.5 * velocity * self.tick * back - start)
            )
        there, moving = summed_over(p.step[i], start - velocity * p.delay[i], velocity)
        paths.memory[i] = there[:, None]
        paths.driven[i] = 0.0
        paths.driven[i, :, PLACE], paths.driven[i, :, RATE] = there, moving
        paths.lagged[i, ..., 0] = paths.shaken[i, ..., 0] = there[:, None]
        paths.lagged[i, ..., 1] = paths.shaken[i, ..., 1] = p.begun[i] * moving[:, None]

    def advance(self, k: int, pose_cmd: Array) -> Array:
        """The path (n, m, 3) from t_k to t_(k+1), for the commanded pose (n, 7) of t_(k+1)."""
        self._advance.on(pose_cmd)(k)
        return self.path


@njit(cache=True)
def ring_at(ring, axis, at):
    """The command at the (fractional) tick ``at``, linear between ticks."""
    first = math.floor(at)
    part = at - first
    low = ring[int(first) % ring.shape[0], axis]
    if part == 0.0:
        return low
    return low + part * (ring[int(first + 1) % ring.shape[0], axis] - low)


@njit(cache=True)
def _sum_at(ring, sums, axis, at, h):
    """The integral of the command over time up to the (fractional) tick ``at`` [m s]."""
    first = math.floor(at)
    part = at - first
    slot, after = int(first) % ring.shape[0], int(first + 1) % ring.shape[0]
    low = ring[slot, axis]
    if part == 0.0:
        return sums[slot, axis]
    return sums[slot, axis] + h * part * (low + 0.5 * part * (ring[after, axis] - low))


@njit(cache=True)
def _answered(ring, sums, step, axis, at, h):
    """Output of the packed ``step`` response at the (fractional) tick ``at``; exact."""
    n, most = int(step[0]), (len(step) - 1) // 2
    if n == 0:
        return ring_at(ring, axis, at)
    out = step[1 + most] * ring_at(ring, axis, at - step[1] / h)
    earlier = _sum_at(ring, sums, axis, at - step[1] / h, h)
    for i in range(n - 1):
        later = _sum_at(ring, sums, axis, at - step[2 + i] / h, h)
        out += (
            (step[2 + most + i] - step[1 + most + i])
            / (step[2 + i] - step[1 + i])
            * (earlier - later)
        )
        earlier = later
    return out


@njit(cache=True)
def _advance_paths(k, pose_cmd, paths):
    """Write the paths of one tick from t_k, for the commands ``pose_cmd`` (n, >= 3)."""
    p, dt, path = paths.numbers, paths.dt, paths.path
    substeps = path.shape[1]
    h = substeps * dt
    for i in range(path.shape[0]):
        ring, sums, late, slots = paths.ring[i], paths.sums[i], paths.late[i], paths.ring.shape[1]
        limits = p.speed[i], p.play[i], p.stick[i]
        for axis in range(3):
            ring[(k + 1) % slots, axis] = pose_cmd[i, axis]
            now, last = (k + 1) % slots, k % slots
            sums[now, axis] = sums[last, axis] + 0.5 * substeps * dt * (
                ring[last, axis] + ring[now, axis]
            )
            state = (
                paths.lagged[i, axis],
                paths.shaken[i, axis],
                paths.memory[i, axis],
                paths.driven[i, axis],
            )
            before = _answered(ring, sums, p.step[i], axis, k - late, h)
            for s in range(substeps):
                at = k + (s + 1.0) / substeps - late
                after = _answered(ring, sums, p.step[i], axis, at, h)
                reached = follow_behind(
                    before, after, dt, limits, p.drive[i, axis], paths.lag[i], paths.mode[i], state
                )
                path[i, s, axis] = p.scale[i, axis] * reached
                before = after
