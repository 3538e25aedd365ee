"""Friction of seals and gears, subtracted from the force of a drive.

The law is that of the sliders of the 3-3 PSS platform (:func:`hiltestbed.platform.friction.drag`):
Coulomb and Stribeck with a bristle that holds a joint at rest, and a viscous part. Units are N and
m for cylinders, N m and rad for gears.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array
from hiltestbed.platform.friction import BRISTLE, STEPS, drag, stribeck

# [m/s], [rad/s] smaller speeds at the start are rounding errors of the inverse kinematics, and
# count as rest
AT_REST = 1e-9


@njit(cache=True)
def _act(numbers, dt, axes, inputs, qvel, bristles, ctrl):
    for i in range(qvel.shape[0]):
        for j in range(axes.shape[0]):
            ctrl[i, inputs[j]] -= drag(qvel[i, axes[j]], dt, numbers[i, j], bristles[i, j], 0)


@njit(cache=True)
def _settle(numbers, axes, qvel, bristles):
    for i in range(qvel.shape[0]):
        for j in range(axes.shape[0]):
            v, p = qvel[i, axes[j]], numbers[i, j]
            bristles[i, j, 0] = (
                0.0 if abs(v) < AT_REST else math.copysign(stribeck(v, p) / p[BRISTLE], v)
            )


class Rubbing:
    """Friction of J drives of `n` runs.

    Attributes:
        bristles: (n, J, 1) deflection of each joint's bristle [m, rad].
    """

    def __init__(
        self,
        coulomb: Array,
        stiction: Array,
        stribeck_speed: Array,
        viscous: Array,
        presliding: Array,
        moved: Array,
        axes: NDArray,
        inputs: NDArray,
        dt: float,
    ) -> None:
        """Args: (n, J) parameters of each drive; presliding: stiffness before break-away. moved:
        (J,) smallest mass that a drive moves.
        """
        bristle = np.minimum(presliding, STEPS * moved / (dt * dt))
        damper = 2.0 * np.sqrt(bristle * moved)
        self._numbers = np.ascontiguousarray(
            np.stack(
                [
                    coulomb,
                    stiction,
                    stribeck_speed,
                    viscous,
                    np.zeros_like(coulomb),
                    bristle,
                    damper,
                ],
                axis=-1,
            )
        )
        self._axes, self._inputs, self._dt = np.asarray(axes), np.asarray(inputs), dt
        self.bristles = np.zeros((*coulomb.shape, 1))
        self._act = Call(
            _act, self._numbers, dt, self._axes, self._inputs, GIVEN, self.bristles, GIVEN
        )

    def settle(self, qvel: Array) -> None:
        """Start in the steady state at the speeds ``qvel`` (n, nv)."""
        _settle(self._numbers, self._axes, qvel, self.bristles)

    def acting(self, qvel: Array, ctrl: Array) -> Callable[[], None]:
        """Call that subtracts the friction of one step from the drives' inputs ``ctrl`` (n, nu),
        bound to arrays that are reused.
        """
        return self._act.on(qvel, ctrl)

    def state(self) -> dict[str, NDArray]:
        return {"bristles": self.bristles}
