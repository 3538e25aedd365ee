"""The cone in closed form, from the dimensions that its drawing states: a check of what the contact
reads from the meshes.

The cone is a shell of thickness 2 e about a mid-surface of revolution: a socket, the inside of a
ball of radius R that touches P's origin from below, then a straight generator at the half angle
alpha, tangent to it, of length L. Its end is the rim, rounded with the radius e; past it the
outside of the shell.
"""

from __future__ import annotations

import math

from hiltestbed.frames import Array

TIP_RADIUS = 0.03
ROD_RADIUS = 0.018
ROD_LENGTH = 0.35
SOCKET_RADIUS = 0.035
HALF_ANGLE = math.radians(45.0)
GENERATOR = 0.20
SHELL = 0.012
RING_STEPS = 24  # places on the rim from which the one nearest to the rod is refined


def cone_distance(p: Array, free: Array) -> float:
    """Distance [m] of the point ``p`` (3,) from the cone's surface, negative inside its shell;
    ``free`` (3,) becomes the normal.
    """
    big, e = SOCKET_RADIUS, SHELL
    sin, cos = math.sin(HALF_ANGLE), math.cos(HALF_ANGLE)
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
        past = along - min(along, GENERATOR)
        off = big + e - (cos * rho + sin * z)  # from the mid-surface, positive on the inside
        away = math.hypot(past, off)
        if away < 1e-12:
            nr, nz = -cos, -sin
        else:
            nr, nz = (past * sin - off * cos) / away, (-past * cos - off * sin) / away
        distance = away - e
    free[0], free[1], free[2] = nr * ux, nr * uy, nz
    return distance


def rod_distance(tip: Array, axis: Array, free: Array, nearest: Array) -> float:
    """Distance [m] of the rod's axis from the rim's surface; ``free`` (3,) becomes the normal,
    ``nearest`` (3,) the axis' point.

    The rim is a ring of radius rho_e in the plane z_e, rounded with the shell's half thickness; the
    rod runs from ``tip`` (3,) against ``axis`` (3,) for its length, from where the ball of the tip
    has let go of it.
    """
    big, e, start, length = SOCKET_RADIUS, SHELL, TIP_RADIUS, ROD_LENGTH
    sin, cos = math.sin(HALF_ANGLE), math.cos(HALF_ANGLE)
    ring = (big + e) * cos + GENERATOR * sin
    level = (big + e) * sin - big - GENERATOR * cos
    best, at = math.inf, 0.0
    step = 2.0 * math.pi / RING_STEPS
    for k in range(RING_STEPS):
        d2 = _ring_to_rod(k * step, ring, level, tip, axis, start, length, free)
        if d2 < best:
            best, at = d2, k * step
    # the squared distance is smooth in the angle: parabolas through three points
    for _ in range(5):
        low = _ring_to_rod(at - step, ring, level, tip, axis, start, length, free)
        high = _ring_to_rod(at + step, ring, level, tip, axis, start, length, free)
        mid = _ring_to_rod(at, ring, level, tip, axis, start, length, free)
        bend = low - 2.0 * mid + high
        if bend > 1e-18:
            at += step * min(max(0.5 * (low - high) / bend, -1.0), 1.0)
        step *= 0.1
    distance = math.sqrt(_ring_to_rod(at, ring, level, tip, axis, start, length, free))
    nearest[0] = ring * math.cos(at) + free[0]
    nearest[1] = ring * math.sin(at) + free[1]
    nearest[2] = level + free[2]
    for j in range(3):
        free[j] /= max(distance, 1e-12)
    return distance - e


def _ring_to_rod(
    angle: float,
    ring: float,
    level: float,
    tip: Array,
    axis: Array,
    start: float,
    length: float,
    gap: Array,
) -> float:
    """Squared distance of the ring's point at ``angle`` from the rod; ``gap`` (3,): becomes it."""
    gap[0] = tip[0] - ring * math.cos(angle)
    gap[1] = tip[1] - ring * math.sin(angle)
    gap[2] = tip[2] - level
    back = min(max(gap[0] * axis[0] + gap[1] * axis[1] + gap[2] * axis[2], start), length)
    for j in range(3):
        gap[j] -= back * axis[j]
    return gap[0] * gap[0] + gap[1] * gap[1] + gap[2] * gap[2]
