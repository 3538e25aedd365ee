"""Writes cone.obj: the shell of README.md turned about z, its rings on the profile's exact curve.

python models/probe_cone/turn_cone.py
"""

import math
from pathlib import Path

from hiltestbed.contact.surfaces.profile import Element
from hiltestbed.contact.surfaces.turned import obj_text, polyline, turn

SOCKET = 0.035  # [m] radius of the ball at the apex, its bottom at the origin
HALF_ANGLE = math.radians(45.0)
GENERATOR = 0.20  # [m] straight part, tangent to the socket
THICKNESS = 0.024  # [m] of the shell; the rim is rounded with half of it
SEGMENTS = 96
ARC_STEP = math.radians(5.0)


def profile() -> list[Element]:
    """(rho, z) [m], the free side on the left: back, outside, rim, inside, socket."""
    sin, cos = math.sin(HALF_ANGLE), math.cos(HALF_ANGLE)

    def across(distance: float, along: float) -> tuple[float, float]:
        """A point ``along`` the generator from where it touches the socket, ``distance`` from the socket's centre across it."""
        return distance * cos + along * sin, distance * sin - SOCKET - along * cos

    outer = SOCKET + THICKNESS
    back = ((outer - sin * outer) / cos, THICKNESS)
    rim = across(SOCKET + 0.5 * THICKNESS, GENERATOR)
    lip, mouth, throat = across(outer, GENERATOR), across(SOCKET, GENERATOR), across(SOCKET, 0.0)
    return [
        Element((0.0, THICKNESS), back),
        Element(back, lip),
        Element(lip, mouth, rim, clockwise=True),
        Element(mouth, throat),
        Element(throat, (0.0, 0.0), (0.0, -SOCKET)),
    ]


if __name__ == "__main__":
    vertices, faces = turn(polyline(profile(), ARC_STEP), SEGMENTS)
    comment = "Shell of the cone: back, outside, rim, inside and socket of README.md, turned about z by turn_cone.py"
    Path(__file__).with_name("cone.obj").write_text(obj_text(vertices, faces, comment))
