"""Two articles on air bearings over a flat floor: three degrees of freedom each, z (insertion), x
and rotation about the vertical y.

Disturbances compared with free flight: the floor is not level (a component of gravity in its
plane), the air film shears (viscous drag), the pads have a little friction, and hoses pull. Forces
on an article of mass m (float included), speed v and angular rate w:

    tilt      m g (sin a_x, sin a_z)                 film   -b v,  -b r^2 w
    friction  -mu m g v/sqrt(v^2 + v_0^2)  hose  -k (x - x_0) - c v, x_0 the start position
"""

from __future__ import annotations

import math
from collections.abc import Hashable

import mujoco
import numpy as np

from hiltestbed.config.models import load
from hiltestbed.frames import Array
from hiltestbed.platform.facilities.bodies import SIDES, Bodies, PhysicalFacility
from hiltestbed.platform.facilities.facility import MOUNT
from hiltestbed.platform.facilities.inverse_dynamics import GRAVITY
from hiltestbed.platform.facilities.kinematics import Kinematics
from hiltestbed.platform.facilities.mover import Runs
from hiltestbed.platform.shipped.halls import AirBearingSettings

CREEP = 1e-4  # [m/s] v_0, speed below which the pads' friction fades


class Floats(Bodies):
    """Articles of `n` runs on their air films."""

    def __init__(self, model: mujoco.MjModel, kinematics: Kinematics, runs: Runs) -> None:
        super().__init__(model, kinematics, runs)
        moving = [side for side in SIDES if model.body(side).jntnum[0]]
        joints = [[model.joint(f"{side}_{name}") for name in ("x", "z", "turn")] for side in moving]
        # (b, 3) degrees of freedom of each article; (b, 2) addresses of its place
        self._dofs = np.array([[int(j.dofadr[0]) for j in row] for row in joints])
        self._places = np.array([[int(j.qposadr[0]) for j in row[:2]] for row in joints])
        self._weights = GRAVITY * np.array([model.body(s).subtreemass[0] for s in moving])
        self._origin = np.zeros((len(runs.settings), len(moving), 2))  # rest of the hoses [m]
        names = ("film_damping", "pad_radius", "friction", "hose_stiffness", "hose_damping")
        self._numbers = [runs.numbers(name)[:, None] for name in names]
        tilt = np.array([s.tilt for s in runs.settings], dtype=float)
        self._along = self._weights[:, None] * np.vectorize(math.sin)(tilt)[:, None]

    def rest(self, qpos: Array, qvel: Array) -> None:
        self._origin[:] = qpos[:, self._places]

    def push(self, sub: int, qpos: Array, qvel: Array, inputs: Array) -> None:
        film, radius, friction, hose, loss = self._numbers
        speed = qvel[:, self._dofs]
        vx, vz = speed[..., 0], speed[..., 1]
        rub = friction * self._weights / np.sqrt(vx * vx + vz * vz + CREEP * CREEP)
        drag, pull = film + loss + rub, hose[..., None] * (qpos[:, self._places] - self._origin)
        inputs[:, self._dofs[:, :2]] = self._along - drag[..., None] * speed[..., :2] - pull
        inputs[:, self._dofs[:, 2]] = -(film + rub) * radius * radius * speed[..., 2]


class AirBearing(PhysicalFacility):
    """The floor of ``models/air_bearing``."""

    settings: AirBearingSettings

    def spec(self) -> mujoco.MjSpec:
        spec = load("air_bearing/air_bearing")
        s = self.settings
        ride = 0.5 * s.float_mass * s.pad_radius**2  # a disc about the vertical
        for side in SIDES:
            place, body = self.place_of(side), spec.body(side)
            body.pos, body.quat = place[:3], [place[6], *place[3:6]]
            for joint in list(body.joints):
                # the joints are along the floor's axes, whatever the body's attitude
                if self.moves(side):
                    joint.axis = self.in_body(side, np.array(joint.axis))
                else:
                    spec.delete(joint)
            self.fit(spec, side, s.float_mass, ride * np.diag([0.5, 1.0, 0.5]))
        self.add_ports(spec)
        return spec

    def drives(self, model: mujoco.MjModel, runs: Runs, tool: str = MOUNT) -> Floats:
        return Floats(model, self.kinematics(model, tool), runs)

    def alike(self) -> Hashable:
        return (self.kind, self.settings.target, self.settings.float_mass, self.settings.pad_radius)
