"""Drives of a user's own model: MuJoCo's position actuators, commanded by positions.

The force of an actuator is kp (ctrl - s) - kv s'. With feed-forward its only input also includes
the planned velocity, ctrl = s_r + (kv/kp) s_r', so that the damping does not cause a lag;
acceleration and weight are not fed forward, as in a plain position servo. The deflection of the
servos under the weight at the start is compensated in the references.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array
from hiltestbed.platform.facilities.drives import Drives
from hiltestbed.platform.facilities.kinematics import Kinematics


@njit(cache=True)
def _push(plan, sub, ratio, lead, bent, inputs, ctrl):
    for i in range(plan.shape[0]):
        for j in range(inputs.shape[0]):
            ctrl[i, inputs[j]] = ratio[j] * (
                plan[i, sub, 0, j] + lead[j] * plan[i, sub, 1, j] + bent[i, j]
            )


class PositionActuators(Drives):
    """Position servos of `n` runs of a user's rig."""

    def __init__(
        self,
        model: mujoco.MjModel,
        kinematics: Kinematics,
        tick: float,
        substeps: int,
        settings: Sequence[Any],
        feed: NDArray[np.bool_],
    ) -> None:
        super().__init__(model, kinematics, tick, substeps, settings, feed)
        self._ratio = model.actuator_gear[self._inputs, 0].copy()
        # stiffness at the joint
        self._kp = model.actuator_gainprm[self._inputs, 0] * self._ratio**2
        self._lead = (
            -model.actuator_biasprm[self._inputs, 2] / model.actuator_gainprm[self._inputs, 0]
        )
        self.bent = np.zeros((len(feed), len(kinematics.axes)))
        self._pushed = Call(
            _push, self.plan.steps, ..., self._ratio, self._lead, self.bent, self._inputs, GIVEN
        )

    def nominal(self) -> tuple[Array, Array]:
        """Natural frequency [rad/s] and damping ratio (J,) of each servo alone, with its effective
        mass at home.
        """
        moved = np.diag(self.mass_matrix())
        w = np.sqrt(self._kp / moved)
        return w, 0.5 * self._lead * w

    def rest(self, qpos: Array, qvel: Array) -> None:
        self.bent[:] = self.load / self._kp

    def push(self, sub: int, qpos: Array, qvel: Array, ctrl: Array) -> None:
        self._pushed.on(ctrl)(sub)

    def state(self) -> dict[str, NDArray]:
        return super().state() | {"bent": self.bent}
