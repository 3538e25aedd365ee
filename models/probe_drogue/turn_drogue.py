"""Writes drogue.obj: the shell of README.md turned about z, its rings on the profile's exact curve.

python models/probe_drogue/turn_drogue.py
"""

import math
from pathlib import Path

from hiltestbed.contact.surfaces.turned import obj_text, polyline, shell, turn

PROFILE = shell(socket=0.045, half_angle=math.radians(60.0), generator=0.413, thickness=0.02)
SEGMENTS = 96
ARC_STEP = math.radians(5.0)

if __name__ == "__main__":
    vertices, faces = turn(polyline(PROFILE, ARC_STEP), SEGMENTS)
    Path(__file__).with_name("drogue.obj").write_text(
        obj_text(vertices, faces, "Shell of README.md, turned about z by turn_drogue.py")
    )
