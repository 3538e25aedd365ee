"""The contact wrench along a recorded path, at the instants of ticks in which surfaces may meet.

At a row, where nothing tilts or yields, the contact geometry is that of all hypotheses (see
:class:`~hiltestbed.replay.felt.Felt`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.contact.geometry import Geometry, Met, arm
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
from hiltestbed.contact.wrench import contact_wrench, held_at, relate_one, surface_wrench
from hiltestbed.frames import Array, quat_exp, quat_mul
from hiltestbed.replay.felt import NEAR, way_between
from hiltestbed.replay.mounted import (
    LAST,
    STEP_SIGMA,
    advance,
    pieces,
    struck,
    swing_freely,
    touched,
)
from hiltestbed.replay.nearness import (
    distance,
    meet_every,
    meet_near,
    meet_next,
    move_lever,
    on_passive,
    outside,
    reach_of_swing,
    scene_of,
)

NO_LATCH = 1.5  # cosine of a latch condition, from which it can never be met


class Trajectory(NamedTuple):
    """The path of a run, and the geometry that moved along it; see
    :class:`~hiltestbed.replay.felt.Felt`.

    Attributes:
        poses, twists, ends, clear: (N, ...). bent: whether the twist changes within a tick.
            captured: from the start. tick: [s].
        met: of each row, (N, C, ...).
    """

    poses: Array
    twists: Array
    ends: Array
    bent: bool
    before: Array
    clear: Array
    met: Met
    captured: bool
    latch: Array
    tick: float
    geometry: Geometry
    lever: float
    least_creep: float


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
    moved = law[LEVER] - path.lever
    plain = lean == 0.0 and not mount.there and reach <= NEAR
    plain = plain and (moved == 0.0 or on_passive(scene.geometry.index, count))
    sharp = not mount.there and law[MODE] == 0.0
    for c in range(count):
        sharp &= p[c, BLUNT] == 1.0
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
                sub[k, s] = sub[k, s - 1]
                continue
            dt = h * (parts[s] - passed)
            passed = parts[s]
            if parts[s] == 1.0 and plain and not latched:
                _at_row(path, scene, moved, dt, k, sub[k, s])
                wrench[:] = sub[k, s]
                continue
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
                elif mount.there:
                    before = wrench.copy()
                    scene.slipped[:] = scene.met.slip
                    meet_next(scene, longest)
                    _press(scene, dt)
                    if mount.leapfrog:
                        slips = scene.touching, scene.met.slip, scene.slipped
                        part = touched(depth, scene.met.rate, p, dt, *slips)
                        if part >= 0.0 and k > 0:
                            touches += 1
                            part += STEP_SIGMA * split if touches == mount.early else 0.0
                            struck(mount, dt, part, wrench, before, *moving[:3])
                elif sharp and at == 1.0:
                    meet_near(scene, path.met.depth[k], lean)
                    _press(scene, dt)
                else:
                    _exert(scene, dt, False, wrench)
            if mount.there:
                mount_reading(mount.stiffness, mount.damping, moving[0], moving[2], sub[k, s])
            else:
                sub[k, s] = wrench
        if may_latch:
            scene.motions[0] = path.ends[k]
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
        meet_every(scene)
        last = path.poses[k - 1]
        return -scene.met.depth.max() > reach + swing + way_between(last, pose, longest)
    if lean == 0.0 and reach <= NEAR:
        depths = path.met.depth
        return clear > NEAR or (k > 0 and outside(depths[k], depths[k - 1], scene.p))
    return clear > reach + lean * away


@njit(cache=True)
def _to_row(path, mount, scene, moving, k):
    """Both sides as they are at row k."""
    scene.frames[0], scene.motions[0] = path.poses[k], path.ends[k]
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
    scene.frames[0], scene.motions[0] = poses[k], ends[k]
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
def _at_row(path, scene, moved, dt, k, wrench):
    """Add to ``wrench`` (6,) the contacts at row k, whose geometry is known but for the point of
    application, which is ``moved`` by this fraction of the overlap.
    """
    depths, rates, points, normals, slips = path.met
    point, slip = scene.met.point, scene.met.slip
    scene.frames[0], scene.motions[0] = path.poses[k], path.ends[k]
    point[:], slip[:] = points[k], slips[k]
    if moved != 0.0:
        move_lever(moved, depths[k], normals[k], path.ends[k], point, slip)
    met, laws = Met(depths[k], rates[k], point, normals[k], slip), _laws(scene, dt)
    surface_wrench(scene.geometry, laws, scene.frames, met, scene.work[7], wrench)


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
