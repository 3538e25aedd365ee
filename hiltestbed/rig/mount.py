"""The passive side on its compliant mount: where its frame S is, from the six joints between mechanism and sensor.

Three slides x, y, z and three hinges rx, ry, rz in this order, all through P's origin; each has the stiffness and damping of its axis.
The weight of what moves on them hangs on a constant-force balance at its centre of mass, as gravity is unloaded on a real rig: springs
that sag, and a weight whose lever arm at the sensor swings, would otherwise stand in the reading of the torques.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
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

    def buffers(self) -> dict[str, Array]:
        """The state between two ticks, beside the joints."""
        return {"place": self.place, "motion": self.motion, "centre": self.centre}


@njit(cache=True)
def _observe(qpos, qvel, adr, tilt, offset, place, motion, centre):
    q, r, axis, turn = np.empty(4), np.empty(4), np.empty(3), np.empty(4)
    for i in range(place.shape[0]):
        q[:] = 0.0
        q[3] = 1.0
        motion[i] = 0.0
        for j in range(3):
            place[i, j] = qpos[i, adr[0] + j]
            motion[i, j] = qvel[i, adr[1] + j]
            axis[:] = 0.0
            axis[j] = 1.0
            rotate(q, axis, axis)  # the hinge's axis, turned by those before it
            for k in range(3):
                motion[i, 3 + k] += qvel[i, adr[1] + 3 + j] * axis[k]
            half = 0.5 * qpos[i, adr[0] + 3 + j]
            turn[:] = 0.0
            turn[j] = math.sin(half)
            turn[3] = math.cos(half)
            quat_mul(q, turn, r)
            q[:] = r
        rotate(q, offset, centre[i])
        for j in range(3):
            centre[i, j] += place[i, j]
        quat_mul(q, tilt[i, 3:7], r)
        place[i, 3:7] = r
