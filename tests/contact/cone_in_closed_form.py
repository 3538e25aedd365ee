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
SOCKET_RADIUS = 0.035
HALF_ANGLE = math.radians(45.0)
GENERATOR = 0.20
SHELL = 0.012


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
