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
from functools import cached_property
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.config.models import load
from hiltestbed.frames import Array
from hiltestbed.platform.facilities.bodies import SIDES, Bodies, PhysicalFacility
from hiltestbed.platform.facilities.facility import MOUNT
from hiltestbed.platform.facilities.mover import Runs
from hiltestbed.platform.payload import GRAVITY
from hiltestbed.platform.shipped.halls import AirBearingSettings

CREEP = 1e-4  # [m/s] v_0, speed below which the pads' friction fades
TILT_X, TILT_Z, FILM, RADIUS, RUB, HOSE, HOSE_DAMPING = range(7)  # parameters of a run


class Pads(NamedTuple):
    """The moving articles of n runs.

    Attributes:
        numbers: (n, 7). dofs, qadr: (b, 3) x, z and rotation of each article. masses: (b,) [kg].
            origin: (n, b, 2) rest position of the hoses [m].
    """

    numbers: Array
    dofs: NDArray[np.int64]
    qadr: NDArray[np.int64]
    masses: Array
    origin: Array


@njit(cache=True)
def _push(pads, qpos, qvel, applied):
    dofs = pads.dofs
    for i in range(qpos.shape[0]):
        p = pads.numbers[i]
        for b in range(dofs.shape[0]):
            weight = pads.masses[b] * GRAVITY
            vx, vz, turn = qvel[i, dofs[b, 0]], qvel[i, dofs[b, 1]], qvel[i, dofs[b, 2]]
            rub = p[RUB] * weight / math.sqrt(vx * vx + vz * vz + CREEP * CREEP)
            drag = p[FILM] + p[HOSE_DAMPING] + rub
            for c in range(2):
                v = qvel[i, dofs[b, c]]
                pull = p[HOSE] * (qpos[i, pads.qadr[b, c]] - pads.origin[i, b, c])
                applied[i, dofs[b, c]] = weight * math.sin(p[c]) - drag * v - pull
            applied[i, dofs[b, 2]] = -(p[FILM] + rub) * p[RADIUS] * p[RADIUS] * turn


class Floats(Bodies):
    """Articles of `n` runs on their air films."""

    @cached_property
    def _pads(self) -> Pads:
        model, runs = self.model, self.runs
        moving = [side for side in SIDES if model.body(side).jntnum[0]]
        joints = [[model.joint(f"{side}_{name}") for name in ("x", "z", "turn")] for side in moving]
        names = ("film_damping", "pad_radius", "friction", "hose_stiffness", "hose_damping")
        tilt = np.array([s.tilt for s in runs.settings], dtype=float)
        return Pads(
            numbers=np.column_stack([tilt, *map(runs.numbers, names)]),
            dofs=np.array([[int(j.dofadr[0]) for j in row] for row in joints]),
            qadr=np.array([[int(j.qposadr[0]) for j in row] for row in joints]),
            masses=np.array([float(model.body(side).subtreemass[0]) for side in moving]),
            origin=np.zeros((len(runs.settings), len(moving), 2)),
        )

    @cached_property
    def _pushed(self) -> Call:
        return Call(_push, self._pads, GIVEN, GIVEN, GIVEN)

    def rest(self, qpos: Array, qvel: Array) -> None:
        self._pads.origin[:] = qpos[:, self._pads.qadr[:, :2]]

    def push(self, sub: int, qpos: Array, qvel: Array, inputs: Array) -> None:
        self._pushed.on(qpos, qvel, inputs)()


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
