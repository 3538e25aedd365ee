"""Electric drives: force sources with a model-based position loop.

    f = M (w^2 (s_r - s) + 2 zeta w (s_r' - s') + s_r'') + weight

with M the mass matrix at the drives, at home. Without feed-forward s_r' and s_r'' are omitted, and
every coordinate follows its command as w^2/(s^2 + 2 zeta w s + w^2) (computed torque; Luh, Walker,
Paul, IEEE Trans. Automatic Control 25(3), 1980); with it, as far as M is valid away from home,
without lag. The static stiffness of the drives is M w^2.

Elastic gears: an axis of the model is then two joints in series about one line: the motor's, with
the rotor's inertia as armature, and the gear's, a spring and a damper (Spong, ASME J. Dynamic
Systems, Measurement and Control 109(4), 1987: the rotor's spin counts about its own axis alone).
The controller measures only the motor, and M is the inertia of the rigid arm at the motors.
Friction acts on the motor. The gear's deflection is neither measured nor controlled; that under the
weight at the start is compensated in the references, as by a calibrated controller.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property

import mujoco
import numpy as np

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array
from hiltestbed.platform.facilities.drives import Drives, mass_matrix
from hiltestbed.platform.facilities.facility import Runs
from hiltestbed.platform.facilities.kinematics import Kinematics


@njit(cache=True)
def quantised(value, step):
    """Reading of an encoder of the given resolution."""
    return value if step == 0.0 else step * math.floor(value / step + 0.5)


@njit(cache=True)
def _push(loop, references, plan, sub, qpos, qvel, ctrl):
    """loop: mass (J, J), gains (n, 2) w^2 and 2 zeta w, encoders (n,), force limits (J,), addresses
    of joints and actuators. references: gravity load and offset of the references, both (n, J).
    """
    (mass, gains, encoder, most, axes, inputs), (load, bent) = loop, references
    joints = mass.shape[0]
    force = np.empty(joints)
    for i in range(qpos.shape[0]):
        for j in range(joints):
            reached = quantised(qpos[i, axes[0, j]], encoder[i])
            error = plan[i, sub, 0, j] + bent[i, j] - reached
            force[j] = (
                gains[i, 0] * error
                + gains[i, 1] * (plan[i, sub, 1, j] - qvel[i, axes[1, j]])
                + plan[i, sub, 2, j]
            )
        for j in range(joints):
            total = load[i, j]
            for k in range(joints):
                total += mass[j, k] * force[k]
            ctrl[i, inputs[j]] = min(max(total, -most[j]), most[j])


class ForceServo(Drives):
    """Electric drives of `n` runs.

    Attributes:
        bent: (n, J) offset of the references that compensates the deflection between drive and tool
            under the weight.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        kinematics: Kinematics,
        runs: Runs,
        section: str = "",
        mass: Array | None = None,
    ) -> None:
        """``section``: of the settings, with the parameters of the position loop. ``mass`` (J, J):
        for which the loop is tuned, of drives that the model itself limits; default: M, and the
        axes' limits.
        """
        super().__init__(model, kinematics, runs)
        part = f"{section}." if section else ""
        w = 2.0 * math.pi * runs.numbers(f"{part}bandwidth")
        self.encoder = runs.numbers(f"{part}encoder_resolution")
        most = [axis.force if mass is None else math.inf for axis in kinematics.axes]
        mass = mass_matrix(kinematics, model) if mass is None else mass
        self.bent = np.zeros_like(self.load)
        gains = np.column_stack([w * w, 2.0 * runs.numbers(f"{part}damping_ratio") * w])
        mass = np.ascontiguousarray(mass)
        self._loop = mass, gains, self.encoder, np.array(most), self.axes, self._inputs

    @cached_property
    def _pushed(self) -> Call:
        references = self.load, self.bent
        return Call(_push, self._loop, references, self.plan.steps, ..., GIVEN, GIVEN, GIVEN)


class ElasticJoints(ForceServo):
    """Motors of `n` runs of an arm with elastic gears; joints are those of the motors."""

    def __init__(
        self,
        model: mujoco.MjModel,
        kinematics: Kinematics,
        runs: Runs,
        section: str,
        gears: Sequence[str | None],
    ) -> None:
        """``gears``: (J,) names of the gears' joints, None for an axis without."""
        super().__init__(model, kinematics, runs, section)
        elastic = [(j, model.joint(name)) for j, name in enumerate(gears) if name is not None]
        self._elastic = np.array([j for j, _ in elastic])
        self._gears = np.array([int(joint.qposadr[0]) for _, joint in elastic])
        self._stiffness = np.array([float(np.ravel(joint.stiffness)[0]) for _, joint in elastic])

    def rest(self, qpos: Array, qvel: Array) -> None:
        """The gears deflect under the weight; the motors compensate for it."""
        super().rest(qpos, qvel)
        deflection = -self.load[:, self._elastic] / self._stiffness
        self.bent[:, self._elastic] = -deflection
        qpos[:, self._gears] += deflection
        qpos[:, self.axes[0]] += self.bent
