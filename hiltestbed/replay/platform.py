"""The platform on recorded commands."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array
from hiltestbed.platform.drive import FRICTION, OFFSET, PLACE, RATE, STATE, STATIC, W
from hiltestbed.platform.parameters import stack
from hiltestbed.platform.response import (
    HELD,
    LIMITED,
    MEMORY,
    PLAYED,
    behind_drive,
    follow,
    second_order,
)
from hiltestbed.replay.stiction import Obeying, commanded, stick_to

if TYPE_CHECKING:
    from hiltestbed.platform.parameters import PlatformParameters
    from hiltestbed.scenario import Scenario

WHOLE = 1e-9  # ticks within which a delay counts as a whole number


class Lanes(NamedTuple):
    """What :func:`_replay` is given of L lanes, of which each replays a ``run``.

    Attributes:
        start, velocity: (L, 3) of the approach. late: (L,) ticks from a command to the platform's
            answer; at_start: the part of it that the log adds.
        parts, steps: (L, M) ends of the steps as fractions of a tick, and their durations [s];
            count: (L,) their number; moves: (L,) those that end at an instant; phase: (L,) of the
            instants.
        step, speed, play, stick, scale, drive: see
            :class:`~hiltestbed.platform.parameters.PlatformParameters`.
        lag, mode: (L, M, S, 5) propagators over each step; lag_long, mode_long: over the groups of
            steps that end at ``ends`` (L, 4), of the durations ``long`` (L, 3) [s]; lag_first,
            mode_first: over ``begun`` (L,) [s], by which the log is early. w: (L, S) [rad/s].
        eager: (L,) whether responses start with the approach's rate.
    """

    run: np.ndarray
    start: Array
    velocity: Array
    late: Array
    at_start: Array
    parts: Array
    count: np.ndarray
    steps: Array
    step: Array
    speed: Array
    play: Array
    stick: Array
    scale: Array
    drive: Array
    lag: Array
    mode: Array
    ends: np.ndarray
    long: Array
    lag_long: Array
    mode_long: Array
    w: Array
    begun: Array
    lag_first: Array
    mode_first: Array
    moves: np.ndarray
    phase: Array
    eager: Array


def replay_platform(
    scenarios: Sequence[Scenario],
    parameters: Sequence[PlatformParameters],
    commands: Array,
    run: np.ndarray,
    obeyed: Array | None = None,
    early: Array | None = None,
) -> Array:
    """``(L, N, 3)`` positions of A in P [m] at t_k that platforms reach on recorded commands.

    The law is that of the loop (:func:`hiltestbed.platform.response.follow`). A tick is divided at
    the kinks of the delayed command, between which the responses are exact; for a platform with
    stiction, at the instants at which it may move, unless it cannot move within the tick
    (:func:`_held_throughout`).

    Args:
        scenarios, parameters: of each lane. commands: ``(R, N, >= 3)`` pose_cmd; row k is to be
            reached at t_(k+1).
        obeyed: (L,) [s] by which commands take effect later than at t_k, on a platform that is
            where its delay alone has it at t = 0.
        early: (L,) [s], not negative, by which commands are on record earlier than they were given:
            at t = 0 the platform has approached for as long.
    """
    tick = scenarios[0].tick
    p = stack(parameters)
    at_start = np.zeros(len(run)) if obeyed is None else np.asarray(obeyed, dtype=float)
    late = (p.delay + at_start) / tick
    parts, count = _instants(scenarios, parameters, late)
    phase = np.array([q.phase for q in parameters])
    moves = count - (phase > 0.0)
    steps = np.diff(parts, axis=1, prepend=0.0) * tick
    lag, mode = _kernels(p.lag, steps, count, 0.0), _kernels(p.mode, steps, count, 1.0)
    ends, w = (
        _straight(p.stick, late, count),
        np.concatenate([p.lag[..., 0], p.mode[..., 0]], axis=1),
    )
    long = np.diff(ends, axis=1) / count[:, None] * tick
    lag_long, mode_long = (
        _kernels(x, long, (long > 0.0).sum(axis=1), base)
        for x, base in ((p.lag, 0.0), (p.mode, 1.0))
    )
    start = np.array([[*s.approach.offset, -s.approach.gap] for s in scenarios])
    velocity = np.array([s.approach.velocity for s in scenarios], dtype=float)
    begun = np.zeros(len(run)) if early is None else np.asarray(early, dtype=float)
    start += begun[:, None] * velocity
    once = (begun > 0.0).astype(int)
    lag_first, mode_first = (
        _kernels(x, begun[:, None], once, base) for x, base in ((p.lag, 0.0), (p.mode, 1.0))
    )
    out = np.empty((len(run), commands.shape[1], 3))
    lanes = Lanes(
        np.asarray(run),
        start,
        velocity,
        late,
        at_start / tick,
        parts,
        count,
        steps,
        p.step,
        p.speed,
        p.play,
        p.stick,
        p.scale,
        p.drive,
        lag,
        mode,
        ends,
        long,
        lag_long,
        mode_long,
        w,
        begun,
        lag_first,
        mode_first,
        moves,
        phase,
        p.begun,
    )
    _replay(commands, tick, lanes, out)
    return out


def _instants(
    scenarios: Sequence[Scenario], parameters: Sequence[PlatformParameters], late: Array
) -> tuple[Array, np.ndarray]:
    """``(L, M)`` fractions of a tick to which each lane is advanced, the last of which is 1, and
    ``(L,)`` their number.
    """
    found = []
    for s, p, ticks in zip(scenarios, parameters, late, strict=True):
        bend = ticks - np.floor(ticks)
        if p.stick > 0.0:
            m = p.instants or s.substeps
            found.append(
                np.array([*(np.arange(1, m + 1) - p.phase) / m, *([1.0] if p.phase else [])])
            )
        else:
            found.append(
                np.array([1.0]) if min(bend, 1.0 - bend) < WHOLE else np.array([bend, 1.0])
            )
    count = np.array([len(f) for f in found])
    parts = np.ones((len(found), int(count.max())))
    for i, f in enumerate(found):
        parts[i, : len(f)] = f
    return parts, count


def _straight(stick: Array, late: Array, count: np.ndarray) -> np.ndarray:
    """``(L, 4)`` ends of up to three groups of instants, for lanes with stiction: the delayed
    command is straight over each group.
    """
    bend = late - np.floor(late)
    within = (stick > 0.0) & (np.minimum(bend, 1.0 - bend) >= WHOLE)
    # the instants between which the command bends
    bent = np.minimum(np.floor(bend * count).astype(int), count - 1)
    ends = np.tile(count[:, None], (1, 4))
    ends[:, 0] = 0
    ends[within, 1] = np.where(bent > 0, bent, 1)[within]
    ends[within, 2] = np.where(bent > 0, bent + 1, count)[within]
    return ends


def _kernels(numbers: Array, steps: Array, count: np.ndarray, base: float) -> Array:
    """``(L, M, S, 5)`` exact propagators of each response over each step; ``numbers`` (L, S, 2)
    natural frequency and damping ratio.
    """
    out = np.zeros((len(numbers), steps.shape[1], numbers.shape[1], 5))
    for i, s in np.argwhere(numbers[..., 0] > 0.0):
        for m in range(count[i]):
            second_order(numbers[i, s, 0], numbers[i, s, 1], steps[i, m], base, out[i, m, s])
    return out


@njit(cache=True)
def _replay(commands, h, lanes, out):
    run, start, velocity, late, at_start = lanes[:5]
    parts, count, steps, response, speed, play, stick, scale, drive, lag, mode = lanes[5:16]
    ends, long, lag_long, mode_long, w, begun, lag_first, mode_first = lanes[16:24]
    moves, phase, eager = lanes[24:]
    driven = np.zeros(STATE)
    saved = np.zeros((len(w[0]), 2))
    lagged, shaken, memory = (
        np.zeros((lag.shape[2], 2)),
        np.zeros((mode.shape[2], 2)),
        np.zeros(MEMORY),
    )
    state = (lagged, shaken, saved, memory)
    sums = np.zeros(commands.shape[1] + 1)
    for i in range(len(run)):
        for axis in range(3):
            command, driving = commands[run[i], :, axis], drive[i, axis]
            learned = response[i]
            if (
                learned[0] == 0.0
                and _still(command, start[i, axis], velocity[i, axis])
                and not _sags(driving)
            ):
                out[i, :, axis] = start[i, axis]
                out[i, 1:, axis] *= scale[i, axis]
                continue
            if (
                learned[0] == 0.0
                and begun[i] == 0.0
                and _sticks_alone(speed[i], play[i], stick[i], driving, lag[i], mode[i])
            ):
                held = commanded(
                    command, start[i, axis], velocity[i, axis], min(at_start[i] - late[i], 0.0), h
                )
                stick_to(
                    command,
                    held,
                    start[i, axis],
                    velocity[i, axis],
                    Obeying(h, late[i], moves[i], phase[i]),
                    stick[i],
                    scale[i, axis],
                    out[i, :, axis],
                )
                continue
            if learned[0] > 0.0:
                _sum_up(command, start[i, axis], h, sums)
            first = -begun[i] / h
            before = _answered(
                command, sums, learned, start[i, axis], velocity[i, axis], first - late[i], h
            )
            # it starts no earlier, and does not wait for what it obeys late
            rest = first - max(late[i] - at_start[i], 0.0)
            rest = _answered(command, sums, learned, start[i, axis], velocity[i, axis], rest, h)
            share = learned[len(learned) // 2 + int(learned[0])] if learned[0] > 0.0 else 1.0
            memory[:] = rest
            driven[:] = 0.0
            driven[PLACE] = lagged[:, 0] = shaken[:, 0] = rest
            driven[RATE] = share * velocity[i, axis]
            lagged[:, 1] = shaken[:, 1] = eager[i] * driven[RATE]
            out[i, 0, axis] = start[i, axis]
            if begun[i] > 0.0:
                after = _answered(
                    command, sums, learned, start[i, axis], velocity[i, axis], -late[i], h
                )
                led, goal, limit = before, after, speed[i]
                if driving[W] > 0.0:
                    led, goal = behind_drive(
                        before, after, begun[i], limit, driving, driven, memory
                    )
                    limit = np.inf
                follow(
                    led,
                    goal,
                    begun[i],
                    limit,
                    play[i],
                    stick[i],
                    lag_first[i, 0],
                    mode_first[i, 0],
                    lagged,
                    shaken,
                    memory,
                )
                before = after
            even = learned[0] == 0.0 and stick[i] > 0.0 and phase[i] == 0.0
            simple = even and np.count_nonzero(w[i]) <= 1 and driving[W] == 0.0
            for k in range(out.shape[1] - 1):
                reached = before
                s = piece = 0
                while s < count[i]:
                    if simple and s == ends[i, piece]:
                        piece += 1
                        after = commanded(
                            command,
                            start[i, axis],
                            velocity[i, axis],
                            k + ends[i, piece] / count[i] - late[i],
                            h,
                        )
                        if _held_throughout(
                            before,
                            after,
                            long[i, piece - 1],
                            (speed[i], play[i], stick[i]),
                            lag_long[i, piece - 1],
                            mode_long[i, piece - 1],
                            w[i],
                            state,
                        ):
                            before, reached, s = after, memory[HELD], ends[i, piece]
                            continue
                    at = k + parts[i, s] - late[i]
                    # the usual case, separate because the other call costs as much as the rest of
                    # the step
                    if learned[0] == 0.0:
                        after = commanded(command, start[i, axis], velocity[i, axis], at, h)
                    else:
                        after = _answered(
                            command, sums, learned, start[i, axis], velocity[i, axis], at, h
                        )
                    led, goal, limit = before, after, speed[i]
                    if driving[W] > 0.0:
                        led, goal = behind_drive(
                            before, after, steps[i, s], limit, driving, driven, memory
                        )
                        limit = np.inf
                    # the end of a tick need not be an instant
                    holds = stick[i] if s < moves[i] or stick[i] == 0.0 else np.inf
                    reached = follow(
                        led,
                        goal,
                        steps[i, s],
                        limit,
                        play[i],
                        holds,
                        lag[i, s],
                        mode[i, s],
                        lagged,
                        shaken,
                        memory,
                    )
                    before = after
                    s += 1
                out[i, k + 1, axis] = scale[i, axis] * reached


@njit(cache=True)
def _sticks_alone(speed, play, stick, drive, lag, mode):
    """Whether a platform has only stiction and a delay."""
    linear = not lag[:, :, 0].any() and not mode[:, :, 0].any() and drive[W] == 0.0
    return stick > 0.0 and play == 0.0 and speed == np.inf and linear


@njit(cache=True)
def _held_throughout(before, after, h, bounds, lag, mode, w, state):
    """Whether a platform with stiction provably keeps its position over h, in which its command is
    straight; its state is then advanced, otherwise unchanged.

    A lag or mode of natural frequency w responds to a command of constant rate u' with y' = u' +
    z', and w^2 z^2 + z'^2 never grows: |y'| stays below L = |u'| + sqrt(w^2 z^2 + z'^2) at the
    start. Between two instants y is therefore no further from the held position than at the nearer
    one plus L h/2. A speed limit must not act meanwhile, nor play with a response that may reverse.

    Args:
        bounds: speed limit [m/s], play and stick [m]. state: of lags and modes, a copy of both, and
            of the rest.
    """
    speed, play, stick = bounds
    lagged, shaken, saved, memory = state
    if speed < np.inf and (memory[LIMITED] != before or abs(after - before) > speed * h):
        return False
    rate = (after - before) / h
    fastest = abs(rate)
    position, n = before, len(lag)
    for s in range(len(w)):
        if w[s] > 0.0:
            kernel, state = (lag[s], lagged[s]) if s < n else (mode[s - n], shaken[s - n])
            position = state[0]
            swing = math.hypot(w[s] * (position - before + kernel[4] * rate), state[1] - rate)
            if play > 0.0 and swing > fastest:
                return False
            fastest += swing
    margin = stick - 0.5 * fastest * h
    if play > 0.0:
        position = memory[PLAYED]
    if abs(position - memory[HELD]) > margin:
        return False
    limited, played = memory[LIMITED], memory[PLAYED]
    saved[:n], saved[n:] = lagged, shaken
    reached = follow(before, after, h, speed, play, 0.0, lag, mode, lagged, shaken, memory)
    if abs(reached - memory[HELD]) > margin:
        lagged[:], shaken[:] = saved[:n], saved[n:]
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
    :mod:`hiltestbed.platform.step_response`.
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
