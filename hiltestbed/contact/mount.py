"""The passive side on its compliant mount: pose of its frame S from the six joints between
mechanism and sensor.

Three slides x, y, z and three hinges rx, ry, rz in this order, all through P's origin; each has the
stiffness and damping of its axis. A constant force at the centre of mass balances the weight of the
moving parts, as gravity is offloaded on a real rig: otherwise the sag of the springs, and the
weight's changing lever arm at the sensor, would appear in the torque readings.
"""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco.batch import Batch

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import copied, njit
from hiltestbed.frames import Array, quat_mul, rotate, sin_cos
from hiltestbed.signals import AXES

# bodies: the carrier of the force sensor, and the passive side on its mount
CARRIER, MOUNTED = "passive_carrier", "passive_mount"


def add_joints(body: mujoco.MjsBody) -> None:
    """Add the mount's joints to ``body``, which carries the passive side with P at its origin."""
    for k, axis in enumerate(AXES):
        kind = mujoco.mjtJoint.mjJNT_SLIDE if k < 3 else mujoco.mjtJoint.mjJNT_HINGE
        body.add_joint(
            name=f"mount_{axis}", type=kind, axis=np.eye(3)[k % 3], stiffness=1.0, damping=1.0
        )


class Mounts:
    """The mounts of `n` runs.

    Attributes:
        place: (n, 7) pose of S in W; motion: (n, 6) its twist in W. On a rigid mount ``tilt``,
            without motion.
        body: number of the body that carries the passive side; centre: (n, 3) its centre of mass in
            W [m], as in MuJoCo.
        balance: (n, 6) constant force that balances the total weight, in W at W's origin; 0 on a
            rigid mount.
    """

    def __init__(self, batch: Batch, springs: tuple[Array, Array] | None, tilt: Array) -> None:
        """``springs``: see ``parameters.mounts_of``. ``tilt``: (n, 7) pose of S in its nominal
        frame.
        """
        n, model = len(tilt), batch.model
        self.tilt = tilt
        self.place, self.motion = tilt.copy(), np.zeros((n, 6))
        self.moves = springs is not None
        self.body = model.body(MOUNTED if self.moves else CARRIER).id
        self._offset = np.array(model.body_ipos[self.body])
        self.centre, self.balance = np.tile(self._offset, (n, 1)), np.zeros((n, 6))
        self._ridden = Call(
            _ride, GIVEN, GIVEN, tilt, self._offset, self.place, self.motion, self.centre
        )
        if springs is None:
            return
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        away = data.subtree_com[self.body] - data.xpos[self.body]
        middle = data.xmat[self.body].reshape(3, 3).T @ away
        mass = float(model.body_subtreemass[self.body])
        self.balance[:, :3] = -np.array(model.opt.gravity) * mass
        joints = [model.joint(f"mount_{axis}") for axis in AXES]
        adr = np.array([joints[0].qposadr[0], joints[0].dofadr[0]])
        points, seat = np.array([self._offset, middle]), (self.place, self.motion, self.centre)
        self._seen = Call(_observe, GIVEN, GIVEN, adr, tilt, points, *seat, self.balance)
        batch.expand("jnt_stiffness")[:, [j.id for j in joints]] = springs[0]
        batch.expand("dof_damping")[:, adr[1] : adr[1] + 6] = springs[1]

    def observe(self, qpos: Array, qvel: Array) -> None:
        """Set ``place`` and ``motion`` from the joints; on a rigid mount they do not change."""
        if self.moves:
            self._seen.on(qpos, qvel)()

    def ride(self, place: Array, motion: Array) -> None:
        """Set the pose of a rigidly mounted side: P at ``place`` (n, 7), ``motion`` (n, 6)."""
        self._ridden.on(place, motion)()


@njit(cache=True)
def _observe(qpos, qvel, adr, tilt, points, place, motion, centre, balance):
    at = np.empty(3)
    for i in range(place.shape[0]):
        q, qd = qpos[i, adr[0] : adr[0] + 6], qvel[i, adr[1] : adr[1] + 6]
        mount_place(q, qd, tilt[i], place[i], motion[i])
        _centre(q, points[0], centre[i])
        _centre(q, points[1], at)
        for j in range(3):
            k, l = (j + 1) % 3, (j + 2) % 3
            balance[i, 3 + j] = at[k] * balance[i, l] - at[l] * balance[i, k]


@njit(cache=True)
def _ride(carrier, speed, tilt, offset, place, motion, centre):
    for i in range(place.shape[0]):
        copied(carrier[i, 0:3], place[i, 0:3])  # a tilt rotates about P's origin
        quat_mul(carrier[i, 3:7], tilt[i, 3:7], place[i, 3:7])
        copied(speed[i], motion[i])
        rotate(carrier[i, 3:7], offset, centre[i])
        for j in range(3):
            centre[i, j] += carrier[i, j]


@njit(cache=True)
def _turned(q):
    """Half-angle sines and cosines of the first two hinges ``q`` (6,), and the attitude of all."""
    (s0, c0), (s1, c1), (s2, c2) = sin_cos(0.5 * q[3]), sin_cos(0.5 * q[4]), sin_cos(0.5 * q[5])
    x, y, z, w = s0 * c1, c0 * s1, s0 * s1, c0 * c1  # of the first two
    return (s0, c0, s1, c1), (x * c2 + y * s2, y * c2 - x * s2, z * c2 + w * s2, w * c2 - z * s2)


@njit(cache=True)
def mount_place(q, qd, tilt, place, motion):
    """``place`` (7,), ``motion`` (6,) of S in W from joints ``q`` (6,), rates ``qd``; ``tilt``
    (7,).
    """
    for j in range(3):
        place[j], motion[j] = q[j], qd[j]
    (s0, c0, s1, c1), (x, y, z, w) = _turned(q)
    # Axes of the hinges, rotated by those before: (1, 0, 0), (0, cosine, sine) and the third
    sine, cosine, across = 2.0 * s0 * c0, 1.0 - 2.0 * s0 * s0, 1.0 - 2.0 * s1 * s1
    motion[3] = qd[3] + qd[5] * 2.0 * s1 * c1
    motion[4] = qd[4] * cosine - qd[5] * sine * across
    motion[5] = qd[4] * sine + qd[5] * cosine * across
    tx, ty, tz, tw = tilt[3], tilt[4], tilt[5], tilt[6]
    place[3] = w * tx + x * tw + y * tz - z * ty
    place[4] = w * ty - x * tz + y * tw + z * tx
    place[5] = w * tz + x * ty - y * tx + z * tw
    place[6] = w * tw - x * tx - y * ty - z * tz


@njit(cache=True)
def _centre(q, offset, centre):
    """``centre`` (3,): centre of mass in W of a body, at ``offset`` (3,) from its joints."""
    rotate(_turned(q)[1], offset, centre)
    for j in range(3):
        centre[j] += q[j]
