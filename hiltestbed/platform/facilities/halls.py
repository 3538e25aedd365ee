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
from hiltestbed.platform.facilities.facility import MOUNT, Runs
from hiltestbed.platform.facilities.motion import GRAVITY
from hiltestbed.platform.friction import DriveFriction
from hiltestbed.platform.shipped.halls import AirBearingSettings, SuspensionSettings

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
def _push_floats(pads, qpos, qvel, applied):
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
        return Call(_push_floats, self._pads, GIVEN, GIVEN, GIVEN)

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


PRESLIDING = 2.0e5  # [N/m] stiffness of a winch before break-away
STRIBECK_SPEED = 0.002  # [m/s]
BREAKAWAY = 1.3  # ratio of break-away to sliding friction
HOOK = 2.0  # [kg] gimbal and hook, in models/suspension
THIN = 0.012  # [m] radius of the cable


class Winches(NamedTuple):
    """The cables and winches of n runs.

    Attributes:
        numbers: (n, 3) swing damping, low-pass coefficient per step of the tension servo, tension
            error. hung: (b,) suspended mass [kg]. dofs: (b,) of the winches. swings: (b, 2) of the
            cables' pivots.
        tension: (n, b) of each cable [N].
    """

    numbers: Array
    hung: Array
    dofs: NDArray[np.int64]
    swings: NDArray[np.int64]
    tension: Array


@njit(cache=True)
def _push(winches, qvel, applied):
    dofs, swings, tension = winches.dofs, winches.swings, winches.tension
    for i in range(qvel.shape[0]):
        damping, share, error = winches.numbers[i, 0], winches.numbers[i, 1], winches.numbers[i, 2]
        for b in range(dofs.shape[0]):
            goal = winches.hung[b] * GRAVITY * (1.0 + error)
            tension[i, b] += share * (goal - tension[i, b])
            applied[i, dofs[b]] = -tension[i, b]
            for c in range(2):
                applied[i, swings[b, c]] = -damping * qvel[i, swings[b, c]]


class Hung(Bodies):
    """Articles of `n` runs on their cables."""

    @cached_property
    def _winches(self) -> Winches:
        model, runs, step = self.model, self.runs, self.runs.step
        moving = [side for side in SIDES if model.body(side).jntnum[0]]
        share = 1.0 - np.exp(-2.0 * math.pi * runs.numbers("tension_bandwidth") * step)
        return Winches(
            numbers=np.column_stack(
                [runs.numbers("swing_damping"), share, runs.numbers("tension_error")]
            ),
            hung=np.array([float(model.body(f"{side}_hook").subtreemass[0]) for side in moving]),
            dofs=np.array([int(model.joint(f"{side}_winch").dofadr[0]) for side in moving]),
            swings=np.array(
                [[int(model.joint(f"{side}_swing_{c}").dofadr[0]) for c in "xz"] for side in moving]
            ),
            tension=np.zeros((len(share), len(moving))),
        )

    @cached_property
    def _friction(self) -> DriveFriction:
        dofs, slides = self._winches.dofs, self.runs.numbers("winch_friction")
        law = [[s, BREAKAWAY * s, STRIBECK_SPEED, 0.0, 0.0] for s in slides]
        laws = np.repeat(np.array(law)[:, None], len(dofs), axis=1)
        return DriveFriction(laws, PRESLIDING, HOOK, dofs, dofs, self.runs.step)

    @cached_property
    def _pushed(self) -> Call:
        return Call(_push, self._winches, GIVEN, GIVEN)

    def rest(self, qpos: Array, qvel: Array) -> None:
        winches = self._winches
        winches.tension[:] = winches.hung * GRAVITY * (1.0 + winches.numbers[:, 2:3])
        self._friction.bristles[:] = 0.0

    def push(self, sub: int, qpos: Array, qvel: Array, inputs: Array) -> None:
        self._pushed.on(qvel, inputs)()
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
