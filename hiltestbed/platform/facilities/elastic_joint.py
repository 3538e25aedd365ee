"""Drives of an arm with elastic gears: a motor, an elastic gear and a link on each axis.

In the model an axis is two joints in series about one line: the motor's, with the rotor's inertia
as armature, and the gear's, a spring and a damper (Spong, ASME J. Dynamic Systems, Measurement and
Control 109(4), 1987: the rotor's spin counts about its own axis alone). The controller measures
only the motor and closes the model-based loop of :mod:`hiltestbed.platform.facilities.force_servo`
on it, with M the inertia of the rigid arm at the motors, at home. Friction acts on the motor. The
gear's deflection is neither measured nor controlled. The deflection of the gears under the weight
at the start is compensated in the references, as by a calibrated controller.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from hiltestbed.frames import Array
from hiltestbed.platform.facilities.force_servo import ForceServo


class ElasticJoints(ForceServo):
    """Motors of `n` runs of an arm with elastic gears; joints are those of the motors."""

    def __init__(
        self, model: mujoco.MjModel, *given: Any, gears: Sequence[str | None], **numbers: Any
    ) -> None:
        """Args: as of :class:`ForceServo`, and gears: (J,) names of the gears' joints, None for an
        axis without.
        """
        super().__init__(model, *given, **numbers)
        elastic = [(j, model.joint(name)) for j, name in enumerate(gears) if name is not None]
        self._elastic = np.array([j for j, _ in elastic])
        self._gears = np.array([int(joint.qposadr[0]) for _, joint in elastic])
        self._stiffness = np.array([float(np.ravel(joint.stiffness)[0]) for _, joint in elastic])

    def rest(self, qpos: Array, qvel: Array) -> None:
        """The gears deflect under the weight; the motors compensate for it, so that the tool is at
        its commanded pose.
        """
        super().rest(qpos, qvel)
        deflection = -self.load[:, self._elastic] / self._stiffness
        self.bent[:, self._elastic] = -deflection
        qpos[:, self._gears] += deflection
        qpos[:, self._axes[0]] += self.bent
