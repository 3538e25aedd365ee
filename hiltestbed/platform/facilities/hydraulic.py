"""Hydraulic drives: servo valve, orifice, oil, leakage, seals, and the controller of a leg.

A double-rod cylinder of area A with a four-way valve (Merritt, Hydraulic Control Systems, 1967, ch.
6, with its symbols):

    valve     x_v'' = w_v^2 (u - x_v) - 2 zeta_v w_v x_v',   -1 <= u <= 1
              advanced exactly, u constant over a step
    orifice  Q = Q_0 x_v sqrt(max(1 - sgn(x_v) p/p_s, 0))  Q_0: no-load flow at full opening
    oil       p' = beta (1/V_1 + 1/V_2) (Q - A s' - C p),   V_1,2 = V_0 + A (S/2 +- s)
    seals     f = A p - friction(s')

p is the load pressure, C the leakage past the piston, V_0 the dead volume of a side, S the stroke.
The oil is a spring of stiffness k_h = beta A^2 (1/V_1 + 1/V_2). The controller of a leg commands a
speed,

    v_c = K (s_r - s) + s_r' + (C + C_f) p_r/A - C_f (p - p_f)/A,   u = v_c A/Q_0 + trim

K the position gain; C_f p the dynamic pressure feedback that damps the oil's resonance, less its
slow part p_f (first-order low-pass), so that a static load does not move the piston; p_r = M
s_r''/A the pressure for the planned acceleration. Without feed-forward s_r' and p_r are omitted; if
the valve is much faster than the oil, a leg is then the third-order system

    K w_h^2/(s^3 + 2 zeta_h w_h s^2 + w_h^2 s + K w_h^2),   w_h^2 = k_h/m,   2 zeta_h w_h = beta
    (1/V_1 + 1/V_2) (C + C_f)
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
from hiltestbed.platform.facilities.force_servo import quantised
from hiltestbed.platform.facilities.kinematics import Kinematics
from hiltestbed.platform.friction import DriveFriction

AREA, SUPPLY, FLOW, MODULUS, DEAD, STROKE, LEAKAGE, FEEDBACK, CORNER, GAIN, ENCODER, NUMBERS = (
    range(12)
)
SPOOL, SPOOL_RATE, PRESSURE, SLOW, TRIM, STATES = range(6)


@njit(cache=True)
def _push(plan, sub, dt, fed, mass, numbers, valve, axes, inputs, home, qpos, qvel, state, ctrl):
    """numbers: (n, NUMBERS). valve: (n, 2, 2) state transition of the valve over a step. state: (n,
    J, STATES).
    """
    joints = mass.shape[0]
    for i in range(qpos.shape[0]):
        p = numbers[i]
        area = p[AREA]
        for j in range(joints):
            x, s, v = state[i, j], qpos[i, axes[0, j]] - home[j], qvel[i, axes[1, j]]
            speed = p[GAIN] * (plan[i, sub, 0, j] - home[j] - quantised(s, p[ENCODER]))
            speed -= p[FEEDBACK] * (x[PRESSURE] - x[SLOW]) / area
            if fed[i]:
                force = 0.0
                for k in range(joints):
                    force += mass[j, k] * plan[i, sub, 2, k]
                speed += plan[i, sub, 1, j] + (p[LEAKAGE] + p[FEEDBACK]) * force / (area * area)
            command = min(max(speed * area / p[FLOW] + x[TRIM], -1.0), 1.0)
            error, rate = x[SPOOL] - command, x[SPOOL_RATE]
            x[SPOOL] = command + valve[i, 0, 0] * error + valve[i, 0, 1] * rate
            x[SPOOL_RATE] = valve[i, 1, 0] * error + valve[i, 1, 1] * rate
            opening = min(max(x[SPOOL], -1.0), 1.0)
            drop = 1.0 - math.copysign(x[PRESSURE], opening * x[PRESSURE]) / p[SUPPLY]
            flow = p[FLOW] * opening * math.sqrt(max(drop, 0.0))
            half = 0.5 * p[STROKE]
            stiffness = p[MODULUS] * (
                1.0 / (p[DEAD] + area * max(half + s, 0.0))
                + 1.0 / (p[DEAD] + area * max(half - s, 0.0))
            )
            x[PRESSURE] = (x[PRESSURE] + dt * stiffness * (flow - area * v)) / (
                1.0 + dt * stiffness * p[LEAKAGE]
            )
            x[SLOW] += (x[PRESSURE] - x[SLOW]) * p[CORNER]
            ctrl[i, inputs[j]] = area * x[PRESSURE]


@njit(cache=True)
def _rest(numbers, load, axes, qvel, state):
    """Pressures that support the ``load`` (n, J), and the valve openings for leakage and speed."""
    for i in range(load.shape[0]):
        p = numbers[i]
        for j in range(load.shape[1]):
            x = state[i, j]
            pressure = load[i, j] / p[AREA]
            x[PRESSURE] = x[SLOW] = pressure
            flow = p[LEAKAGE] * pressure
            x[TRIM] = opening(flow, pressure, p)
            x[SPOOL] = opening(flow + p[AREA] * qvel[i, axes[1, j]], pressure, p)
            x[SPOOL_RATE] = 0.0


@njit(cache=True)
def opening(flow, pressure, p):
    """Valve opening [-] for a flow [m^3/s] against a load pressure [Pa]."""
    drop = 1.0 - math.copysign(pressure, flow * pressure) / p[SUPPLY]
    return flow / (p[FLOW] * math.sqrt(max(drop, 1e-6)))


def held_over(bandwidth: float, damping_ratio: float, dt: float) -> Array:
    """``(2, 2)`` state transition of error and rate of x'' = w^2 (u - x) - 2 zeta w x' over ``dt``
    [s] with constant u.
    """
    from scipy.linalg import expm

    w = 2.0 * math.pi * bandwidth
    return np.asarray(
        expm(np.array([[0.0, 1.0], [-w * w, -2.0 * damping_ratio * w]]) * dt), dtype=float
    )


class Hydraulic(Drives):
    """Hydraulic drives of `n` runs.

    Attributes:
        cylinders: (n, J, STATES) spool opening [-] and its rate [1/s], load pressure and its slow
            part [Pa], trim of the valve [-].
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
        numbers: Array,
        valves: Sequence[tuple[float, float]],
        friction: DriveFriction | None = None,
    ) -> None:
        """Args: numbers: (n, NUMBERS), in the order of the constants of this module, CORNER as the
        low-pass coefficient per step.
        valves: (n,) bandwidth [Hz] and damping ratio.
        """
        super().__init__(model, kinematics, tick, substeps, settings, feed)
        self._numbers, self._mass = (
            np.ascontiguousarray(numbers),
            np.ascontiguousarray(self.mass_matrix()),
        )
        self._valve = np.array([held_over(*valve, self.step) for valve in valves])
        self.cylinders, self._friction = (
            np.zeros((len(feed), len(kinematics.axes), STATES)),
            friction,
        )

    def rest(self, qpos: Array, qvel: Array) -> None:
        _rest(self._numbers, self.load, self._axes, qvel, self.cylinders)
        if self._friction:
            self._friction.settle(qvel)

    def release(self) -> None:
        super().release()
        self._numbers[:, ENCODER] = 0.0

    @cached_property
    def _pushed(self) -> Call:
        return Call(
            _push,
            self.plan.steps,
            ...,
            self.step,
            self.cycles.feed,
            self._mass,
            self._numbers,
            self._valve,
            self._axes,
            self._inputs,
            self._home,
            GIVEN,
            GIVEN,
            self.cylinders,
            GIVEN,
        )

    def push(self, sub: int, qpos: Array, qvel: Array, ctrl: Array) -> None:
        self.pushing(self._pushed, qpos, qvel, ctrl)(sub)

    def feedback(self) -> Array:
        return self.cylinders.reshape(len(self.cylinders), -1)

    def state(self) -> dict[str, NDArray]:
        return super().state() | {"cylinders": self.cylinders}
