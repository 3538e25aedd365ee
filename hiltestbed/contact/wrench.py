"""The contact wrench at an instant, from the contact geometry and the force law.

Normal force by the law (:mod:`hiltestbed.contact.law`); friction mu |F| v/sqrt(v^2 + v_0^2) with
v_0 = 1e-4 m/s, or larger with a servo, so that one physics step can resolve it. A latch holds A at
a pose in S by a spring and a damper on each of six axes, along z by the law.

The kernels serve the loop, where MuJoCo exerts the force that they compute
(:mod:`hiltestbed.contact.engagement`), and the replay, which needs only the wrench.
"""

from __future__ import annotations

import math

import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.contact import parameters as cp
from hiltestbed.contact.geometry import ACTIVE, PASSIVE, ROUND_FRAME, ROW, SIDE, SURFACE_FRAME, meet
from hiltestbed.contact.law import contact_force, touches
from hiltestbed.frames import (
    Array,
    pose_between,
    quat_mul,
    rotate,
    rotate_back,
    rotation_vector,
    wrench_moved,
)

CREEP = 1e-4  # [m/s] speed below which friction is viscous
LATCH_RADIUS = 0.15  # [m] of the ring of latches: the rotational stiffness is k LATCH_RADIUS^2


def tilts(parameters: Array) -> Array:
    """``(n, 7)`` pose of the tilted passive port in its nominal frame, R_y R_x."""
    x, y = 0.5 * parameters[:, cp.TILT_X], 0.5 * parameters[:, cp.TILT_Y]
    out = np.zeros((len(parameters), 7))
    out[:, 3], out[:, 4] = np.sin(x) * np.cos(y), np.cos(x) * np.sin(y)
    out[:, 5], out[:, 6] = -np.sin(x) * np.sin(y), np.cos(x) * np.cos(y)
    return out


@njit(cache=True)
def relate_one(pose, twist, place, motion, pose_out, twist_out, work):
    """Pose and twist of A relative to the moving frame S, in S. ``work`` (1, 3): scratch."""
    v = work[0]
    pose_between(place, pose, pose_out)
    ax, ay, az = pose[0] - place[0], pose[1] - place[1], pose[2] - place[2]
    wx, wy, wz = motion[3], motion[4], motion[5]
    v[0] = twist[0] - motion[0] - (wy * az - wz * ay)
    v[1] = twist[1] - motion[1] - (wz * ax - wx * az)
    v[2] = twist[2] - motion[2] - (wx * ay - wy * ax)
    rotate_back(place[3:7], v, twist_out[0:3])
    for j in range(3):
        v[j] = twist[3 + j] - motion[3 + j]
    rotate_back(place[3:7], v, twist_out[3:6])


@njit(cache=True)
def relate(pose, twist, place, motion, pose_out, twist_out):
    """All runs: pose (n, 7) and twist (n, 6) of A in S."""
    work = np.empty((1, 3))
    for i in range(pose.shape[0]):
        relate_one(pose[i], twist[i], place[i], motion[i], pose_out[i], twist_out[i], work)


@njit(cache=True)
def meet_all(geometry, p, frames, motions, work, met):
    """Contact geometry of the candidates of one run, with the parameters ``p`` (C, PARAMETERS).

    Args:
        frames, motions: (F, 7), (F, 6) poses and twists of the frames in W. work: (9, 7) scratch.
        met: a :class:`~hiltestbed.contact.geometry.Met`, written.
    """
    index = geometry[0]
    pose, twist, scratch = work[5], work[6][:6], work[:5, :3]
    a, s = -1, -1
    for c in range(met.depth.shape[0]):
        frame_a, frame_s = index[c * ROW + ROUND_FRAME], index[c * ROW + SURFACE_FRAME]
        if frame_a != a or frame_s != s:
            a, s = frame_a, frame_s
            relate_one(frames[a], motions[a], frames[s], motions[s], pose, twist, scratch)
        law = p[c, cp.LEVER], p[c, cp.BLUNT], max(0.0, -p[c, cp.OFFSET])
        meet(geometry, c, pose, twist, law, scratch, met)


@njit(cache=True)
def law_of(dt, least_creep, p, state, depth, rate, slip):
    """Normal force [N], and the tangential force over the ``slip`` (3,) [N s/m]."""
    push = contact_force(depth, rate, dt, p, state, False)
    if push == 0.0 or p[cp.FRICTION] == 0.0:
        return push, 0.0
    limit = p[cp.FRICTION] * abs(push)
    creep = max(CREEP, least_creep * limit)
    return push, limit / math.sqrt(slip[0] ** 2 + slip[1] ** 2 + slip[2] ** 2 + creep * creep)


@njit(cache=True)
def add_contact(push, drag, point, normal, slip, place, side, f, wrench):
    """Add to ``wrench`` (6,), in W at W's origin on the passive side, a contact on a surface whose
    frame is at ``place`` (7,).

    ``side``: 1 if the surface is on the passive side, else -1. ``f`` (6,) is scratch.
    """
    for j in range(3):
        f[j] = push * normal[j] + drag * slip[j]
    at = f[3:6]
    rotate(place[3:7], f[0:3], f[0:3])
    rotate(place[3:7], point, at)
    for j in range(3):
        at[j] += place[j]
        f[j] *= side
    add_at(at, f, wrench)


@njit(cache=True)
def contact_wrench(geometry, laws, sides, latched, hold, met, work, wrench):
    """The contacts of one run at an instant: ``wrench`` (6,) on the passive side, in W at W's
    origin. Returns whether they touch.

    Args:
        laws: time since the last instant [s], least creep (see :func:`law_of`), parameters
            (C + 1, PARAMETERS) of each candidate and of the latch, and states (C + 1, STATES) of
            the laws, which are updated. sides: (F, 7), (F, 6) poses and twists of the frames.
        met: a :class:`~hiltestbed.contact.geometry.Met`, written. work: (9, 7) scratch.
    """
    dt, _, p, state = laws
    frames, motions = sides
    wrench[:] = 0.0
    if latched:
        pose, twist = work[5], work[6][:6]
        a, s = (frames[ACTIVE], motions[ACTIVE]), (frames[PASSIVE], motions[PASSIVE])
        relate_one(*a, *s, pose, twist, work[:5, :3])
        latch_wrench(p[-1], dt, pose, twist, hold, state[-1], work[:4], work[7][:6])
        wrench_moved(frames[PASSIVE], work[7], wrench)
        return True
    meet_all(geometry, p, frames, motions, work, met)
    return surface_wrench(geometry, laws, frames, met, work[7], wrench)


@njit(cache=True)
def surface_wrench(geometry, laws, frames, met, f, wrench):
    """Add the laws' forces to ``wrench`` (6,); whether surfaces touch. ``f`` (6,): scratch."""
    index = geometry[0]
    dt, least_creep, p, state = laws
    touching = False
    for c in range(met.depth.shape[0]):
        depth, slip = met.depth[c], met.slip[c]
        push, drag = law_of(dt, least_creep, p[c], state[c], depth, met.rate[c], slip)
        touching |= touches(depth, push, p[c])
        if push != 0.0:
            frame, side = frames[index[c * ROW + SURFACE_FRAME]], index[c * ROW + SIDE]
            add_contact(push, drag, met.point[c], met.normal[c], slip, frame, side, f, wrench)
    return touching


@njit(cache=True)
def add_at(point, f, wrench):
    """Add to ``wrench`` (6,) a force ``f`` (3,) that acts at ``point`` (3,)."""
    for j in range(3):
        wrench[j] += f[j]
    wrench[3] += point[1] * f[2] - point[2] * f[1]
    wrench[4] += point[2] * f[0] - point[0] * f[2]
    wrench[5] += point[0] * f[1] - point[1] * f[0]


@njit(cache=True)
def latch_wrench(p, dt, pose, twist, hold, state, work, local):
    """``local`` (6,) in S at S's origin: springs and dampers between A and its held pose ``hold``
    in S, at A's origin; along z the law.

    ``work`` (4, >= 4): scratch.
    """
    turn, q, inverse, f = work[0, :3], work[1, :4], work[2, :4], work[3, :3]
    k, c = p[cp.STIFFNESS] * p[cp.SIDE_STIFFNESS], p[cp.DAMPING] * p[cp.SIDE_DAMPING]
    square = (LATCH_RADIUS * p[cp.RING]) ** 2
    for j in range(3):
        inverse[j] = -hold[3 + j]
        f[j] = k * (pose[j] - hold[j]) + c * twist[j]
    inverse[3] = hold[6]
    f[2] = contact_force(pose[2] - hold[2], twist[2], dt, p, state, True)
    quat_mul(pose[3:7], inverse, q)
    rotation_vector(q, turn)
    for j in range(3):
        local[j] = 0.0
        local[3 + j] = square * (k * turn[j] + c * twist[3 + j])
    add_at(pose[0:3], f, local)


@njit(cache=True)
def held_at(pose, wrench, place, p, hold):
    """``hold`` (7,): held pose of a latch that closes at ``pose`` under ``wrench`` (6,) in W."""
    f = np.empty(3)
    rotate_back(place[3:7], wrench[0:3], f)
    for j in range(7):
        hold[j] = pose[j]
    for j in range(3):
        hold[j] -= f[j] / (p[cp.STIFFNESS] if j == 2 else p[cp.STIFFNESS] * p[cp.SIDE_STIFFNESS])


@njit(cache=True)
def load_body(sign, wrench, body, centre, xfrc):
    """Write ``sign`` times the wrench (n, 6), in W at W's origin, to ``xfrc`` (n, nbody, 6) of a
    body.

    MuJoCo's ``xfrc_applied`` is force and torque at the body's centre of mass, ``centre`` (n, 3) in
    W.
    """
    for i in range(wrench.shape[0]):
        c, f, out = centre[i], wrench[i], xfrc[i, body]
        for j in range(3):
            out[j] = sign * f[j]
        out[3] = sign * (f[3] - (c[1] * f[2] - c[2] * f[1]))
        out[4] = sign * (f[4] - (c[2] * f[0] - c[0] * f[2]))
        out[5] = sign * (f[5] - (c[0] * f[1] - c[1] * f[0]))
