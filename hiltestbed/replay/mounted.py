"""The motion of a compliant mount along a recorded path: to first order, as by MuJoCo, or to second
order, by a leapfrog.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hiltestbed.compiled.jit import copied, njit
from hiltestbed.contact.mount_dynamics import BODY, mount_reading, mount_step
from hiltestbed.contact.parameters import FRICTION, OFFSET
from hiltestbed.contact.wrench import CREEP
from hiltestbed.frames import Array

# [N, N m] force transmitted by an oscillating mount, below which it is taken to be at rest
AT_REST = 1e-9
SPAN, LAST = 6, 7  # place of the last step [s] beside the last rates, and their number
STEP_SIGMA = math.sqrt(1.0 / 12.0)  # standard deviation of an instant within a step, in steps
# chosen: share of a slip that friction takes away in one piece of a step; errors fall with it;
# unstable from 1
MOST_LOSS = 0.05
MOST_PIECES = 64  # chosen: of a step, in which friction sticks or reverses


class PathMount(NamedTuple):
    """The mount of a run.

    Attributes:
        stiffness, damping: (6,) of its joints. body: (BODY,) on it. leapfrog: whether it moves to
            second order. mobility: see
            :class:`~hiltestbed.contact.mount_dynamics.MountDynamics`.
        early: number of the touch that is taken to be early, 0 for none. there: False for a rigid
            passive side.
    """

    stiffness: Array
    damping: Array
    body: Array
    leapfrog: bool
    mobility: tuple[float, float]
    early: int = 0
    there: bool = True


RIGID = PathMount(np.zeros(6), np.zeros(6), np.zeros(BODY), False, (0.0, 0.0), 0, False)


@njit(cache=True)
def advance(mount, dt, wrench, q, qd, rate, last):
    """One step of a mount to ``q`` (6,), with its ``rate`` (6,) there, under ``wrench`` (6,) at the
    step's start.

    ``qd`` (6,) is the rate itself to first order. In a leapfrog it is that of the middle of the
    step, from which and the ``last`` (LAST,) one the rate at its end is extrapolated.
    """
    leapfrog = mount.leapfrog
    kick = 0.5 * (last[SPAN] + dt) if leapfrog else dt  # half a step at the start
    copied(qd, last[:6])
    last[SPAN] = dt
    mount_step(mount.stiffness, mount.damping, mount.body, kick, dt, leapfrog, wrench, q, qd)
    for j in range(6):
        rate[j] = qd[j] + 0.5 * dt / kick * (qd[j] - last[j]) if leapfrog else qd[j]


@njit(cache=True)
def touched(depth, closing, p, dt, meets, slip, slipped):
    """Part of the last step for which contacts that were apart before it have touched; negative:
    none was.

    ``depth``, ``closing`` (C,), ``slip`` (C, 3): penetrations, their rates and slips. Updated are
    ``meets`` (C,) bool, whether they were in contact, and ``slipped`` (C, 3), the slips before, of
    those that were not.
    """
    part = -1.0
    for c in range(depth.shape[0]):
        deep = depth[c] - p[c, OFFSET]
        if deep > 0.0 and not meets[c]:
            copied(slip[c], slipped[c])
            part = max(part, min(deep / (closing[c] * dt), 1.0) if closing[c] > 0.0 else 1.0)
        meets[c] = deep > 0.0
    return part


@njit(cache=True)
def struck(mount, dt, part, wrench, before, q, qd, rate):
    """Correct a leapfrog for a wrench (6,) that jumped from ``before`` (6,) within the last step,
    and was there for ``part`` of it.

    The leapfrog takes it to act from the middle of that step. ``qd`` (6,), of there, is changed so
    that it is right after the next step.
    """
    nothing, place, answer = np.zeros(6), q.copy(), np.zeros(6)
    mount_step(nothing, nothing, mount.body, dt, dt, True, wrench - before, place, answer)
    for j in range(6):
        rate[j] += part * answer[j]
        qd[j] += (part - 0.5) * answer[j]


@njit(cache=True)
def pieces(mount, dt, least_creep, wrench, meets, slip, slipped, last, p):
    """Number of pieces of a step of ``dt`` [s] in which a leapfrog resolves friction, which is
    stiff where it sticks or reverses.

    ``slip``, ``slipped`` (C, 3): of the contacts now and before the ``last`` step; it is taken to
    change at the same rate.
    """
    light, turns = mount.mobility
    force = math.sqrt(wrench[0] ** 2 + wrench[1] ** 2 + wrench[2] ** 2)
    if force == 0.0:
        return 1
    arm = math.sqrt(wrench[3] ** 2 + wrench[4] ** 2 + wrench[5] ** 2) / force
    most, ratio = 0.0, dt / last[SPAN] if last[SPAN] > 0.0 else 0.0
    for c in range(meets.shape[0]):
        if not meets[c] or p[c, FRICTION] == 0.0:
            continue
        along, way = 0.0, 0.0
        for j in range(3):
            along -= slip[c, j] * ratio * (slip[c, j] - slipped[c, j])
            way += (ratio * (slip[c, j] - slipped[c, j])) ** 2
        part = min(max(along / way, 0.0), 1.0) if way > 0.0 else 0.0
        least = 0.0
        for j in range(3):
            least += (slip[c, j] + part * ratio * (slip[c, j] - slipped[c, j])) ** 2
        limit = p[c, FRICTION] * force
        creep = max(CREEP, least_creep * limit)
        most = max(most, limit / math.sqrt(least + creep * creep))
    return min(MOST_PIECES, 1 + int(most * (light + turns * arm * arm) * dt / MOST_LOSS))


@njit(cache=True)
def swing_freely(mount, h, parts, nothing, q, qd, rate, last, sub):
    """Step an unloaded mount over one tick; ``nothing`` (6,): zero wrench; ``sub`` (m, 6): wrench
    at the sensor. Below :data:`AT_REST` it is set to rest.
    """
    stiffness, damping = mount.stiffness, mount.damping
    most = 0.0
    for j in range(6):
        most = max(most, stiffness[j] * (abs(q[j]) + h * abs(qd[j])))
    if most < AT_REST:
        q[:], qd[:], rate[:], sub[:] = 0.0, 0.0, 0.0, 0.0
        return
    passed = 0.0
    for s in range(parts.shape[0]):
        if s > 0 and parts[s] == parts[s - 1]:
            copied(sub[s - 1], sub[s])
            continue
        advance(mount, h * (parts[s] - passed), nothing, q, qd, rate, last)
        passed = parts[s]
        mount_reading(stiffness, damping, q, rate, sub[s])
