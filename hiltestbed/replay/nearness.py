"""Which candidates of a contact can meet along a path, by bounds of how far surfaces move: the
geometry of the others is not searched.
"""

from __future__ import annotations

import math

from hiltestbed.compiled.jit import njit
from hiltestbed.contact.geometry import PASSIVE, ROUND_FRAME, ROW, SURFACE_FRAME, VALUES, arm, meet
from hiltestbed.contact.parameters import BLUNT, LEVER, OFFSET
from hiltestbed.contact.wrench import relate_one
from hiltestbed.replay.felt import way_between


@njit(cache=True)
def away_from(pose):
    """Distance of A from P's origin [m]."""
    return math.sqrt(pose[0] ** 2 + pose[1] ** 2 + pose[2] ** 2)


@njit(cache=True)
def reach_of_swing(q, qd, h, away):
    """Upper bound of the approach [m] that an unloaded mount may cause within a tick, at a distance
    ``away`` [m] from its hinges.

    The bound is twice its deflection plus its rate times a tick; it holds since its period is
    resolved by several ticks.
    """
    slid, turned = 0.0, 0.0
    for j in range(3):
        slid += 2.0 * abs(q[j]) + h * abs(qd[j])
        turned += 2.0 * abs(q[3 + j]) + h * abs(qd[3 + j])
    return slid + turned * away


@njit(cache=True)
def on_passive(index, count):
    """Whether all surfaces are fixed to the passive frame."""
    for c in range(count):
        if index[c * ROW + SURFACE_FRAME] != PASSIVE:
            return False
    return True


@njit(cache=True)
def move_lever(moved, depth, normal, twist, point, slip):
    """Shift the points of application along the normal by the fraction ``moved`` of the overlap,
    and adapt the slip.
    """
    for c in range(depth.shape[0]):
        x, y, z = (
            moved * depth[c] * normal[c, 0],
            moved * depth[c] * normal[c, 1],
            moved * depth[c] * normal[c, 2],
        )
        point[c, 0] += x
        point[c, 1] += y
        point[c, 2] += z
        slip[c, 0] += twist[4] * z - twist[5] * y
        slip[c, 1] += twist[5] * x - twist[3] * z
        slip[c, 2] += twist[3] * y - twist[4] * x


@njit(cache=True)
def meet_near(
    index, values, p, frames, motions, untilted, lean, work, depth, rate, point, normal, slip
):
    """Contact geometry of those candidates that can touch with a tilt ``lean`` [rad], given
    penetrations ``untilted`` (C,) without tilt.

    A tilt moves a point by at most its distance from P's origin times the angle, which bounds the
    change of a penetration.
    """
    pose, twist, scratch = work[5], work[6][:6], work[:5, :3]
    away = away_from(frames[0])
    related = False
    for c in range(depth.shape[0]):
        longest = arm(values[c * VALUES : (c + 1) * VALUES], 1)
        depth[c], rate[c] = -1.0, 0.0
        if untilted[c] + lean * (away + longest) < min(p[c, OFFSET], 0.0):
            continue
        if not related:
            relate_one(frames[0], motions[0], frames[1], motions[1], pose, twist, scratch)
            related = True
        depth[c], rate[c] = meet(
            index,
            values,
            c,
            pose,
            twist,
            p[c, LEVER],
            p[c, BLUNT],
            max(0.0, -p[c, OFFSET]),
            scratch,
            point[c],
            normal[c],
            slip[c],
        )


@njit(cache=True)
def meet_next(
    index,
    values,
    p,
    frames,
    motions,
    seen,
    apart_by,
    longest,
    work,
    depth,
    rate,
    point,
    normal,
    slip,
):
    """Contact geometry of those candidates that can touch, given what the two frames have moved
    since an earlier call.

    Args:
        seen: (2, 7) frames at that call. apart_by: (C,) lower bound of the distance of each
            candidate then [m]; both are updated.
        longest: largest distance of a round from its frame [m].
    """
    pose, twist, scratch = work[5], work[6][:6], work[:5, :3]
    reach = longest + math.sqrt(
        (seen[0, 0] - seen[1, 0]) ** 2
        + (seen[0, 1] - seen[1, 1]) ** 2
        + (seen[0, 2] - seen[1, 2]) ** 2
    )
    moved = way_between(seen[0], frames[0], reach) + way_between(seen[1], frames[1], reach)
    seen[:] = frames
    a = -1
    for c in range(depth.shape[0]):
        ahead = max(0.0, -p[c, OFFSET])
        apart_by[c] -= moved
        if apart_by[c] > ahead:
            depth[c], rate[c] = -apart_by[c], 0.0
            continue
        if index[c * ROW + ROUND_FRAME] != a:
            a = index[c * ROW + ROUND_FRAME]
            relate_one(frames[a], motions[a], frames[1 - a], motions[1 - a], pose, twist, scratch)
        depth[c], rate[c] = meet(
            index,
            values,
            c,
            pose,
            twist,
            p[c, LEVER],
            p[c, BLUNT],
            ahead,
            scratch,
            point[c],
            normal[c],
            slip[c],
        )
        apart_by[c] = -depth[c]


@njit(cache=True)
def outside(now, before, p):
    """Whether no candidate is in contact at either end of a tick: penetrations (C,) compared with
    offsets.
    """
    for c in range(now.shape[0]):
        if max(now[c], before[c]) > p[c, OFFSET]:
            return False
    return True
