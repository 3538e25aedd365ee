"""Writes cone.obj: the shell of README.md turned about z, its rings on the profile's exact curve.

python models/probe_cone/turn_cone.py
"""

import math
from pathlib import Path

from hiltestbed.contact.surfaces.turned import obj_text, polyline, shell, turn

PROFILE = shell(socket=0.035, half_angle=math.radians(45.0), generator=0.20, thickness=0.024)
SEGMENTS = 96
ARC_STEP = math.radians(5.0)

if __name__ == "__main__":
    vertices, faces = turn(polyline(PROFILE, ARC_STEP), SEGMENTS)
    Path(__file__).with_name("cone.obj").write_text(
        obj_text(vertices, faces, "Shell of README.md, turned about z by turn_cone.py")
    )
