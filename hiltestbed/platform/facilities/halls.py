"""Two articles that move freely: on air bearings over a flat floor, and on cables.

Air bearings: three degrees of freedom each, z (insertion), x and rotation about the vertical y.

Disturbances compared with free flight: the floor is not level (a component of gravity in its
plane), the air film shears (viscous drag), the pads have a little friction, and hoses pull. Forces
on an article of mass m (float included), speed v and angular rate w:

    tilt      m g (sin a_x, sin a_z)                 film   -b v,  -b r^2 w
    friction  -mu m g v/sqrt(v^2 + v_0^2)  hose  -k (x - x_0) - c v, x_0 the start position

Cables: each article hangs in a gimbal at its centre of mass, from a pivot in the roof,
and a winch supports its weight.

Disturbances compared with free flight: a cable pulls back (a pendulum) and has mass, its winch
follows the article with friction, inertia and an imperfect tension servo, and the gimbal is not
exactly at the centre of mass. With m the suspended mass, m_c the cable's, L from the pivot to the
gimbal, the small swing has

    w^2 = (g/L) (1 + m_c/(2 m))/(1 + m_c/(3 m))

since the article does not rotate with the cable. The tension follows T' = w_t (T_0 - T) with T_0
the weight; the winch applies T along the cable and adds its own inertia and friction.
"""

from __future__ import annotations

import math
from collections.abc import Hashable

import mujoco
import numpy as np

from hiltestbed.config.models import load
from hiltestbed.frames import Array
from hiltestbed.platform.facilities.bodies import SIDES, Bodies, PhysicalFacility
from hiltestbed.platform.facilities.facility import MOUNT, Runs
from hiltestbed.platform.facilities.kinematics import Kinematics
from hiltestbed.platform.facilities.motion import GRAVITY
from hiltestbed.platform.friction import DriveFriction
from hiltestbed.platform.shipped.halls import AirBearingSettings, SuspensionSettings

CREEP = 1e-4  # [m/s] v_0, speed below which the pads' friction fades


class Floats(Bodies):
    """Articles of `n` runs on their air films.

    Attributes:
        origin: (n, b, 2) rest position of the hoses of each moving article [m].
    """

    def __init__(self, model: mujoco.MjModel, kinematics: Kinematics, runs: Runs) -> None:
        super().__init__(model, kinematics, runs)
        moving = self.moving
        joints = [[model.joint(f"{side}_{name}") for name in ("x", "z", "turn")] for side in moving]
        self._dofs = np.array([[int(j.dofadr[0]) for j in row] for row in joints])
        self._places = np.array([[int(j.qposadr[0]) for j in row[:2]] for row in joints])
        self._weights = GRAVITY * np.array([float(model.body(s).subtreemass[0]) for s in moving])
        slopes = np.array([[math.sin(angle) for angle in s.tilt] for s in runs.settings])
        self._downhill = self._weights[:, None] * slopes[:, None]
        names = ("film_damping", "pad_radius", "friction", "hose_stiffness", "hose_damping")
        self._numbers = [runs.numbers(name)[:, None] for name in names]
        self.origin = np.zeros_like(self._downhill)

    def rest(self, qpos: Array, qvel: Array) -> None:
        self.origin[:] = qpos[:, self._places]

    def push(self, sub: int, qpos: Array, qvel: Array, inputs: Array) -> None:
        film, radius, friction, hose, hose_damping = self._numbers
        vx, vz, turn = np.moveaxis(qvel[:, self._dofs], 2, 0)
        rub = friction * self._weights / np.sqrt(vx * vx + vz * vz + CREEP * CREEP)
        drag = (film + hose_damping + rub)[..., None] * np.stack([vx, vz], axis=2)
        pull = hose[..., None] * (qpos[:, self._places] - self.origin)
        inputs[:, self._dofs[:, :2]] = self._downhill - drag - pull
        inputs[:, self._dofs[:, 2]] = -(film + rub) * radius * radius * turn


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


PRESLIDING = 2.0e5  # [N/m] stiffness of a winch before break-away
STRIBECK_SPEED = 0.002  # [m/s]
BREAKAWAY = 1.3  # ratio of break-away to sliding friction
HOOK = 2.0  # [kg] gimbal and hook, in models/suspension
THIN = 0.012  # [m] radius of the cable


class Hung(Bodies):
    """Articles of `n` runs on their cables.

    Attributes:
        tension: (n, b) of each moving article's cable [N].
    """

    def __init__(self, model: mujoco.MjModel, kinematics: Kinematics, runs: Runs) -> None:
        super().__init__(model, kinematics, runs)
        moving = self.moving
        self._dofs = np.array([int(model.joint(f"{side}_winch").dofadr[0]) for side in moving])
        self._swings = np.array(
            [int(model.joint(f"{side}_swing_{c}").dofadr[0]) for side in moving for c in "xz"]
        )
        hung = np.array([float(model.body(f"{side}_hook").subtreemass[0]) for side in moving])
        self._goal = hung * GRAVITY * (1.0 + runs.numbers("tension_error")[:, None])
        share = 1.0 - np.exp(-2.0 * math.pi * runs.numbers("tension_bandwidth") * runs.step)
        self._share, self._damping = share[:, None], runs.numbers("swing_damping")[:, None]
        self.tension = np.zeros_like(self._goal)
        law = [[s, BREAKAWAY * s, STRIBECK_SPEED, 0.0, 0.0] for s in runs.numbers("winch_friction")]
        laws = np.repeat(np.array(law)[:, None], len(moving), axis=1)
        self._friction = DriveFriction(laws, PRESLIDING, HOOK, self._dofs, self._dofs, runs.step)

    def rest(self, qpos: Array, qvel: Array) -> None:
        self.tension[:] = self._goal
        self._friction.bristles[:] = 0.0

    def push(self, sub: int, qpos: Array, qvel: Array, inputs: Array) -> None:
        self.tension += self._share * (self._goal - self.tension)
        inputs[:, self._dofs] = -self.tension
        inputs[:, self._swings] = -self._damping * qvel[:, self._swings]
        self._friction.act(qvel, inputs)


class Suspension(PhysicalFacility):
    """The cables of ``models/suspension``."""

    settings: SuspensionSettings

    def spec(self) -> mujoco.MjSpec:
        spec, s = load("suspension/suspension"), self.settings
        half = 0.5 * s.length
        for side in SIDES:
            place = self.place_of(side)
            # from the centre of mass to the gimbal, in W, at home
            up = np.array([0.0, s.gimbal_offset, 0.0])
            spec.body(f"{side}_pivot").pos = place[:3] + up + [0.0, s.length, 0.0]
            cable = spec.body(f"{side}_cable")
            thick = max(s.cable_mass, 1e-6)
            across = thick * s.length**2 / 12.0
            cable.mass, cable.ipos = thick, [0.0, -half, 0.0]
            cable.inertia = [across, thick * THIN**2, across]
            rope = spec.geom(f"{side}_rope")
            rope.pos, rope.size = [0.0, -half, 0.0], [THIN, half, 0.0]
            spec.body(f"{side}_hook").pos = [0.0, -s.length, 0.0]
            spec.joint(f"{side}_winch").armature = s.winch_mass
            body = spec.body(side)
            body.pos, body.quat = -up, [place[6], *place[3:6]]
            spec.joint(f"{side}_gimbal").pos = self.in_body(side, up)
            if not self.moves(side):
                for name in ("swing_x", "swing_z", "winch", "gimbal"):
                    spec.delete(spec.joint(f"{side}_{name}"))
            self.fit(spec, side, 0.0, np.zeros((3, 3)))
        self.add_ports(spec)
        return spec

    def drives(self, model: mujoco.MjModel, runs: Runs, tool: str = MOUNT) -> Hung:
        return Hung(model, self.kinematics(model, tool), runs)

    def alike(self) -> Hashable:
        s = self.settings
        return (self.kind, s.target, s.length, s.cable_mass, s.winch_mass, s.gimbal_offset)
