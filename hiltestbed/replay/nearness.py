"""Which candidates of a contact can meet along a path, by bounds of how far surfaces move: the
geometry of the others is not searched.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.contact.geometry import PASSIVE, ROUND_FRAME, ROW, SURFACE_FRAME, VALUES, arm, meet
from hiltestbed.contact.law import STATES
from hiltestbed.contact.parameters import BLUNT, LEVER, OFFSET
from hiltestbed.contact.wrench import meet_all, relate_one
from hiltestbed.frames import Array
from hiltestbed.replay.felt import way_between


class Scene(NamedTuple):
    """The contacts of a run at an instant; its arrays are updated in place.

    Attributes:
        index, values, p, least_creep: geometry, (C + 1, PARAMETERS) of the law, and of its
            friction. tilt: (7,) of the passive port. frames, motions: (2, 7), (2, 6) of both sides.
        state: (C + 1, STATES). hold: (7,) of the latch. met: see
            :func:`hiltestbed.contact.wrench.meet_all`. wrench: (6,).
        touching: (C,) bool, and slipped: (C, 3) the slips before, as of
            :func:`~hiltestbed.replay.mounted.touched`.
        seen, apart_by: (2, 7), (C,) see :func:`meet_next`. work: (9, 7) scratch.
    """

    index: np.ndarray
    values: Array
    p: Array
    least_creep: float
    tilt: Array
    frames: Array
    motions: Array
    state: Array
    hold: Array
    met: tuple[Array, Array, Array, Array, Array]
    wrench: Array
    touching: np.ndarray
    slipped: Array
    seen: Array
    apart_by: Array
    work: Array


@njit(cache=True)
def scene_of(path, p, tilt):
    """A :class:`Scene` before the first row of a
    :class:`~hiltestbed.replay.contact_path.Trajectory`.
    """
    index, values = path.geometry
    count = p.shape[0] - 1
    frames, hold = np.zeros((2, 7)), np.zeros(7)
    frames[1], hold[6] = tilt, 1.0
    point, normal, slip = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros((count, 3))
    return Scene(
        index,
        values,
        p,
        path.least_creep,
        tilt,
        frames,
        np.zeros((2, 6)),
        np.zeros((count + 1, STATES)),
        hold,
        (np.zeros(count), np.zeros(count), point, normal, slip),
        np.zeros(6),
        np.zeros(count, dtype=np.bool_),
        np.zeros((count, 3)),
        np.zeros((2, 7)),
        np.zeros(count),
        np.empty((9, 7)),
    )


@njit(cache=True)
def meet_every(scene):
    """Contact geometry of all candidates."""
    geometry, sides = (scene.index, scene.values), (scene.frames, scene.motions)
    meet_all(*geometry, scene.p, *sides, scene.work, *scene.met)


@njit(cache=True)
def distance(pose):
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
def outside(now, before, p):
    """Whether no candidate is in contact at either end of a tick: penetrations (C,) compared with
    offsets.
    """
    for c in range(now.shape[0]):
        if max(now[c], before[c]) > p[c, OFFSET]:
            return False
    return True


@njit(cache=True)
def move_lever(moved, depth, normal, twist, point, slip):
    """Shift the points of application along the normal by the fraction ``moved`` of the overlap,
    and adapt the slip.
    """
    for c in range(depth.shape[0]):
        lift = moved * depth[c]
        x, y, z = lift * normal[c, 0], lift * normal[c, 1], lift * normal[c, 2]
        point[c, 0] += x
        point[c, 1] += y
        point[c, 2] += z
        slip[c, 0] += twist[4] * z - twist[5] * y
        slip[c, 1] += twist[5] * x - twist[3] * z
        slip[c, 2] += twist[3] * y - twist[4] * x


@njit(cache=True)
def _meet_one(scene, c, ahead):
    """Contact geometry of candidate c, whose frames are related in ``work``."""
    depth, rate, point, normal, slip = scene.met
    pose, twist, scratch = scene.work[5], scene.work[6][:6], scene.work[:5, :3]
    law = scene.p[c, LEVER], scene.p[c, BLUNT], ahead
    found = scratch, point[c], normal[c], slip[c]
    depth[c], rate[c] = meet(scene.index, scene.values, c, pose, twist, *law, *found)


@njit(cache=True)
def _relate(scene, a):
    """Relate frame ``a`` to the other one in ``work``."""
    frames, motions, work = scene.frames, scene.motions, scene.work
    b = 1 - a
    relate_one(frames[a], motions[a], frames[b], motions[b], work[5], work[6][:6], work[:5, :3])


@njit(cache=True)
def meet_near(scene, untilted, lean):
    """Contact geometry of those candidates that can touch with a tilt ``lean`` [rad], given
    penetrations ``untilted`` (C,) without tilt.

    A tilt moves a point by at most its distance from P's origin times the angle, which bounds the
    change of a penetration.
    """
    depth, rate = scene.met[0], scene.met[1]
    away = distance(scene.frames[0])
    related = False
    for c in range(depth.shape[0]):
        longest = arm(scene.values[c * VALUES : (c + 1) * VALUES], 1)
        depth[c], rate[c] = -1.0, 0.0
        if untilted[c] + lean * (away + longest) < min(scene.p[c, OFFSET], 0.0):
            continue
        if not related:
            _relate(scene, 0)
            related = True
        _meet_one(scene, c, max(0.0, -scene.p[c, OFFSET]))


@njit(cache=True)
def meet_next(scene, longest):
    """Contact geometry of those candidates that can touch, given what the two frames have moved
    since an earlier call.

    ``seen`` (2, 7): frames at that call. ``apart_by`` (C,): lower bound of the distance of each
    candidate then [m]; both are updated. ``longest``: largest distance of a round from its frame
    [m].
    """
    depth, rate, frames, seen = scene.met[0], scene.met[1], scene.frames, scene.seen
    apart_by = scene.apart_by
    reach = longest + math.sqrt(
        (seen[0, 0] - seen[1, 0]) ** 2
        + (seen[0, 1] - seen[1, 1]) ** 2
        + (seen[0, 2] - seen[1, 2]) ** 2
    )
    moved = way_between(seen[0], frames[0], reach) + way_between(seen[1], frames[1], reach)
    seen[:] = frames
    a = -1
    for c in range(depth.shape[0]):
        ahead = max(0.0, -scene.p[c, OFFSET])
        apart_by[c] -= moved
        if apart_by[c] > ahead:
            depth[c], rate[c] = -apart_by[c], 0.0
            continue
        if scene.index[c * ROW + ROUND_FRAME] != a:
            a = scene.index[c * ROW + ROUND_FRAME]
            _relate(scene, a)
        _meet_one(scene, c, ahead)
        apart_by[c] = -depth[c]
