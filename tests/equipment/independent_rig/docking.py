"""The docking mechanism of this rig: tip and rod against the passive surfaces, friction, and a
latch that holds six axes.

All quantities are in the passive port's own frame S, which is P without compliance and tilt of the
port. The normal force of tip and rod is the law of `contact` along the surface's normal; its point
of application is between the undeformed surface (lever 0) and the ball's foremost point (lever 1).
A latch holds A at a pose in S: by the law along the insertion, and by springs and dampers on the
other five axes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hiltestbed.compiled.jit import njit
from tests.equipment.independent_rig import contact as law_of
from tests.equipment.independent_rig.cone import Surfaces, clearance, rod_clearance
from tests.equipment.independent_rig.contact import SLIDING, Contact
from tests.equipment.independent_rig.mount import Mount
from tests.equipment.independent_rig.rotation import (
    add_moment,
    apply,
    apply_back,
    inverse,
    matrix,
    product,
    turn_of,
)

TIP, ROD = 0, 1


class Docking(NamedTuple):
    """Geometry, latch and mount of the mechanism, in addition to the contact law. SI, in S."""

    surfaces: Surfaces
    # the law along the insertion once latched; the other axes have only its spring and damper
    held: Contact
    mount: Mount
    captures: bool = False
    latch_depth: float = 0.0  # m before the nominal touch, at most
    latch_cosine: float = 1.0  # of the angle between the axes, at least
    latch_speed: float = 0.0  # m/s, at most
    from_start: bool = False  # latched from the start, at the nominal touch
    # m, radius of the ring of latches: the rotational stiffness is that of the latch times its
    # square
    ring: float = 0.15


@njit(cache=True)
def meet(law, surfaces, pose, twist, which, point, normal, slip):
    """Penetration [m] and rate [m/s] of tip or rod at the pose (7,) and twist (6,) of A.

    point, normal, slip: (3,) point of application, direction of the force on the passive side,
        tangential velocity [m/s].
    """
    turned = matrix(pose[3:7])
    axis, centre = np.empty(3), np.empty(3)
    for i in range(3):
        axis[i] = turned[i, 2]
        centre[i] = pose[i] - surfaces.tip * axis[i]
    if which == TIP:
        radius = surfaces.tip
        x = radius - clearance(surfaces, centre, normal)
    else:
        radius = surfaces.rod
        place = centre.copy()
        x = radius - rod_clearance(surfaces, centre, axis, normal, place)
        centre = place
    if x <= -radius and not surfaces.flat:  # far away: neither normal nor point matter
        normal[:] = 0.0
        normal[2] = 1.0
        return x, 0.0
    v = np.empty(3)
    for i in range(3):
        normal[i] = -normal[i]
        point[i] = centre[i] + normal[i] * (radius - (1.0 - law.lever) * x)
    a0, a1, a2 = point[0] - pose[0], point[1] - pose[1], point[2] - pose[2]
    v[0] = twist[0] + twist[4] * a2 - twist[5] * a1
    v[1] = twist[1] + twist[5] * a0 - twist[3] * a2
    v[2] = twist[2] + twist[3] * a1 - twist[4] * a0
    rate = v[0] * normal[0] + v[1] * normal[1] + v[2] * normal[2]
    for i in range(3):
        slip[i] = v[i] - rate * normal[i]
    return x - law.touch, rate


@njit(cache=True)
def add_at(point, force, out):
    """Add a force (3,) at `point` (3,) to the wrench (6,) at the origin."""
    for i in range(3):
        out[i] += force[i]
    add_moment(point[0], point[1], point[2], force, 1.0, out)


@njit(cache=True)
def touch_wrench(law, surfaces, pose, twist, states, out, seen):
    """Wrench (6,) of tip and rod on the passive side at S's origin.

    states: (2, STATES) of the law, tip and rod. seen: (2, 2) output, penetration [m] and rate
        [m/s].
    """
    for i in range(6):
        out[i] = 0.0
    point, normal, slip = np.zeros(3), np.zeros(3), np.zeros(3)
    push = np.empty(3)
    for which in range(2):
        if which == ROD and surfaces.flat:
            seen[which, 0], seen[which, 1] = -1.0, 0.0
            continue
        x, rate = meet(law, surfaces, pose, twist, which, point, normal, slip)
        seen[which, 0], seen[which, 1] = x, rate
        if x <= 0.0 and law.mode_w == 0.0:
            continue
        force = law_of.force_on(law, x, rate, states[which])
        read = law_of.carried(law, force, states[which])
        if force == 0.0 and read == 0.0:
            continue
        rub = law.friction * (1.0 + law.friction_load * abs(force)) * abs(force)
        drag = rub / math.sqrt(slip[0] ** 2 + slip[1] ** 2 + slip[2] ** 2 + SLIDING**2)
        for i in range(3):
            push[i] = read * normal[i] + drag * slip[i]
        if law.side != 0.0:
            push[0] += force * law.side * x
        add_at(point, push, out)


@njit(cache=True)
def latch_wrench(docking, pose, twist, hold, states, out, seen):
    """Wrench (6,) of the latch that holds A at `hold` (7,); arguments as in `touch_wrench`."""
    law = docking.held
    for i in range(6):
        out[i] = 0.0
    seen[ROD, 0], seen[ROD, 1] = -1.0, 0.0
    x = pose[2] - hold[2] - law.touch
    if law.play > 0.0:
        x = math.copysign(max(abs(x) - 0.5 * law.play, 0.0), x)
    seen[TIP, 0], seen[TIP, 1] = x, twist[2]
    force = np.empty(3)
    for i in range(2):
        force[i] = law.stiffness * (pose[i] - hold[i]) + law.damping * twist[i]
    along = law_of.force_on(law, x, twist[2], states[TIP])
    force[2] = law_of.carried(law, along, states[TIP])
    add_at(pose[:3], force, out)
    away = turn_of(product(pose[3:7], inverse(hold[3:7])))
    for i in range(3):
        out[3 + i] += docking.ring**2 * (law.stiffness * away[i] + law.damping * twist[3 + i])


@njit(cache=True)
def due(docking, pose, twist):
    """Whether the latch closes at this pose (7,) and twist (6,) of A in S."""
    cosine = 1.0 - 2.0 * (pose[3] ** 2 + pose[4] ** 2)
    speed = math.sqrt(twist[0] ** 2 + twist[1] ** 2 + twist[2] ** 2)
    return (
        pose[2] >= -docking.latch_depth
        and cosine >= docking.latch_cosine
        and speed <= docking.latch_speed
    )


@njit(cache=True)
def relate(pose, twist, y, tilt, pose_out, twist_out):
    """Pose (7,) and twist (6,) of A in S, from those in P, the state y (13,) of S, and the port's
    tilt (4,).

    Returns the attitude of S as a matrix (3, 3).
    """
    attitude = product(y[3:7], tilt)
    into = matrix(attitude)
    ax, ay, az = pose[0] - y[0], pose[1] - y[1], pose[2] - y[2]
    wx, wy, wz = y[10], y[11], y[12]
    apply_back(into, ax, ay, az, pose_out)
    pose_out[3:] = product(inverse(attitude), pose[3:7])
    vx = twist[0] - y[7] - (wy * az - wz * ay)
    vy = twist[1] - y[8] - (wz * ax - wx * az)
    vz = twist[2] - y[9] - (wx * ay - wy * ax)
    apply_back(into, vx, vy, vz, twist_out)
    apply_back(into, twist[3] - wx, twist[4] - wy, twist[5] - wz, twist_out[3:])
    return into


@njit(cache=True)
def wrench_in_place(sides, pose, twist, y, latched, hold, states, out, seen):
    """Wrench (6,) of active on passive side in P at P's origin, for the pose (7,) and twist (6,) of
    A in P and the state y (13,) of S.

    ``sides``: law and docking.
    """
    law, docking = sides
    local_pose, local_twist, local = np.empty(7), np.empty(6), np.empty(6)
    into = relate(pose, twist, y, law.tilt, local_pose, local_twist)
    if latched:
        latch_wrench(docking, local_pose, local_twist, hold, states, local, seen)
    else:
        touch_wrench(law, docking.surfaces, local_pose, local_twist, states, local, seen)
    apply(into, local[0], local[1], local[2], out)
    apply(into, local[3], local[4], local[5], out[3:])
    add_moment(y[0], y[1], y[2], out, 1.0, out)


@njit(cache=True)
def close(sides, pose, twist, y, states, hold):
    """Whether the latch closes: `hold` (7,) is then where its springs bear the current force."""
    law, docking = sides
    local_pose, local_twist, wrench, seen = np.empty(7), np.empty(6), np.empty(6), np.empty((2, 2))
    relate(pose, twist, y, law.tilt, local_pose, local_twist)
    if not due(docking, local_pose, local_twist):
        return False
    touch_wrench(law, docking.surfaces, local_pose, local_twist, states, wrench, seen)
    hold[:] = local_pose
    for i in range(3):
        hold[i] -= wrench[i] / docking.held.stiffness
    return True
