"""The platform on recorded commands."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiltestbed.compiled.jit import copied, njit
from hiltestbed.frames import Array
from hiltestbed.platform.drive import PLACE, RATE, STATE
from hiltestbed.platform.parameters import FRICTION, OFFSET, STATIC, W
from hiltestbed.platform.response import (
    HELD,
    LIMITED,
    MEMORY,
    PLAYED,
    follow,
    follow_behind,
    second_order,
)
from hiltestbed.replay.stiction import ON_AN_INSTANT, Obeying, commanded, stick_to

if TYPE_CHECKING:
    from hiltestbed.platform.parameters import PlatformParameters


class PlatformLane(NamedTuple):
    """A platform, and how each tick is divided.

    Attributes:
        start, velocity: (3,) of the approach. late: ticks from a command to the platform's answer;
            at_start: the part of it that the log adds. h: tick [s].
        parts, steps: (M,) ends of the steps as fractions of a tick, and their durations [s].
            moves: number of those that end at an instant; phase: of the instants.
        ends, long: (4,) ends of up to three groups of steps, over each of which the delayed command
            is straight, and their durations (3,) [s].
        step, speed, play, stick, eager, scale, drive: see
            :class:`~hiltestbed.platform.parameters.PlatformParameters`; eager: its ``begun``.
        w: (S,) natural frequencies of lags and modes [rad/s].
        over_step, over_group: propagators of lags and modes, (M, S, 5) each.
    """

    start: Array
    velocity: Array
    late: float
    at_start: float
    h: float
    parts: Array
    steps: Array
    moves: int
    phase: float
    ends: np.ndarray
    long: Array
    step: Array
    speed: float
    play: float
    stick: float
    eager: float
    scale: Array
    drive: Array
    w: Array
    over_step: tuple[Array, Array]
    over_group: tuple[Array, Array]


def replay_platform(
    parameters: Sequence[PlatformParameters],
    start: Array,
    substeps: Sequence[int],
    commands: Array,
    run: np.ndarray,
    obeyed: Array | None = None,
) -> Array:
    """``(L, N, 3)`` positions of A in P [m] at t_k that platforms reach on recorded commands.

    The law is that of the loop (:func:`hiltestbed.platform.response.follow`). A tick is divided at
    the kinks of the delayed command, between which the responses are exact; for a platform with
    stiction, at the instants at which it may move, unless it cannot move within the tick
    (:func:`_held_throughout`).

    Args:
        parameters, start (L, 13), substeps: of each lane, its pose and twist at t = 0, and its
            physics steps in a tick. commands: ``(R, N, >= 3)`` pose_cmd; row k is to be
            reached at t_(k+1).
        obeyed: (L,) [s] by which commands take effect later than at t_k, on a platform that is
            where its delay alone has it at t = 0.
    """
    obeyed = np.zeros(len(run)) if obeyed is None else obeyed
    out = np.empty((len(run), commands.shape[1], 3))
    for i, (p, state, m) in enumerate(zip(parameters, start, substeps, strict=True)):
        lane = _lane(p, state, m, float(obeyed[i]))
        _replay(commands[run[i]], lane, out[i])
    return out


def _lane(p: PlatformParameters, start: Array, substeps: int, obeyed: float) -> PlatformLane:
    tick = p.tick
    late = (float(p.delay) + obeyed) / tick
    bend = late - math.floor(late)
    straight = min(bend, 1.0 - bend) < ON_AN_INSTANT
    if p.stick > 0.0:
        m = p.instants or substeps
        parts = np.array([*(np.arange(1, m + 1) - p.phase) / m, *([1.0] if p.phase else [])])
    else:
        parts = np.array([1.0] if straight else [bend, 1.0])
    count = len(parts)
    ends = np.array([0, count, count, count])
    if p.stick > 0.0 and not straight:
        bent = min(int(bend * count), count - 1)  # the instants between which the command bends
        ends[1:3] = (bent, bent + 1) if bent > 0 else (1, count)
    steps, long = np.diff(parts, prepend=0.0) * tick, np.diff(ends) / count * tick
    lag, mode = (np.array(x, dtype=float).reshape(-1, 2) for x in (p.lag, p.mode))
    return PlatformLane(
        start=start[:3],
        velocity=start[7:10],
        late=late,
        at_start=obeyed / tick,
        h=tick,
        parts=parts,
        steps=steps,
        moves=count - (p.phase > 0.0),
        phase=float(p.phase),
        ends=ends,
        long=long,
        step=p.step,
        speed=float(p.speed),
        play=float(p.play),
        stick=float(p.stick),
        eager=float(p.begun),
        scale=np.array(p.scale, dtype=float),
        drive=np.array(p.drive, dtype=float),
        w=np.concatenate([lag[:, 0], mode[:, 0]]),
        over_step=_propagators(lag, mode, steps),
        over_group=_propagators(lag, mode, long),
    )


def _propagators(lag: Array, mode: Array, steps: Array) -> tuple[Array, Array]:
    """``(M, S, 5)`` exact propagators of lags and of modes, (S, 2) natural frequency and damping
    ratio, over each of the ``steps`` (M,) that takes time.
    """
    found = np.zeros((len(steps), len(lag), 5)), np.zeros((len(steps), len(mode), 5))
    for numbers, base, out in zip((lag, mode), (0.0, 1.0), found, strict=True):
        for s, (w, zeta) in enumerate(numbers):
            for m in np.flatnonzero(steps > 0.0):
                second_order(w, zeta, steps[m], base, out[m, s])
    return found


@njit(cache=True)
def _replay(commands, lane, out):
    """Write the positions (N, 3) on ``commands`` (N, >= 3)."""
    h, late, stick, learned = lane.h, lane.late, lane.stick, lane.step
    lag, mode = lane.over_step
    count = len(lane.parts)
    lagged, shaken = np.zeros((lag.shape[1], 2)), np.zeros((mode.shape[1], 2))
    memory, driven, saved = np.zeros(MEMORY), np.zeros(STATE), np.zeros((len(lane.w), 2))
    state = lagged, shaken, memory, driven
    sums = np.zeros(len(commands) + 1)
    linear = np.count_nonzero(lane.w) == 0
    for axis in range(3):
        command, driving = commands[:, axis], lane.drive[axis]
        start, velocity, scale = lane.start[axis], lane.velocity[axis], lane.scale[axis]
        plain = learned[0] == 0.0
        if plain and _still(command, start, velocity) and not _sags(driving):
            out[:, axis] = scale * start
            out[0, axis] = start
            continue
        unlimited = lane.play == 0.0 and lane.speed == np.inf and driving[W] == 0.0
        if plain and stick > 0.0 and unlimited and linear:
            held = commanded(command, start, velocity, min(lane.at_start - late, 0.0), h)
            obeying = Obeying(h, late, lane.moves, lane.phase)
            stick_to(command, held, start, velocity, obeying, stick, scale, out[:, axis])
            continue
        if not plain:
            _sum_up(command, start, h, sums)
        before = _answered(command, sums, learned, start, velocity, -late, h)
        # it starts no earlier, and does not wait for what it obeys late
        rest = -max(late - lane.at_start, 0.0)
        rest = _answered(command, sums, learned, start, velocity, rest, h)
        share = 1.0 if plain else learned[len(learned) // 2 + int(learned[0])]
        memory[:] = rest
        driven[:] = 0.0
        driven[PLACE] = lagged[:, 0] = shaken[:, 0] = rest
        driven[RATE] = share * velocity
        lagged[:, 1] = shaken[:, 1] = lane.eager * driven[RATE]
        out[0, axis] = start
        even = plain and stick > 0.0 and lane.phase == 0.0
        simple = even and np.count_nonzero(lane.w) <= 1 and driving[W] == 0.0
        for k in range(len(out) - 1):
            reached = before
            s = piece = 0
            while s < count:
                if simple and s == lane.ends[piece]:
                    end = lane.ends[piece + 1]
                    after = commanded(command, start, velocity, k + end / count - late, h)
                    if _held_throughout(before, after, lane, piece, state, saved):
                        before, reached, s = after, memory[HELD], end
                        piece += 1
                        continue
                    piece += 1
                at = k + lane.parts[s] - late
                # the usual case, separate because the other call costs as much as the rest of
                # the step
                if plain:
                    after = commanded(command, start, velocity, at, h)
                else:
                    after = _answered(command, sums, learned, start, velocity, at, h)
                # the end of a tick need not be an instant
                holds = stick if s < lane.moves or stick == 0.0 else np.inf
                own = lane.speed, lane.play, holds
                reached = follow_behind(
                    before, after, lane.steps[s], own, driving, lag[s], mode[s], state
                )
                before = after
                s += 1
            out[k + 1, axis] = scale * reached


@njit(cache=True)
def _held_throughout(before, after, lane, group, state, saved):
    """Whether a platform with stiction provably keeps its position over a group of steps, in which
    its command is straight; its state is then advanced, otherwise unchanged.

    A lag or mode of natural frequency w responds to a command of constant rate u' with y' = u' +
    z', and w^2 z^2 + z'^2 never grows: |y'| stays below L = |u'| + sqrt(w^2 z^2 + z'^2) at the
    start. Between two instants y is therefore no further from the held position than at the nearer
    one plus L h/2. A speed limit must not act meanwhile, nor play with a response that may reverse.

    ``saved``: (S, 2) scratch.
    """
    lagged, shaken, memory, _ = state
    speed, play, stick, w, h = lane.speed, lane.play, lane.stick, lane.w, lane.long[group]
    lag, mode = lane.over_group[0][group], lane.over_group[1][group]
    if speed < np.inf and (memory[LIMITED] != before or abs(after - before) > speed * h):
        return False
    rate = (after - before) / h
    fastest = abs(rate)
    position, n = before, len(lag)
    for s in range(len(w)):
        if w[s] > 0.0:
            kernel, moving = (lag[s], lagged[s]) if s < n else (mode[s - n], shaken[s - n])
            position = moving[0]
            swing = math.hypot(w[s] * (position - before + kernel[4] * rate), moving[1] - rate)
            if play > 0.0 and swing > fastest:
                return False
            fastest += swing
    margin = stick - 0.5 * fastest * h
    if play > 0.0:
        position = memory[PLAYED]
    if abs(position - memory[HELD]) > margin:
        return False
    limited, played = memory[LIMITED], memory[PLAYED]
    copied(lagged, saved[:n])
    copied(shaken, saved[n:])
    reached = follow(before, after, h, (speed, play, 0.0), lag, mode, state)
    if abs(reached - memory[HELD]) > margin:
        copied(saved[:n], lagged)
        copied(saved[n:], shaken)
        memory[LIMITED], memory[PLAYED] = limited, played
        return False
    return True


@njit(cache=True)
def _sags(drive):
    """Whether an axis moves under its load without being commanded to."""
    return drive[W] > 0.0 and abs(drive[OFFSET]) > drive[STATIC] * drive[FRICTION]


@njit(cache=True)
def _still(command, start, velocity):
    """Whether an axis is never commanded to move."""
    if velocity != 0.0:
        return False
    for k in range(len(command)):
        if command[k] != start:
            return False
    return True


@njit(cache=True)
def _sum_up(command, start, h, sums):
    """Write the time integral of the command [m s] at each tick to ``sums`` (N + 1,)."""
    sums[0], last = 0.0, start
    for k in range(len(command)):
        sums[k + 1] = sums[k] + 0.5 * h * (last + command[k])
        last = command[k]


@njit(cache=True, inline="always")
def _summed(command, sums, start, velocity, at, h):
    """The time integral of the command [m s] from the start to the tick ``at``."""
    if at <= 0.0:
        return at * h * (start + 0.5 * velocity * at * h)
    k = min(int(at), len(command))
    part = at - k
    low = start if k == 0 else command[k - 1]
    high = command[min(k, len(command) - 1)]
    return sums[k] + h * part * (low + 0.5 * part * (high - low))


@njit(cache=True)
def _answered(command, sums, step, start, velocity, at, h):
    """The command filtered by the packed ``step`` response, see
    :mod:`hiltestbed.platform.parameters`.
    """
    n, most = int(step[0]), (len(step) - 1) // 2
    if n == 0:
        return commanded(command, start, velocity, at, h)
    out = step[1 + most] * commanded(command, start, velocity, at - step[1] / h, h)
    earlier = _summed(command, sums, start, velocity, at - step[1] / h, h)
    for i in range(n - 1):
        later = _summed(command, sums, start, velocity, at - step[2 + i] / h, h)
        out += (
            (step[2 + most + i] - step[1 + most + i])
            / (step[2 + i] - step[1 + i])
            * (earlier - later)
        )
        earlier = later
    return out
