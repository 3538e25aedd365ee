"""The contact wrench along a recorded path, at the instants of ticks in which surfaces may meet.

Which candidates of a contact can meet follows from bounds of how far surfaces move: the geometry of
the others is not searched.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hiltestbed.compiled.jit import copied, njit
from hiltestbed.contact.geometry import ROUND_FRAME, ROW, Geometry, Met, arm, meet, unmet
from hiltestbed.contact.law import STATES
from hiltestbed.contact.mount import mount_place
from hiltestbed.contact.mount_dynamics import mount_reading
from hiltestbed.contact.parameters import (
    BLUNT,
    BRANCH_STIFFNESS,
    DRAG,
    LEVER,
    MODE,
    OFFSET,
    OVER_STRETCH,
    TILT_X,
    TILT_Y,
)
from hiltestbed.contact.phases import closes
from hiltestbed.contact.wrench import contact_wrench, held_at, meet_all, relate_one, surface_wrench
from hiltestbed.frames import Array, quat_exp, quat_mul
from hiltestbed.replay.felt import way_between
from hiltestbed.replay.mounted import (
    LAST,
    STEP_SIGMA,
    advance,
    pieces,
    struck,
    swing_freely,
    touched,
)

NO_LATCH = 1.5  # cosine of a latch condition, from which it can never be met


class Trajectory(NamedTuple):
    """The path of a run; see :class:`~hiltestbed.replay.felt.Felt`.

    Attributes:
        poses, twists, ends, clear: (N, ...). bent: whether the twist changes within a tick.
            captured: from the start. tick: [s].
    """

    poses: Array
    twists: Array
    ends: Array
    bent: bool
    before: Array
    clear: Array
    captured: bool
    latch: Array
    tick: float
    geometry: Geometry
    least_creep: float


class Scene(NamedTuple):
    """The contacts of a run at an instant; its arrays are updated in place.

    Attributes:
        p, least_creep: (C + 1, PARAMETERS) of the law, and of its friction.
        tilt: (7,) of the passive port. frames, motions: (2, 7), (2, 6) of both sides.
        state: (C + 1, STATES). hold: (7,) of the latch. wrench: (6,).
        touching: (C,) bool, and slipped: (C, 3) the slips before, as of
            :func:`~hiltestbed.replay.mounted.touched`.
        seen, apart_by: (2, 7), (C,) see :func:`meet_next`. work: (9, 7) scratch.
    """

    geometry: Geometry
    p: Array
    least_creep: float
    tilt: Array
    frames: Array
    motions: Array
    state: Array
    hold: Array
    met: Met
    wrench: Array
    touching: np.ndarray
    slipped: Array
    seen: Array
    apart_by: Array
    work: Array


@njit(cache=True)
def scene_of(path, p, tilt):
    """A :class:`Scene` before the first row of a :class:`Trajectory`."""
    count = p.shape[0] - 1
    frames, hold = np.zeros((2, 7)), np.zeros(7)
    copied(tilt, frames[1])
    hold[6] = 1.0
    return Scene(
        path.geometry,
        p,
        path.least_creep,
        tilt,
        frames,
        np.zeros((2, 6)),
        np.zeros((count + 1, STATES)),
        hold,
        unmet(count),
        np.zeros(6),
        np.zeros(count, dtype=np.bool_),
        np.zeros((count, 3)),
        np.zeros((2, 7)),
        np.zeros(count),
        np.empty((9, 7)),
    )


@njit(cache=True, nogil=True)
def contact_along(path, mount, p, tilt, parts, between, sub):
    """The wrench at the sensor along a path: ``sub`` (N, m, 6) at the instants ``parts`` (m,) of
    the tick that ends at each row.

    Args:
        path: a :class:`Trajectory`. mount: a :class:`~hiltestbed.replay.mounted.PathMount`.
        p: (C + 1, PARAMETERS) of each candidate and of the latch. tilt: (7,) of the passive port.
        between: whether all instants are wanted, and not a reading's own alone.
    """
    count, law, m, h = p.shape[0] - 1, p[-1], parts.shape[0], path.tick
    scene = scene_of(path, p, tilt)
    wrench, depth = scene.wrench, scene.met.depth
    # deflection of the mount, its rate, that at the end of a step, and the last ones
    moving = np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(LAST)
    latched, near, touches = path.captured, False, 0
    sub[:] = 0.0
    lean, longest = abs(law[TILT_X]) + abs(law[TILT_Y]), arm(scene.geometry.values, count)
    reach = max(0.0, -law[OFFSET] if count == 0 else -p[0, OFFSET])
    remembers = law[BRANCH_STIFFNESS] > 0.0 or law[DRAG] > 0.0 or law[OVER_STRETCH] > 0.0
    remembers = remembers or law[MODE] > 0.0 or path.latch[1] < NO_LATCH
    for k in range(path.poses.shape[0]):
        may_latch = not latched and path.latch[1] < NO_LATCH
        if not latched and law[MODE] == 0.0:
            if _apart(path, mount, scene, moving, (lean, reach, longest), k):
                if near:
                    scene.state[:], wrench[:], scene.touching[:] = 0.0, 0.0, False
                    near = False
                if mount.there:
                    swing_freely(mount, h, parts, wrench, *moving, sub[k])
                if may_latch:  # latches may close on a probe that is not in contact
                    _to_row(path, mount, scene, moving, k)
                    latched = _latches(scene, path.latch, mount.leapfrog)
                continue
            near = True
        passed = 0.0
        for s in range(m):
            if k == 0 and parts[s] < 1.0:  # forces start from zero at t = 0
                passed = parts[s]
                continue
            if s > 0 and (parts[s] == parts[s - 1] or not (between or remembers)):
                copied(sub[k, s - 1], sub[k, s])
                continue
            dt = h * (parts[s] - passed)
            passed = parts[s]
            split = 1
            if mount.leapfrog and not latched and k > 0:
                slips = scene.touching, scene.met.slip, scene.slipped
                split = pieces(mount, dt, scene.least_creep, wrench, *slips, moving[3], p)
            dt /= split
            for piece in range(split):
                at = parts[s] - (split - 1 - piece) * dt / h
                _carry(path, scene, mount.leapfrog, k, at)
                if mount.there and k > 0:  # at t = 0 the mount is at rest and unloaded
                    advance(mount, dt, wrench, *moving)
                    mount_place(moving[0], moving[2], tilt, scene.frames[1], scene.motions[1])
                if latched:
                    _exert(scene, dt, True, wrench)
                    continue
                before = wrench.copy()
                copied(scene.met.slip, scene.slipped)
                if law[MODE] > 0.0:  # the frame swings back towards surfaces that are apart
                    sides = scene.frames, scene.motions
                    meet_all(scene.geometry, p, *sides, scene.work, scene.met)
                else:
                    meet_next(scene, longest)
                _press(scene, dt)
                if mount.leapfrog:
                    slips = scene.touching, scene.met.slip, scene.slipped
                    part = touched(depth, scene.met.rate, p, dt, *slips)
                    if part >= 0.0 and k > 0:
                        touches += 1
                        part += STEP_SIGMA * split if touches == mount.early else 0.0
                        struck(mount, dt, part, wrench, before, *moving[:3])
            if mount.there:
                mount_reading(mount.stiffness, mount.damping, moving[0], moving[2], sub[k, s])
            else:
                copied(wrench, sub[k, s])
        if may_latch:
            copied(path.ends[k], scene.motions[0])
            latched = _latches(scene, path.latch, mount.leapfrog)


@njit(cache=True)
def _apart(path, mount, scene, moving, bounds, k):
    """Whether no surfaces can meet in the tick that ends at row k.

    ``bounds``: tilt of the passive port [rad], reach of the law beyond a surface [m], and largest
    distance of a round from A [m].
    """
    lean, reach, longest = bounds
    pose, clear = path.poses[k], path.clear[k]
    away = distance(pose) + longest
    if mount.there:
        swing = reach_of_swing(moving[0], moving[1], path.tick, away)
        if k == 0 or clear > reach + lean * away + swing:
            return k > 0
        if lean == 0.0:
            return False
        _to_row(path, mount, scene, moving, k)
        meet_all(scene.geometry, scene.p, scene.frames, scene.motions, scene.work, scene.met)
        last = path.poses[k - 1]
        return -scene.met.depth.max() > reach + swing + way_between(last, pose, longest)
    return clear > reach + lean * away


@njit(cache=True)
def _to_row(path, mount, scene, moving, k):
    """Both sides as they are at row k."""
    copied(path.poses[k], scene.frames[0])
    copied(path.ends[k], scene.motions[0])
    if mount.there:
        mount_place(moving[0], moving[2], scene.tilt, scene.frames[1], scene.motions[1])


@njit(cache=True)
def _carry(path, scene, leapfrog, k, at):
    """Side A as it is at the fraction ``at`` of the tick that ends at row k."""
    poses, ends = path.poses, path.ends
    if at < 1.0:
        last = path.before if k == 0 else poses[k - 1]
        begin = ends[k - 1] if path.bent and k > 0 else ends[k]
        slopes = path.twists[k], begin, ends[k]
        _within(last, slopes, path.tick, at, scene.frames[0], scene.motions[0])
        return
    copied(poses[k], scene.frames[0])
    copied(ends[k], scene.motions[0])
    # where the twist jumps: this force is of either tick
    if leapfrog and not path.bent and k + 1 < poses.shape[0]:
        for j in range(6):
            scene.motions[0, j] += 0.5 * (ends[k + 1, j] - ends[k, j])


@njit(cache=True)
def _within(pose, slopes, h, part, out, rate):
    """Pose ``out`` (7,) and twist ``rate`` (6,) at a fraction ``part`` of a tick that starts at
    ``pose``: a parabola about the uniform motion.

    ``slopes``: (6,) mean twist of the tick, and those at its start and end.
    """
    slope, start, end = slopes
    turn = np.empty(7)
    for j in range(6):
        bend = end[j] - start[j]
        way = h * part * (slope[j] + 0.5 * (part - 1.0) * bend)
        rate[j] = end[j] + (part - 1.0) * bend
        if j < 3:
            out[j] = pose[j] + way
        else:
            turn[j - 3] = way
    quat_exp(turn[0:3], turn[3:7])
    quat_mul(turn[3:7], pose[3:7], out[3:7])


@njit(cache=True)
def _laws(scene, dt):
    """See :func:`~hiltestbed.contact.wrench.contact_wrench`."""
    return dt, scene.least_creep, scene.p, scene.state


@njit(cache=True)
def _press(scene, dt):
    """The wrench of the contacts, whose geometry is known."""
    laws, wrench = _laws(scene, dt), scene.wrench
    wrench[:] = 0.0
    surface_wrench(scene.geometry, laws, scene.frames, scene.met, scene.work[7], wrench)


@njit(cache=True)
def _exert(scene, dt, latched, wrench):
    """``wrench`` (6,) of the contacts or of the latch, from the frames."""
    laws, sides = _laws(scene, dt), (scene.frames, scene.motions)
    held = latched, scene.hold
    contact_wrench(scene.geometry, laws, sides, *held, scene.met, scene.work, wrench)


@njit(cache=True)
def _latches(scene, latch, leapfrog):
    """Whether the latch closes on what the frames show; if so, it holds the pose at which its
    springs carry the contacts' force.

    A leapfrog's wrench acts over half a step before and after: it becomes the mean of those of the
    contacts and of the latch, both with the twist of the tick that ends.
    """
    frames, motions, hold = scene.frames, scene.motions, scene.hold
    pose, twist, before = np.empty(7), np.empty(6), np.zeros(6)
    relate_one(frames[0], motions[0], frames[1], motions[1], pose, twist, scene.work[:5, :3])
    if not closes(pose, twist, latch):
        return False
    if not leapfrog:
        held_at(pose, scene.wrench, frames[1], scene.p[-1], hold)
        return True
    _exert(scene, 0.0, False, before)
    held_at(pose, before, frames[1], scene.p[-1], hold)
    _exert(scene, 0.0, True, scene.wrench)
    for j in range(6):
        scene.wrench[j] = 0.5 * (scene.wrench[j] + before[j])
    return True


@njit(cache=True)
def meet_next(scene, longest):
    """Contact geometry of those candidates that can touch, given what the two frames have moved
    since an earlier call.

    ``seen`` (2, 7): frames at that call. ``apart_by`` (C,): lower bound of the distance of each
    candidate then [m]; both are updated. ``longest``: largest distance of a round from its frame
    [m].
    """
    depth, rate, frames, seen = scene.met.depth, scene.met.rate, scene.frames, scene.seen
    apart_by = scene.apart_by
    pose, twist, scratch = scene.work[5], scene.work[6][:6], scene.work[:5, :3]
    reach = longest + math.sqrt(
        (seen[0, 0] - seen[1, 0]) ** 2
        + (seen[0, 1] - seen[1, 1]) ** 2
        + (seen[0, 2] - seen[1, 2]) ** 2
    )
    moved = way_between(seen[0], frames[0], reach) + way_between(seen[1], frames[1], reach)
    copied(frames, seen)
    a = -1
    for c in range(depth.shape[0]):
        ahead = max(0.0, -scene.p[c, OFFSET])
        apart_by[c] -= moved
        if apart_by[c] > ahead:
            depth[c], rate[c] = -apart_by[c], 0.0
            continue
        if scene.geometry.index[c * ROW + ROUND_FRAME] != a:
            a = scene.geometry.index[c * ROW + ROUND_FRAME]
            b = 1 - a
            sides = frames[a], scene.motions[a], frames[b], scene.motions[b]
            relate_one(*sides, pose, twist, scratch)
        meet(
            scene.geometry,
            c,
            pose,
            twist,
            (scene.p[c, LEVER], scene.p[c, BLUNT], ahead),
            scratch,
            scene.met,
        )
        apart_by[c] = -depth[c]


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
def distance(pose):
    """Distance of A from P's origin [m]."""
    return math.sqrt(pose[0] ** 2 + pose[1] ** 2 + pose[2] ** 2)
