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

from hiltestbed.compiled.jit import njit

START, LEAVE = 0, 1


@njit(cache=True, inline="always")
def cubic(t, s0, v0, s1, v1, h):
    """The cubic between two positions and velocities, at the fraction ``t`` of their interval ``h``
    [s].
    """
    a = s1 - s0
    return s0 + t * (h * v0 + t * ((3.0 * a - h * (2.0 * v0 + v1)) + t * (h * (v0 + v1) - 2.0 * a)))


@njit(cache=True)
def sample(k, cycle, late, ring, span, i, goal, leave):
    """Take the command ``goal`` (J,) with the velocity ``leave`` (J,) at tick ``k`` of run ``i``,
    which begins a cycle.

    ring: (n, D + 1, 2, J) delayed commands, by cycle. span: (n, 2, 2, J) start and end of the
        interpolation, position and velocity.
    """
    size = ring.shape[1]
    now = (k // cycle) % size
    for j in range(goal.shape[0]):
        ring[i, now, 0, j] = goal[j]
        ring[i, now, 1, j] = leave[j]
        then = (now - late) % size
        for part in range(2):
            span[i, START, part, j] = span[i, LEAVE, part, j]
            span[i, LEAVE, part, j] = ring[i, then, part, j]


@njit(cache=True)
def plan_tick(k, cycle, fed, h, span, i, reference, velocity, plan):
    """Write ``plan`` (n, m, 3, J) of run ``i``: position, velocity and acceleration at the start of
    each step of tick ``k``.

    reference, velocity: (n, J) at the end of the last step, updated to the end of this tick.
    """
    m = plan.shape[1]
    dt, part = h / m, k % cycle
    for s in range(m):
        t = (part * m + s + 1.0) / (cycle * m)
        for j in range(reference.shape[1]):
            s0, s1 = span[i, START, 0, j], span[i, LEAVE, 0, j]
            plan[i, s, 0, j] = reference[i, j]
            if fed:
                now = cubic(t, s0, span[i, START, 1, j], s1, span[i, LEAVE, 1, j], cycle * h)
                rate = (now - reference[i, j]) / dt
                plan[i, s, 1, j] = velocity[i, j]
                plan[i, s, 2, j] = (rate - velocity[i, j]) / dt
                velocity[i, j] = rate
            else:
                now = s0 + t * (s1 - s0)
                plan[i, s, 1, j] = plan[i, s, 2, j] = velocity[i, j] = 0.0
            reference[i, j] = now
