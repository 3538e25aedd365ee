"""The passive side on its compliant mount: where its frame S is, from the six joints between mechanism and sensor.

Three slides x, y, z and three hinges rx, ry, rz in this order, all through P's origin; each has the stiffness and damping of its axis.
The weight of what moves on them hangs on a constant-force balance at its centre of mass, as gravity is unloaded on a real rig: springs
that sag, and a weight whose lever arm at the sensor swings, would otherwise stand in the reading of the torques.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from mujoco.batch import Batch
from numba import njit

from hiltestbed.frames import Array, quat_mul, rotate

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario

AXES = ("x", "y", "z", "rx", "ry", "rz")


def add_joints(body: mujoco.MjsBody) -> None:
    """Put the passive mechanism's ``body`` on the mount's joints."""
    for k, axis in enumerate(AXES):
        kind = mujoco.mjtJoint.mjJNT_SLIDE if k < 3 else mujoco.mjtJoint.mjJNT_HINGE
        body.add_joint(name=f"mount_{axis}", type=kind, axis=np.eye(3)[k % 3], stiffness=1.0, damping=1.0)


class Mount:
    """The mounts of `n` runs.

    Attributes:
        place: (n, 7) pose of S in W; motion: (n, 6) its twist in W. On a rigid mount ``tilt``, and no motion.
        tilt: (n, 7) pose of S in the passive mechanism's body: 0 but for a port that is misaligned.
        centre: (n, 3) the body's centre of mass in W [m]. balance: constant force upwards on it [N].
    """

    def __init__(self, batch: Batch, scenarios: Sequence[Scenario]) -> None:
        n = len(scenarios)
        model = batch.model
        self.tilt = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (n, 1))
        self.place, self.motion = self.tilt.copy(), np.zeros((n, 6))
        self._offset = np.array(model.body("passive_mechanism").ipos)
        self.centre = np.tile(self._offset, (n, 1))
        self.moves = scenarios[0].mechanism.mount is not None
        self.balance = -model.opt.gravity[2] * float(model.body("passive_mechanism").subtreemass[0]) if self.moves else 0.0
        if not self.moves:
            return
        joints = [model.joint(f"mount_{axis}") for axis in AXES]
        self._adr = np.array([joints[0].qposadr[0], joints[0].dofadr[0]])
        stiffness, damping = batch.expand("jnt_stiffness"), batch.expand("dof_damping")
        for i, s in enumerate(scenarios):
            assert s.mechanism.mount is not None  # one structure
            stiffness[i, [j.id for j in joints]] = s.mechanism.mount.stiffness
            damping[i, self._adr[1] : self._adr[1] + 6] = s.mechanism.mount.damping

    def observe(self, qpos: Array, qvel: Array) -> None:
        """Set ``place`` and ``motion`` from the joints of the model."""
        if self.moves:
            _observe(qpos, qvel, self._adr, self.tilt, self._offset, self.place, self.motion, self.centre)
        else:
            self.place[:] = self.tilt


@njit(cache=True)
def _observe(qpos, qvel, adr, tilt, offset, place, motion, centre):
    for i in range(place.shape[0]):
        mount_place(qpos[i, adr[0] : adr[0] + 6], qvel[i, adr[1] : adr[1] + 6], tilt[i], place[i], motion[i])
        _centre(qpos[i, adr[0] : adr[0] + 6], offset, centre[i])


@njit(cache=True)
def _turn(q, before, r):
    """``before`` (4,) becomes the attitude that the three hinges of ``q`` (6,) make; ``r`` (4,) is scratch."""
    turn = np.empty(4)
    before[:] = 0.0
    before[3] = 1.0
    for j in range(3):
        half = 0.5 * q[3 + j]
        turn[:] = 0.0
        turn[j] = math.sin(half)
        turn[3] = math.cos(half)
        quat_mul(before, turn, r)
        before[:] = r


@njit(cache=True)
def mount_place(q, qd, tilt, place, motion):
    """One mount: ``place`` (7,) and ``motion`` (6,) of S in W from the joints ``q`` (6,) and their rates ``qd`` (6,); ``tilt`` (7,)."""
    attitude, r, axis, turn = np.empty(4), np.empty(4), np.empty(3), np.empty(4)
    attitude[:] = 0.0
    attitude[3] = 1.0
    motion[:] = 0.0
    for j in range(3):
        place[j] = q[j]
        motion[j] = qd[j]
        axis[:] = 0.0
        axis[j] = 1.0
        rotate(attitude, axis, axis)  # the hinge's axis, turned by those before it
        for k in range(3):
            motion[3 + k] += qd[3 + j] * axis[k]
        half = 0.5 * q[3 + j]
        turn[:] = 0.0
        turn[j] = math.sin(half)
        turn[3] = math.cos(half)
        quat_mul(attitude, turn, r)
        attitude[:] = r
    quat_mul(attitude, tilt[3:7], r)
    place[3:7] = r


@njit(cache=True)
def _centre(q, offset, centre):
    """``centre`` (3,) of mass in W of a body whose centre lies at ``offset`` (3,) from its joints."""
    attitude, r = np.empty(4), np.empty(4)
    _turn(q, attitude, r)
    rotate(attitude, offset, centre)
    for j in range(3):
        centre[j] += q[j]


@dataclass(frozen=True)
class MountDynamics:
    """The mounts of R runs in closed form, for motions so small that the axes stay where they are.

    Attributes:
        stiffness, damping: (R, 6) [N/m, N m/rad; N s/m, N m s/rad]. mass: (6, 6) of what moves, at P's origin [kg, kg m, kg m^2].
    """

    stiffness: Array
    damping: Array
    mass: Array

    @classmethod
    def of(cls, scenarios: Sequence[Scenario]) -> MountDynamics | None:
        """The mounts of scenarios of one mechanism; None where it is rigid."""
        if scenarios[0].mechanism.mount is None:
            return None
        mounts = [s.mechanism.mount for s in scenarios if s.mechanism.mount is not None]
        spec = scenarios[0].mechanism.sides()[1]
        mass = mass_at_origin(spec.compile(), "mechanism")
        return cls(np.array([m.stiffness for m in mounts]), np.array([m.damping for m in mounts]), mass)

    def arrays(self, dt: float) -> tuple[Array, Array, Array, Array]:
        """Stiffness, damping (R, 6), mass and (M + dt C)^-1 (R, 6, 6) for steps of ``dt`` [s]."""
        n = len(self.stiffness)
        mass = np.tile(self.mass, (n, 1, 1))
        implicit = np.asarray(np.linalg.inv(mass + dt * self.damping[:, :, None] * np.eye(6)), dtype=np.float64)
        return self.stiffness, self.damping, mass, implicit


def mass_at_origin(model: mujoco.MjModel, body: str) -> Array:
    """``(6, 6)`` inertia of a body and all that it carries, at the body's origin in its axes: force and torque against acceleration."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    root = model.body(body).id
    origin = data.xpos[root]
    out = np.zeros((6, 6))
    for b in range(model.nbody):
        ancestor = b
        while ancestor not in (0, root):
            ancestor = model.body_parentid[ancestor]
        if ancestor != root:
            continue
        m, r = model.body_mass[b], data.xipos[b] - origin
        axes = data.ximat[b].reshape(3, 3)
        cross = np.array([[0.0, -r[2], r[1]], [r[2], 0.0, -r[0]], [-r[1], r[0], 0.0]])
        out[:3, :3] += m * np.eye(3)
        out[:3, 3:] -= m * cross
        out[3:, :3] += m * cross
        out[3:, 3:] += axes @ np.diag(model.body_inertia[b]) @ axes.T - m * cross @ cross
    return out


@njit(cache=True)
def mount_step(stiffness, mass, implicit, dt, wrench, q, qd):
    """One step of one mount under ``wrench`` (6,) on the passive side, in W at W's origin: rates first, dampers implicit, as MuJoCo's."""
    push = np.empty(6)
    for j in range(6):
        push[j] = dt * (wrench[j] - stiffness[j] * q[j])
        for k in range(6):
            push[j] += mass[j, k] * qd[k]
    push[3] -= dt * (q[1] * wrench[2] - q[2] * wrench[1])
    push[4] -= dt * (q[2] * wrench[0] - q[0] * wrench[2])
    push[5] -= dt * (q[0] * wrench[1] - q[1] * wrench[0])
    for j in range(6):
        qd[j] = 0.0
        for k in range(6):
            qd[j] += implicit[j, k] * push[k]
    for j in range(6):
        q[j] += dt * qd[j]


@njit(cache=True)
def mount_reading(stiffness, damping, q, qd, out):
    """``out`` (6,): what the mount hands on to the sensor, in W at W's origin."""
    for j in range(6):
        out[j] = stiffness[j] * q[j] + damping[j] * qd[j]
    out[3] += q[1] * out[2] - q[2] * out[1]
    out[4] += q[2] * out[0] - q[0] * out[2]
    out[5] += q[0] * out[1] - q[1] * out[0]
