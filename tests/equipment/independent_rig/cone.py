"""The contact surfaces of this rig's docking mechanism: a ball on a rod against a funnel of
revolution with a socket at its apex.

Computed in the half-plane (rho, z) through the axis, with z along the insertion and P's origin on
the bottom of the socket. The wall is a strip of constant thickness about a straight middle line
that ends in a round rim; the socket is the inside of a sphere to which the strip's inner face is
tangent. The passive surface can also be a flat plate, z = 0.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from hiltestbed.compiled.jit import njit

FIRST_LOOK = 16  # intervals of a coarse search along the rod for the point nearest to the rim
GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
REFINED = 40  # golden-section steps of its refinement: the last interval is 4e-9 of the first


class Surfaces(NamedTuple):
    """Dimensions of probe and cone [m, rad]; reasons in `models/probe_cone`."""

    tip: float = 0.03  # radius of the ball
    rod: float = 0.018  # radius
    rod_length: float = 0.35  # from the ball's centre
    socket: float = 0.035  # radius
    half_angle: float = math.radians(45.0)
    generator: float = 0.20  # length of the straight wall
    half_wall: float = 0.012
    flat: bool = False  # a plate instead of the cone
    oval: float = 0.0  # foreign: the wall's radius varies as 1 + oval cos(2 azimuth)


@njit(cache=True)
def clearance(s, p, normal):
    """Distance [m] of the point p (3,) from the passive surface, negative inside; `normal` (3,) is
    set to the outward normal.
    """
    if s.flat:
        normal[0] = normal[1] = 0.0
        normal[2] = -1.0
        return -p[2]
    rho = math.sqrt(p[0] * p[0] + p[1] * p[1])
    out_x, out_y = (p[0] / rho, p[1] / rho) if rho > 1e-14 else (1.0, 0.0)
    wall_r, wall_z = math.sin(s.half_angle), -math.cos(s.half_angle)  # along the wall, outwards
    deep_r, deep_z = math.cos(s.half_angle), math.sin(s.half_angle)  # into the wall
    to_r, to_z = rho, p[2] + s.socket  # from the socket's centre
    along = to_r * wall_r + to_z * wall_z
    if along <= 0.0:
        reach = math.sqrt(to_r * to_r + to_z * to_z)
        distance = s.socket - reach
        n_r, n_z = (-to_r / reach, -to_z / reach) if reach > 1e-12 else (0.0, -1.0)
        normal[0], normal[1], normal[2] = n_r * out_x, n_r * out_y, n_z
        return distance
    middle = s.socket + s.half_wall
    foot = min(along, s.generator)
    gap_r = to_r - middle * deep_r - foot * wall_r
    gap_z = to_z - middle * deep_z - foot * wall_z
    away = math.sqrt(gap_r * gap_r + gap_z * gap_z)
    n_r, n_z = (gap_r / away, gap_z / away) if away > 1e-12 else (-deep_r, -deep_z)
    distance = away - s.half_wall
    normal[0], normal[1], normal[2] = n_r * out_x, n_r * out_y, n_z
    if s.oval != 0.0:
        distance += _oval(s, foot, 1.0 if along <= s.generator else 0.0, rho, out_x, out_y, normal)
    return distance


@njit(cache=True)
def _oval(s, foot, grows, rho, out_x, out_y, normal):
    """Distance added by an oval wall, to first order; also corrects the normal."""
    cos2, sin2 = out_x * out_x - out_y * out_y, 2.0 * out_x * out_y
    size = s.oval * math.sin(s.half_angle) * math.cos(s.half_angle)
    wall_r, wall_z = math.sin(s.half_angle), -math.cos(s.half_angle)
    slope = size * cos2 * grows
    round_about = -2.0 * size * foot * sin2 / max(rho, 1e-9)
    normal[0] += slope * wall_r * out_x - round_about * out_y
    normal[1] += slope * wall_r * out_y + round_about * out_x
    normal[2] += slope * wall_z
    length = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    for i in range(3):
        normal[i] /= length
    return size * foot * cos2


@njit(cache=True)
def _to_ring(s, ball, axis, back, ring, level):
    """Distance [m] to the ring from the rod's axis at `back` behind the ball's centre."""
    x, y, z = ball[0] - back * axis[0], ball[1] - back * axis[1], ball[2] - back * axis[2]
    wide = math.sqrt(x * x + y * y) - ring
    return math.sqrt(wide * wide + (z - level) ** 2)


@njit(cache=True)
def rod_clearance(s, ball, axis, normal, place):
    """Distance [m] of the rod's axis, between ball and rod end, from the rim's surface.

    ball, axis: (3,) the ball's centre and the direction in which the probe points. normal (3,) is
        set to the rim's outward normal, place (3,) to the nearest point on the rod's axis. Far from
        the rim the distance is a lower bound and neither is set.
    """
    # of the ring that is the centre line of the round rim
    middle, sine, cosine = s.socket + s.half_wall, math.sin(s.half_angle), math.cos(s.half_angle)
    ring = middle * cosine + s.generator * sine
    level = middle * sine - s.socket - s.generator * cosine
    # lower bound: distance of the rod from the ring in the rim's plane, times cos(tilt)
    if axis[2] > 0.5:
        back = (ball[2] - level) / axis[2]
        x, y = ball[0] - back * axis[0], ball[1] - back * axis[1]
        bound = (ring - math.sqrt(x * x + y * y)) * axis[2] - s.half_wall
        if bound > 2.0 * s.rod:
            return bound
    step = (s.rod_length - s.tip) / FIRST_LOOK
    best, at = math.inf, s.tip
    for i in range(FIRST_LOOK + 1):
        found = _to_ring(s, ball, axis, s.tip + i * step, ring, level)
        if found < best:
            best, at = found, s.tip + i * step
    low, high = max(at - step, s.tip), min(at + step, s.rod_length)
    for _ in range(REFINED):
        left, right = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
        if _to_ring(s, ball, axis, left, ring, level) < _to_ring(s, ball, axis, right, ring, level):
            high = right
        else:
            low = left
    at = 0.5 * (low + high)
    for i in range(3):
        place[i] = ball[i] - at * axis[i]
    rho = math.sqrt(place[0] ** 2 + place[1] ** 2)
    out_x, out_y = (place[0] / rho, place[1] / rho) if rho > 1e-14 else (1.0, 0.0)
    normal[0], normal[1] = place[0] - ring * out_x, place[1] - ring * out_y
    normal[2] = place[2] - level
    away = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    for i in range(3):
        normal[i] /= max(away, 1e-12)
    return away - s.half_wall
