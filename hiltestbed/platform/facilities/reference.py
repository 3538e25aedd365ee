"""Processing of commands by a facility's controller: its own rate, its delay in whole cycles, and
its interpolation.

The loop commands a pose for the end of its tick. A controller with a cycle of c ticks takes every
c-th command, delays it by d whole cycles, and interpolates from the previous one to it over a cycle
of its own: the pose is reached (c - 1) + c d ticks later than commanded. With feed-forward the
interpolation is the cubic with the commanded velocity at each command, otherwise it is linear, and
the drives are given positions only. The planned velocity and acceleration are differences at the
physics step, so that MuJoCo's semi-implicit Euler method with these inputs reproduces the plan.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array

START, LEAVE = 0, 1


class TickPlan(NamedTuple):
    """Commands and references of J driven joints of n runs.

    Attributes:
        tick: of the loop [s]. length: (n,) ticks per cycle of each controller. late: (n,) command
            delay in whole plan. feed: (n,) bool, feed-forward.
        ticks: (1,) number of the tick that is planned next; negative: nothing is planned.
        goal, leave: (n, J) joints and their rates at the last command taken.
        ring: (n, D + 1, 2, J) delayed commands, by cycle. span: (n, 2, 2, J) start and end of the
            interpolation, position and velocity.
        reference, velocity: (n, J) at the end of the last step planned.
        steps: (n, m, 3, J) position, velocity and acceleration at the start of each step.
    """

    tick: float
    length: NDArray[np.int64]
    late: NDArray[np.int64]
    feed: NDArray[np.bool_]
    ticks: NDArray[np.int64]
    goal: Array
    leave: Array
    ring: Array
    span: Array
    reference: Array
    velocity: Array
    steps: Array


@njit(cache=True)
def sample(plan, i):
    """Take the goal of run ``i`` as the command of the cycle that begins."""
    size = plan.ring.shape[1]
    now = (plan.ticks[0] // plan.length[i]) % size
    for j in range(plan.goal.shape[1]):
        plan.ring[i, now, 0, j] = plan.goal[i, j]
        plan.ring[i, now, 1, j] = plan.leave[i, j]
        then = (now - plan.late[i]) % size
        for part in range(2):
            plan.span[i, START, part, j] = plan.span[i, LEAVE, part, j]
            plan.span[i, LEAVE, part, j] = plan.ring[i, then, part, j]


@njit(cache=True)
def plan_tick(plan, i):
    """Write the steps of run ``i``, and its references at the end of the tick."""
    steps, reference, velocity, span = plan.steps[i], plan.reference[i], plan.velocity[i], plan.span
    m = steps.shape[0]
    h, cycle, part = plan.tick, plan.length[i], plan.ticks[0] % plan.length[i]
    dt = h / m
    for s in range(m):
        t = (part * m + s + 1.0) / (cycle * m)
        for j in range(reference.shape[0]):
            s0, s1 = span[i, START, 0, j], span[i, LEAVE, 0, j]
            steps[s, 0, j] = reference[j]
            if plan.feed[i]:  # the cubic between two positions and velocities
                a, b, c = s1 - s0, span[i, START, 1, j], span[i, LEAVE, 1, j]
                bend = (3.0 * a - cycle * h * (2.0 * b + c)) + t * (cycle * h * (b + c) - 2.0 * a)
                now = s0 + t * (cycle * h * b + t * bend)
                rate = (now - reference[j]) / dt
                steps[s, 1, j] = velocity[j]
                steps[s, 2, j] = (rate - velocity[j]) / dt
                velocity[j] = rate
            else:
                now = s0 + t * (s1 - s0)
                steps[s, 1, j] = steps[s, 2, j] = velocity[j] = 0.0
            reference[j] = now
