"""The Stewart platform: six legs, each a universal joint on the floor, an extensible leg, a
spherical joint at the platform. Its drives are electric
(:mod:`hiltestbed.platform.facilities.force_servo`) or hydraulic cylinders, as in most docking
simulators of this type; the reference for the latter is the response reported for the simulator in
Harbin: at most 2 dB and 70 degrees at 10 Hz.

A hydraulic leg is a double-rod cylinder of area A with a four-way valve (Merritt, Hydraulic
Control Systems, 1967, ch. 6, with its symbols):

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
from collections.abc import Hashable
from functools import cached_property

import mujoco
import numpy as np

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array
from hiltestbed.platform.facilities.drives import Drives, mass_matrix
from hiltestbed.platform.facilities.facility import (
    MOUNT,
    Facility,
    Runs,
    compiled,
    standing,
)
from hiltestbed.platform.facilities.force_servo import ForceServo, quantised
from hiltestbed.platform.facilities.kinematics import Axis, Kinematics
from hiltestbed.platform.shipped.stewart import StewartSettings

STROKE = 1.04  # [m] of a cylinder
ARMATURE = 120.0  # [kg] of an electric leg: rotor and screw 3e-3 kg m^2 at a lead of 31 mm
PRESLIDING = 2.0e7  # [N/m] of a seal: 300 N at 15 um


class Stewart(Facility):
    """The Stewart platform of ``models/stewart``."""

    settings: StewartSettings

    @property
    def axes(self) -> tuple[Axis, ...]:
        drive = self.settings.drive
        force = drive.supply * drive.area if drive.kind == "hydraulic" else drive.force
        half = 0.5 * STROKE
        return tuple(
            Axis(f"leg_{j}", "m", -half, half, drive.speed, drive.acceleration, force)
            for j in range(6)
        )

    def alike(self) -> Hashable:
        return (self.kind, self.settings.drive.kind)

    def spec(self) -> mujoco.MjSpec:
        spec = standing("stewart/stewart")
        if self.settings.drive.kind == "electric":
            for j in range(6):
                spec.joint(f"leg_{j}").armature = ARMATURE
        return spec

    def drives(self, model: mujoco.MjModel, runs: Runs, tool: str = MOUNT) -> Drives:
        kinematics = self.kinematics(model, tool)
        drives = (
            ForceServo(model, kinematics, runs, "drive")
            if self.settings.drive.kind == "electric"
            else Hydraulic(model, kinematics, runs)
        )
        # the smallest mass that a leg moves: its rod and its drive
        leg = float(
            model.body("rod_0").mass[0] + model.dof_armature[model.joint("leg_0").dofadr[0]]
        )
        drives.rub([s.drive.friction.law() for s in runs.settings], PRESLIDING, leg)
        return drives

    def bandwidth(self) -> float:
        """Hydraulic: at low frequency the third-order system lags by 1/K; its resonance is that of
        the oil with the bare platform in heave, sqrt(k/m) of its own stiffness and mass.
        """
        drive = self.settings.drive
        if drive.kind == "electric":
            return drive.bandwidth
        model = compiled(self.spec())
        kinematics = self.kinematics(model)
        twists, _ = kinematics.jacobian(kinematics.home)
        legs = np.linalg.inv(twists)
        mass = legs.T @ mass_matrix(kinematics, model) @ legs
        side = drive.dead_volume + 0.5 * drive.area * STROKE
        oil = 2.0 * drive.bulk_modulus * drive.area**2 / side  # [N/m] of a leg, its valve shut
        w = math.sqrt(oil * float((legs.T @ legs)[2, 2] / mass[2, 2]))
        return math.sqrt(drive.gain * w) / (2.0 * math.pi)


# parameters of a leg, and the low-pass coefficient of the pressure feedback per step
LEG = (
    "area",
    "supply",
    "valve.flow",
    "bulk_modulus",
    "dead_volume",
    "leakage",
    "pressure_feedback",
    "gain",
    "encoder_resolution",
)
AREA, SUPPLY, FLOW, MODULUS, DEAD, LEAKAGE, FEEDBACK, GAIN, ENCODER, CORNER = range(10)
SPOOL, SPOOL_RATE, PRESSURE, SLOW, TRIM, STATES = range(6)


@njit(cache=True)
def _push(legs, parameters, state, plan, sub, qpos, qvel, ctrl):
    """legs: step [s], mass (J, J), addresses of joints and actuators, home (J,). parameters: those
    of the legs (n, 10), state transition of the valve over a step (n, 2, 2), feed-forward (n,).
    state: (n, J, STATES).
    """
    (dt, mass, axes, inputs, home), (numbers, valve, feed) = legs, parameters
    joints = mass.shape[0]
    for i in range(qpos.shape[0]):
        p = numbers[i]
        area = p[AREA]
        for j in range(joints):
            x, s, v = state[i, j], qpos[i, axes[0, j]] - home[j], qvel[i, axes[1, j]]
            speed = p[GAIN] * (plan[i, sub, 0, j] - home[j] - quantised(s, p[ENCODER]))
            speed -= p[FEEDBACK] * (x[PRESSURE] - x[SLOW]) / area
            if feed[i]:
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
            half = 0.5 * STROKE
            stiffness = p[MODULUS] * (
                1.0 / (p[DEAD] + area * max(half + s, 0.0))
                + 1.0 / (p[DEAD] + area * max(half - s, 0.0))
            )
            x[PRESSURE] = (x[PRESSURE] + dt * stiffness * (flow - area * v)) / (
                1.0 + dt * stiffness * p[LEAKAGE]
            )
            x[SLOW] += (x[PRESSURE] - x[SLOW]) * p[CORNER]
            ctrl[i, inputs[j]] = area * x[PRESSURE]


def _opening(flow: Array, pressure: Array, p: Array) -> Array:
    """Valve opening [-] for a flow [m^3/s] against a load pressure [Pa]."""
    drop = 1.0 - np.copysign(pressure, flow * pressure) / p[SUPPLY]
    return flow / (p[FLOW] * np.sqrt(np.maximum(drop, 1e-6)))


class Hydraulic(Drives):
    """Hydraulic drives of `n` runs.

    Attributes:
        cylinders: (n, J, STATES) spool opening [-] and its rate [1/s], load pressure and its slow
            part [Pa], trim of the valve [-].
    """

    def __init__(self, model: mujoco.MjModel, kinematics: Kinematics, runs: Runs) -> None:
        """The settings of each run have a section ``drive``."""
        from scipy.linalg import expm

        super().__init__(model, kinematics, runs)
        drives = [s.drive for s in runs.settings]
        corners = [1.0 - math.exp(-2.0 * math.pi * d.feedback_corner * self.step) for d in drives]
        numbers = np.column_stack([*(runs.numbers(f"drive.{name}") for name in LEG), corners])
        self.encoder = numbers[:, ENCODER]
        self.cylinders = np.zeros((*self.load.shape, STATES))
        valves = []
        for valve in (d.valve for d in drives):
            w = 2.0 * math.pi * valve.bandwidth
            law = np.array([[0.0, 1.0], [-w * w, -2.0 * valve.damping_ratio * w]])
            valves.append(expm(law * self.step))
        self._numbers, self._valve = numbers, np.array(valves)
        self._mass = np.ascontiguousarray(mass_matrix(kinematics, model))

    def rest(self, qpos: Array, qvel: Array) -> None:
        p = self._numbers.T[..., None]
        pressure = self.load / p[AREA]
        flow = p[LEAKAGE] * pressure
        moving = flow + p[AREA] * qvel[:, self.axes[1]]
        x = np.moveaxis(self.cylinders, 2, 0)
        x[PRESSURE], x[SLOW], x[SPOOL_RATE] = pressure, pressure, 0.0
        x[TRIM], x[SPOOL] = _opening(flow, pressure, p), _opening(moving, pressure, p)
        super().rest(qpos, qvel)

    @cached_property
    def _pushed(self) -> Call:
        legs = self.step, self._mass, self.axes, self._inputs, self._home
        parameters = self._numbers, self._valve, self.plan.feed
        given = self.cylinders, self.plan.steps, ..., GIVEN, GIVEN, GIVEN
        return Call(_push, legs, parameters, *given)

    def feedback(self) -> Array:
        return self.cylinders.reshape(len(self.cylinders), -1)
