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
from collections.abc import Hashable, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.config.models import load
from hiltestbed.frames import Array
from hiltestbed.platform.facilities.bodies import SIDES, Bodies, PhysicalFacility
from hiltestbed.platform.facilities.facility import MOUNT, per_run
from hiltestbed.platform.payload import GRAVITY
from hiltestbed.platform.shipped.air_bearing import AirBearingSettings

CREEP = 1e-4  # [m/s] v_0, speed below which the pads' friction fades
TILT_X, TILT_Z, FILM, RADIUS, RUB, HOSE, HOSE_DAMPING, NUMBERS = range(8)


@njit(cache=True)
def _push(numbers, dofs, qadr, masses, origin, qpos, qvel, applied):
    """dofs, qadr (2, 3): x, z and rotation of both articles. masses: (2,). origin: (n, 2, 2) rest
    position of the hoses.
    """
    for i in range(qpos.shape[0]):
        p = numbers[i]
        for b in range(dofs.shape[0]):
            weight = masses[b] * GRAVITY
            vx, vz, turn = qvel[i, dofs[b, 0]], qvel[i, dofs[b, 1]], qvel[i, dofs[b, 2]]
            rub = p[RUB] * weight / math.sqrt(vx * vx + vz * vz + CREEP * CREEP)
            drag = p[FILM] + p[HOSE_DAMPING] + rub
            for c in range(2):
                v = qvel[i, dofs[b, c]]
                pull = p[HOSE] * (qpos[i, qadr[b, c]] - origin[i, b, c])
                applied[i, dofs[b, c]] = weight * math.sin(p[c]) - drag * v - pull
            applied[i, dofs[b, 2]] = -(p[FILM] + rub) * p[RADIUS] * p[RADIUS] * turn


class Floats(Bodies):
    """Articles of `n` runs on their air films."""

    def __init__(
        self,
        model: mujoco.MjModel,
        facility: AirBearing,
        settings: Sequence[Any],
        step: float,
        tool: str,
    ) -> None:
        super().__init__(model, facility.kinematics(model, tool), len(settings), step)
        moving = [side for side in SIDES if facility.floats(side)]
        joints = [[model.joint(f"{side}_{name}") for name in ("x", "z", "turn")] for side in moving]
        self._dofs = np.array([[int(j.dofadr[0]) for j in row] for row in joints])
        self._qadr = np.array([[int(j.qposadr[0]) for j in row] for row in joints])
        self._masses = np.array([float(model.body(side).subtreemass[0]) for side in moving])
        self._numbers = np.column_stack(
            [
                np.array([s.tilt for s in settings], dtype=float),
                *(
                    per_run(settings, name)
                    for name in (
                        "film_damping",
                        "pad_radius",
                        "friction",
                        "hose_stiffness",
                        "hose_damping",
                    )
                ),
            ]
        )
        self._origin = np.zeros((len(settings), len(moving), 2))
        self._pushed = Call(
            _push,
            self._numbers,
            self._dofs,
            self._qadr,
            self._masses,
            self._origin,
            GIVEN,
            GIVEN,
            GIVEN,
        )

    def rest(self, qpos: Array, qvel: Array) -> None:
        self._origin[:] = qpos[:, self._qadr[:, :2]]

    def push(self, qpos: Array, qvel: Array, applied: Array) -> None:
        self._pushed.on(qpos, qvel, applied)()

    def state(self) -> dict[str, NDArray[Any]]:
        return {"origin": self._origin}


class AirBearing(PhysicalFacility):
    """The floor of ``models/air_bearing``."""

    settings: AirBearingSettings

    def floats(self, side: str) -> bool:
        """Whether an article can move."""
        return side == "chaser" or self.settings.target == "free"

    def spec(self) -> mujoco.MjSpec:
        spec = load("air_bearing/air_bearing")
        s = self.settings
        ride = 0.5 * s.float_mass * s.pad_radius**2  # a disc about the vertical
        for side in SIDES:
            place, body = self.place_of(side), spec.body(side)
            body.pos, body.quat = place[:3], [place[6], *place[3:6]]
            for joint in list(body.joints):
                # the joints are along the floor's axes, whatever the body's attitude
                if self.floats(side):
                    joint.axis = _in_body(np.array(joint.axis), place)
                else:
                    spec.delete(joint)
            self.fit(spec, side, s.float_mass, ride * np.diag([0.5, 1.0, 0.5]))
        self.add_ports(spec)
        return spec

    def bodies(
        self, model: mujoco.MjModel, settings: Sequence[Any], step: float, tool: str = MOUNT
    ) -> Floats:
        return Floats(model, self, settings, step, tool)

    def alike(self) -> Hashable:
        return (self.kind, self.settings.target, self.settings.float_mass, self.settings.pad_radius)


def _in_body(axis: Array, place: Array) -> Array:
    """An axis of W in the axes of a body at ``place`` (7,)."""
    from hiltestbed.frames import rotate_back

    out = np.empty(3)
    rotate_back(place[3:7], axis, out)
    return out
