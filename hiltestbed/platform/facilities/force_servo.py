"""Electric drives: force sources with a model-based position loop.

    f = M (w^2 (s_r - s) + 2 zeta w (s_r' - s') + s_r'') + weight

with M the mass matrix at the drives, at home. Without feed-forward s_r' and s_r'' are omitted, and
every coordinate follows its command as w^2/(s^2 + 2 zeta w s + w^2) (computed torque; Luh, Walker,
Paul, IEEE Trans. Automatic Control 25(3), 1980); with it, as far as M is valid away from home,
without lag. The static stiffness of the drives is M w^2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array
from hiltestbed.platform.facilities.drives import Drives
from hiltestbed.platform.facilities.kinematics import Kinematics
from hiltestbed.platform.friction import DriveFriction


@njit(cache=True)
def quantised(value, step):
    """Reading of an encoder of the given resolution."""
    return value if step == 0.0 else step * math.floor(value / step + 0.5)


@njit(cache=True)
def _push(plan, sub, mass, gains, encoder, load, bent, most, axes, inputs, qpos, qvel, force, ctrl):
    """gains: (n, 2) w^2 and 2 zeta w. bent, most: (n, J) offset of the references, force limits.
    force: (J,) work space.
    """
    joints = mass.shape[0]
    for i in range(qpos.shape[0]):
        for j in range(joints):
            error = plan[i, sub, 0, j] + bent[i, j] - quantised(qpos[i, axes[0, j]], encoder[i])
            force[j] = (
                gains[i, 0] * error
                + gains[i, 1] * (plan[i, sub, 1, j] - qvel[i, axes[1, j]])
                + plan[i, sub, 2, j]
            )
        for j in range(joints):
            total = load[i, j]
            for k in range(joints):
                total += mass[j, k] * force[k]
            ctrl[i, inputs[j]] = min(max(total, -most[i, j]), most[i, j])


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
        tick: float,
        substeps: int,
        settings: Sequence[Any],
        feed: NDArray[np.bool_],
        *,
        bandwidth: Sequence[float],
        damping_ratio: Sequence[float],
        encoder: Sequence[float],
        friction: DriveFriction | None = None,
    ) -> None:
        """Args: bandwidth [Hz], damping_ratio, encoder [m]: (n,). friction: friction of the
        drives.
        """
        super().__init__(model, kinematics, tick, substeps, settings, feed)
        w = 2.0 * math.pi * np.asarray(bandwidth, dtype=float)
        self._gains = np.column_stack([w * w, 2.0 * np.asarray(damping_ratio, dtype=float) * w])
        self._encoder, self._mass = (
            np.asarray(encoder, dtype=float),
            np.ascontiguousarray(self.mass_matrix()),
        )
        self._most = np.tile([axis.force for axis in kinematics.axes], (len(feed), 1))
        self._force, self._friction = np.zeros(len(kinematics.axes)), friction
        self.bent = np.zeros((len(feed), len(kinematics.axes)))

    def rest(self, qpos: Array, qvel: Array) -> None:
        if self._friction:
            self._friction.settle(qvel)

    def release(self) -> None:
        super().release()
        self._encoder[:] = 0.0

    @cached_property
    def _pushed(self) -> Call:
        return Call(
            _push,
            self.plan.steps,
            ...,
            self._mass,
            self._gains,
            self._encoder,
            self.load,
            self.bent,
            self._most,
            self._axes,
            self._inputs,
            GIVEN,
            GIVEN,
            self._force,
            GIVEN,
        )

    def push(self, sub: int, qpos: Array, qvel: Array, ctrl: Array) -> None:
        self.pushing(self._pushed, qpos, qvel, ctrl)(sub)

    def state(self) -> dict[str, NDArray[Any]]:
        return super().state() | {"bent": self.bent}
