"""Stiction alone on recorded commands: where an axis is held, from jump to jump.

A platform may move only at instants, m of which divide a tick: at (j - phase) / m of it, j = 1 ...
m. Between two rows the command is straight, so that the instant of the next jump follows at once.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array

# chosen: of the time between two instants: within it a bend of the command lies on one
ON_AN_INSTANT = 1e-9


@njit(cache=True, inline="always")
def commanded(command, start, velocity, at, h):
    """The command [m] at the tick ``at``: linear over each tick to its row, the uniform approach
    before, the last row held after.
    """
    if at <= 0.0:
        return start + velocity * at * h
    k = int(at)
    part = at - k
    last = len(command) - 1
    low = start if k == 0 else command[min(k - 1, last)]
    if part == 0.0:
        return low
    return low + part * (command[min(k, last)] - low)


@njit(cache=True, inline="always")
def held_after(held, before, after, a, b, instants, phase, stick, limit):
    """Where an axis is held after the instants within (a, b] of a tick, over which its command runs
    from ``before`` to ``after`` [m]; and the largest ``stick`` [m], at most ``limit``, up to which
    each of its jumps is the same.
    """
    way = after - before
    j = int(math.floor(a * instants + phase + ON_AN_INSTANT))
    last = int(math.floor(b * instants + phase + ON_AN_INSTANT))
    while abs(after - held) > stick and j < last:
        if way == 0.0:
            j += 1
        else:
            edge = held + math.copysign(stick, way)
            there = int(math.floor(instants * (a + (b - a) * (edge - before) / way) + phase))
            j = max(j + 1, min(last, there))
        reached = before + way * ((j - phase) / instants - a) / (b - a)
        if abs(reached - held) > stick:
            limit = min(limit, abs(reached - held))
            held = reached
    return held, limit


class Obeying(NamedTuple):
    """When a platform obeys: tick ``h`` [s], delay ``late`` [ticks], number of ``instants`` in a
    tick, and their ``phase``.
    """

    h: float
    late: float
    instants: int
    phase: float


class Followed(NamedTuple):
    """Axes that were commanded and measured.

    Attributes:
        commands: (R, N, 3) [m]. goal, sigma: (R, N, 3) [m] where the axes were measured, and their
            noise. rows: (R,) that are compared.
        start, velocity: (R, 3) of the approach. moves: (R, 3) the axes that are compared.
    """

    commands: Array
    goal: Array
    sigma: Array
    rows: np.ndarray
    start: Array
    velocity: Array
    moves: np.ndarray


@njit(cache=True, inline="always")
def held_after_tick(held, command, start, velocity, k, obeying, stick, limit):
    """:func:`held_after` over the tick from k to k + 1 of a command that is obeyed ``late``
    [ticks]; it bends once in between.
    """
    h, late, instants, phase = obeying
    bend = late - math.floor(late)
    before = commanded(command, start, velocity, k - late, h)
    after = commanded(command, start, velocity, k + 1 - late, h)
    if min(bend, 1.0 - bend) < ON_AN_INSTANT:
        return held_after(held, before, after, 0.0, 1.0, instants, phase, stick, limit)
    bent = commanded(command, start, velocity, k - math.floor(late), h)
    held, limit = held_after(held, before, bent, 0.0, bend, instants, phase, stick, limit)
    return held_after(held, bent, after, bend, 1.0, instants, phase, stick, limit)


@njit(cache=True)
def stick_to(command, held, start, velocity, obeying, stick, scale, out):
    """Write to ``out`` (N,) where an axis that is first ``held`` [m] stands in each row, times
    ``scale``.
    """
    out[0] = held
    for k in range(len(out) - 1):
        held, _ = held_after_tick(held, command, start, velocity, k, obeying, stick, np.inf)
        out[k + 1] = scale * held


@njit(cache=True)
def _misfit(followed, obeying, stick, most, limit, held):
    commands, goal, sigma, rows, start, velocity, moves = followed
    total, same, done = 0.0, np.inf, 0
    for r in range(len(rows)):
        for a in range(3):
            held[a] = start[r, a]
        for k in range(rows[r]):
            for a in range(3):
                if moves[r, a]:
                    z = (goal[r, k, a] - held[a]) / sigma[r, k, a]
                    total += min(z * z, most)
                    command = commands[r, :, a]
                    held[a], same = held_after_tick(
                        held[a], command, start[r, a], velocity[r, a], k, obeying, stick, same
                    )
            done += 1
            if total > limit:
                return np.inf, same, done
    return total, same, done


@njit(cache=True)
def all_paths(followed, obeying, sticks, most, limit, margin, speed, budget, out):
    """Every path that runs can take with a stick in the range ``sticks`` [m], one after the other.

    A path changes only where the stick passes the length of one of its jumps. So each replay tells
    up to which stick it is the same.

    Args:
        followed, obeying: the axes and their platform.
        most: chi-square of one sample at most. limit: chi-square beyond which a path is left; it
            falls with each path to its chi-square
        and ``margin``. speed: of the commands [m] a row, which over the stick is the number of
            jumps. budget: rows and jumps after which
        no further path is replayed. out: (P, 3) buffer for the least and the largest stick [m] of
            each path and its chi-square.

    Returns:
        The number of paths written to ``out``, and what is left of the budget.
    """
    stick, high = sticks
    count, held = 0, np.empty(3)
    while stick < high and count < len(out) and budget > 0.0:
        chi2, same, done = _misfit(followed, obeying, stick, most, limit, held)
        same = max(same, stick * (1.0 + 1e-12))  # beyond round-off
        if chi2 < np.inf:
            out[count, 0], out[count, 1], out[count, 2] = stick, min(same, high), chi2
            count += 1
            limit = min(limit, chi2 + margin)
        budget -= done * (1.0 + min(float(obeying.instants), speed / stick))
        stick = same
    return count, budget
