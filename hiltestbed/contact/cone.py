"""Where the active mechanism meets the passive one, in closed form: penetration, its rate, the point and the normal.

Two contacts a rig: the tip's ball against the nearest point of the passive surface, and (probe and cone) the rod against the rim.
Surfaces are those of the passive mechanism's own frame S, which is P while nothing yields. A signed distance in closed form gives
one contact and an exact normal anywhere: what a moving tangent facet would give, without a geom to move.

The cone is a shell of thickness 2 e about a mid-surface of revolution: a socket, the inside of a ball of radius R that touches S's
origin from below, then a straight generator at the half angle alpha, tangent to it, of length L. Its end is the rim, rounded with the
radius e; past it the outside of the shell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from hiltestbed.frames import Array, rotate

PLANE, CONE = 0, 1
TIP, ROD = 0, 1
TIP_RADIUS, ROD_RADIUS, ROD_LENGTH, SOCKET_RADIUS, HALF_ANGLE, GENERATOR, SHELL = range(7)
RING_STEPS = 24  # places on the rim from which the one nearest to the rod is refined


@dataclass(frozen=True)
class Surfaces:
    """The touching surfaces of a mechanism: PLANE or CONE, and its dimensions [m, rad] in the order of the names above."""

    kind: int
    sizes: Array


BUMPER = Surfaces(PLANE, np.array([0.02, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
PROBE_CONE = Surfaces(CONE, np.array([0.03, 0.018, 0.35, 0.035, math.radians(45.0), 0.20, 0.012]))


@njit(cache=True)
def meet(kind, sizes, pose, twist, lever, blunt, work, depth, rate, point, normal, slip):
    """The contacts of one run.

    Args:
        pose, twist: (7,), (6,) of A in S. lever: where in the overlap the force acts, 0 at the undeformed surface, 1 at the tip.
        blunt: 1 where the ball of the tip touches a plane, 0 where its foremost point does.
        work: (6, 3) scratch.
        depth, rate: (2,) penetration [m], negative while apart, and its rate [m/s].
        point, normal, slip: (2, 3) where the force acts [m], direction in which the passive side is pushed, and velocity of the
            active side across it [m/s], all in S.
    """
    axis, centre, free, nearest, v = work[0], work[1], work[2], work[3], work[4]
    axis[0] = axis[1] = 0.0
    axis[2] = 1.0
    rotate(pose[3:7], axis, axis)
    r = sizes[TIP_RADIUS]
    for j in range(3):
        centre[j] = pose[j] - r * axis[j]
    if kind == PLANE:
        free[0] = free[1] = 0.0
        free[2] = -1.0
        distance = -centre[2] + (1.0 - blunt) * r * (1.0 - axis[2])
    else:
        distance = cone_distance(sizes, centre, free)
    _contact(TIP, r - distance, r, lever, centre, free, v, pose, twist, depth, rate, point, normal, slip)
    if kind == CONE:
        distance = rod_distance(sizes, centre, axis, free, nearest)
        centre[:] = nearest
        _contact(
            ROD, sizes[ROD_RADIUS] - distance, sizes[ROD_RADIUS], lever, centre, free, v, pose, twist, depth, rate, point, normal, slip
        )
    else:
        depth[ROD] = -1.0


@njit(cache=True)
def _contact(c, x, radius, lever, centre, free, v, pose, twist, depth, rate, point, normal, slip):
    """Contact ``c`` of a round of ``radius`` about ``centre`` with a surface whose outward normal is ``free``, overlapping by x."""
    depth[c] = x
    for j in range(3):
        point[c, j] = centre[j] - free[j] * (radius - (1.0 - lever) * x)
        normal[c, j] = -free[j]
    ax, ay, az = point[c, 0] - pose[0], point[c, 1] - pose[1], point[c, 2] - pose[2]
    v[0] = twist[0] + twist[4] * az - twist[5] * ay
    v[1] = twist[1] + twist[5] * ax - twist[3] * az
    v[2] = twist[2] + twist[3] * ay - twist[4] * ax
    into = -(v[0] * free[0] + v[1] * free[1] + v[2] * free[2])
    rate[c] = into
    for j in range(3):
        slip[c, j] = v[j] + into * free[j]


@njit(cache=True)
def cone_distance(sizes, p, free):
    """Distance [m] of the point ``p`` (3,) from the cone's surface, negative inside its shell; ``free`` (3,) becomes the normal."""
    big, e = sizes[SOCKET_RADIUS], sizes[SHELL]
    sin, cos = math.sin(sizes[HALF_ANGLE]), math.cos(sizes[HALF_ANGLE])
    rho = math.hypot(p[0], p[1])
    ux, uy = (p[0] / rho, p[1] / rho) if rho > 1e-15 else (1.0, 0.0)
    z = p[2] + big  # above the socket's centre
    along = sin * rho - cos * z  # along the generator, from where it touches the socket
    if along < 0.0:
        away = math.hypot(rho, z)
        if away < 1e-12:
            nr, nz = 0.0, -1.0
        else:
            nr, nz = -rho / away, -z / away
        distance = big - away
    else:
        past = along - min(along, sizes[GENERATOR])
        off = big + e - (cos * rho + sin * z)  # from the mid-surface, positive on the inside
        away = math.hypot(past, off)
        if away < 1e-12:
            nr, nz = -cos, -sin
        else:
            nr, nz = (past * sin - off * cos) / away, (-past * cos - off * sin) / away
        distance = away - e
    free[0], free[1], free[2] = nr * ux, nr * uy, nz
    return distance


@njit(cache=True)
def rod_distance(sizes, tip, axis, free, nearest):
    """Distance [m] of the rod's axis from the rim's surface; ``free`` (3,) becomes the normal, ``nearest`` (3,) the axis' point.

    The rim is a ring of radius rho_e in the plane z_e, rounded with the shell's half thickness; the rod runs from ``tip`` (3,)
    against ``axis`` (3,) for its length, from where the ball of the tip has let go of it.
    """
    big, e, start, length = sizes[SOCKET_RADIUS], sizes[SHELL], sizes[TIP_RADIUS], sizes[ROD_LENGTH]
    sin, cos = math.sin(sizes[HALF_ANGLE]), math.cos(sizes[HALF_ANGLE])
    ring = (big + e) * cos + sizes[GENERATOR] * sin
    level = (big + e) * sin - big - sizes[GENERATOR] * cos
    best, at = math.inf, 0.0
    step = 2.0 * math.pi / RING_STEPS
    for k in range(RING_STEPS):
        d2 = _ring_to_rod(k * step, ring, level, tip, axis, start, length, free)
        if d2 < best:
            best, at = d2, k * step
    for _ in range(5):  # the squared distance is smooth in the angle: parabolas through three points
        low = _ring_to_rod(at - step, ring, level, tip, axis, start, length, free)
        high = _ring_to_rod(at + step, ring, level, tip, axis, start, length, free)
        mid = _ring_to_rod(at, ring, level, tip, axis, start, length, free)
        bend = low - 2.0 * mid + high
        if bend > 1e-18:
            at += step * min(max(0.5 * (low - high) / bend, -1.0), 1.0)
        step *= 0.1
    distance = math.sqrt(_ring_to_rod(at, ring, level, tip, axis, start, length, free))
    nearest[0], nearest[1], nearest[2] = ring * math.cos(at) + free[0], ring * math.sin(at) + free[1], level + free[2]
    for j in range(3):
        free[j] /= max(distance, 1e-12)
    return distance - e


@njit(cache=True)
def _ring_to_rod(angle, ring, level, tip, axis, start, length, gap):
    """Squared distance from the ring's point at ``angle`` to the rod's axis; ``gap`` (3,) becomes the vector."""
    gap[0] = tip[0] - ring * math.cos(angle)
    gap[1] = tip[1] - ring * math.sin(angle)
    gap[2] = tip[2] - level
    back = min(max(gap[0] * axis[0] + gap[1] * axis[1] + gap[2] * axis[2], start), length)
    for j in range(3):
        gap[j] -= back * axis[j]
    return gap[0] * gap[0] + gap[1] * gap[1] + gap[2] * gap[2]


@njit(cache=True)
def beyond_rim(sizes, p):
    """Whether the point ``p`` (3,) lies on the far side of the plane of the rim: before that the rod cannot reach it."""
    big, e = sizes[SOCKET_RADIUS], sizes[SHELL]
    sin, cos = math.sin(sizes[HALF_ANGLE]), math.cos(sizes[HALF_ANGLE])
    return p[2] > (big + e) * sin - big - sizes[GENERATOR] * cos - e
