"""Drives of an arm whose gears yield: a motor, an elastic gear, a link, on each axis.

In the model an axis is two joints in series about one line: the motor's, with the rotor's inertia as armature, and the gear's, a spring
and a damper (Spong, ASME J. Dynamic Systems, Measurement and Control 109(4), 1987: the rotor's spin counts about its own axis alone). The
controller sees the motor alone and closes a model-based loop on it,

    tau = M (w^2 (r - theta) + 2 zeta w (r' - theta') + r'') + weight

M the inertia that the motors feel of a rigid arm, at home; without feed-forward r' and r'' are left out. Friction acts on the motor. The
gear's deflection is in no reading: the link is where it ends up. What the weight bends the gears by at the start is taken out of the
references, as a calibrated controller does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np
from numba import njit
from numpy.typing import NDArray

from hiltestbed.frames import Array
from hiltestbed.platform.facilities.drives import Drives
from hiltestbed.platform.facilities.force_servo import quantised
from hiltestbed.platform.facilities.friction import Rubbing
from hiltestbed.platform.facilities.kinematics import Kinematics


@njit(cache=True)
def _push(plan, sub, mass, gains, encoder, load, bent, most, axes, inputs, qpos, qvel, force, ctrl):
    """bent: (n, J) what the references are shifted by for the weight [rad]; the rest as in the electric drives of a parallel rig."""
    joints = mass.shape[0]
    for i in range(qpos.shape[0]):
        for j in range(joints):
            error = plan[i, sub, 0, j] + bent[i, j] - quantised(qpos[i, axes[0, j]], encoder[i])
            force[j] = gains[i, 0] * error + gains[i, 1] * (plan[i, sub, 1, j] - qvel[i, axes[1, j]]) + plan[i, sub, 2, j]
        for j in range(joints):
            total = load[i, j]
            for k in range(joints):
                total += mass[j, k] * force[k]
            ctrl[i, inputs[j]] = min(max(total, -most[i, j]), most[i, j])


class ElasticJoints(Drives):
    """Motors of `n` runs of an arm with elastic gears; joints are those of the motors.

    Attributes:
        bent: (n, J) the gears' deflection under the weight at the start [rad].
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        kinematics: Kinematics,
        tick: float,
        substeps: int,
        cycles: Sequence[int],
        lates: Sequence[int],
        feed: NDArray[np.bool_],
        *,
        gears: Sequence[str | None],
        bandwidth: Sequence[float],
        damping_ratio: Sequence[float],
        encoder: Sequence[float],
        rubbing: Rubbing | None = None,
    ) -> None:
        """Args: gears: (J,) names of the gears' joints, None for an axis without. bandwidth [Hz], damping_ratio, encoder [rad]: (n,)."""
        super().__init__(model, kinematics, tick, substeps, cycles, lates, feed)
        w = 2.0 * math.pi * np.asarray(bandwidth, dtype=float)
        self._gains = np.column_stack([w * w, 2.0 * np.asarray(damping_ratio, dtype=float) * w])
        self._encoder, self._mass = np.asarray(encoder, dtype=float), np.ascontiguousarray(self.mass_matrix())
        self._most = np.tile([axis.force for axis in kinematics.axes], (len(feed), 1))
        self._force, self._rubbing = np.zeros(len(kinematics.axes)), rubbing
        elastic = [(j, model.joint(name)) for j, name in enumerate(gears) if name is not None]
        self._elastic = np.array([j for j, _ in elastic])
        self._gears = np.array([int(joint.qposadr[0]) for _, joint in elastic])
        self._stiffness = np.array([float(np.ravel(joint.stiffness)[0]) for _, joint in elastic])
        self.bent = np.zeros((len(feed), len(kinematics.axes)))

    def rest(self, qpos: Array, qvel: Array) -> None:
        """The gears hang under the weight; the motors make up for it, so that the tool is where it was to be."""
        deflection = -self.load[:, self._elastic] / self._stiffness
        self.bent[:, self._elastic] = -deflection
        qpos[:, self._gears] += deflection
        qpos[:, self._axes[0]] += self.bent
        if self._rubbing:
            self._rubbing.settle(qvel)

    def release(self) -> None:
        super().release()
        self._encoder[:] = 0.0

    def push(self, sub: int, qpos: Array, qvel: Array, ctrl: Array) -> None:
        _push(
            self._plan, sub, self._mass, self._gains, self._encoder, self.load, self.bent, self._most, self._axes, self._inputs,
            qpos, qvel, self._force, ctrl,
        )  # fmt: skip
        if self._rubbing:
            self._rubbing.act(qvel, ctrl)

    def state(self) -> dict[str, NDArray]:
        return super().state() | {"bent": self.bent}
