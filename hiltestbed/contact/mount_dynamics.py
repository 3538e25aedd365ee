"""A compliant mount in closed form, for motions so small that its axes stay where they are; the replay integrates it so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numba import njit

from hiltestbed.contact.composition import PASSIVE, add_side
from hiltestbed.frames import Array

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario


@dataclass(frozen=True)
class MountDynamics:
    """The mounts of R runs.

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
        spec = mujoco.MjSpec()
        body = spec.worldbody.add_body(name="passive_mount")
        add_side(spec, scenarios[0].mechanism, PASSIVE, body)
        mass = mass_at_origin(spec.compile(), "passive_mount")
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
