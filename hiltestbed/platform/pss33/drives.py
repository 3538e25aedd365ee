"""The 3-3 PSS platform of ``models/pss33`` and its drives: a position loop of each slider, with the
inverse dynamics of the planned motion fed forward.

A controller plans the sliders' references as described in
:mod:`hiltestbed.platform.facilities.reference`. The force of a drive is

    f = kp (s_ref - s) + kv (s_ref' - s') + f_ff,   f_ff the inverse dynamics in the sliders

with velocity and acceleration as differences at the physics step, so that without contact MuJoCo's
integrator reproduces the reference.

Inverse dynamics, gravity included: platform with mechanism as one rigid body, links as uniform rods
between carriage and anchor (consistent mass m/3, m/6, m/3, half the weight at each end), carriages
with their drives' armature. Velocity-dependent terms are neglected: at 0.3 m/s and 0.2 rad/s they
are below 1 N of some 7000 N.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property

import mujoco
import numpy as np

from hiltestbed.compiled.bound import GIVEN, Call, bound
from hiltestbed.compiled.jit import njit
from hiltestbed.config.models import load
from hiltestbed.frames import Array, rotate, rotate_back
from hiltestbed.platform.facilities.drives import Drives
from hiltestbed.platform.facilities.facility import (
    MOUNT,
    MOUNT_HOME,
    UPRIGHT,
    Facility,
    add_carrier,
    frame_of,
)
from hiltestbed.platform.facilities.force_servo import quantised
from hiltestbed.platform.facilities.kinematics import Axis
from hiltestbed.platform.facilities.mover import Runs, has_diverged
from hiltestbed.platform.facilities.reference import LEAVE, plan_tick, sample
from hiltestbed.platform.payload import GRAVITY, load_of
from hiltestbed.platform.pss33.kinematics import SliderKinematics, jacobian, joints
from hiltestbed.platform.pss33.settings import Pss33


def load_constants(m: mujoco.MjModel, tool: str = "active_A") -> Array:
    """``(16,)``: moved mass [kg], its centre of mass from A in A (3) [m], inertia about it in A (9,
    row-major) [kg m^2], link mass, carriage mass, armature [kg], of a compiled rig at home; A is
    its site ``tool``.
    """
    data = mujoco.MjData(m)
    mujoco.mj_forward(m, data)
    platform = m.body("platform").id
    bodies = [b for b in range(m.nbody) if m.body_rootid[b] == platform]
    carriage, link = m.body("carriage_0").mass[0], m.body("link_0").mass[0]
    armature = m.dof_armature[m.joint("slider_0").dofadr[0]]
    moved = load_of(m, data, bodies, data.site(tool).xpos)
    return np.concatenate([moved, [link, carriage, armature]])


@njit(cache=True)
def invert(a, out):
    """``out = a^-1`` (6, 6), row pivoting; overwrites ``a``. Singular: huge numbers."""
    n = a.shape[0]
    for i in range(n):
        for k in range(n):
            out[i, k] = 1.0 if i == k else 0.0
    for c in range(n):
        p = c
        for r in range(c + 1, n):
            if abs(a[r, c]) > abs(a[p, c]):
                p = r
        if p != c:
            for k in range(n):
                a[c, k], a[p, k] = a[p, k], a[c, k]
                out[c, k], out[p, k] = out[p, k], out[c, k]
        scale = 1.0 / (a[c, c] if abs(a[c, c]) > 1e-9 else math.copysign(1e-9, a[c, c]))
        for k in range(n):
            a[c, k] *= scale
            out[c, k] *= scale
        for r in range(n):
            f = a[r, c]
            if r != c and f != 0.0:
                for k in range(n):
                    a[r, k] -= f * a[c, k]
                    out[r, k] -= f * out[c, k]


@njit(cache=True)
def drive_forces(limbs, load, pose, inverse, accel, force):
    """``force`` (6,) [N] of the drives at the pose ``(7,)`` for slider accelerations ``accel`` (6,)
    [m/s^2].

    ``inverse`` (6, 6) maps slider rates to the twist of A in W; by virtual work its transpose maps
    wrenches to slider forces.
    """
    mass, link, carriage, armature = load[0], load[13], load[14], load[15]
    a = np.empty(6)
    for i in range(6):
        a[i] = 0.0
        for j in range(6):
            a[i] += inverse[i, j] * accel[j]
    r = np.empty(3)
    f = np.empty(3)
    turn = np.empty(3)
    wrench = np.zeros(6)
    rotate(pose[3:7], load[1:4], r)
    f[0] = mass * (a[0] + a[4] * r[2] - a[5] * r[1])
    f[1] = mass * (a[1] + a[5] * r[0] - a[3] * r[2])
    f[2] = mass * (a[2] + a[3] * r[1] - a[4] * r[0] + GRAVITY)
    rotate_back(pose[3:7], a[3:6], turn)
    w = np.empty(3)
    for i in range(3):
        w[i] = load[4 + 3 * i] * turn[0] + load[5 + 3 * i] * turn[1] + load[6 + 3 * i] * turn[2]
    rotate(pose[3:7], w, wrench[3:6])
    add_force(f, r, wrench)
    for j in range(6):
        limb = limbs[j]
        rotate(pose[3:7], limb[6:9], r)
        f[0] = a[0] + a[4] * r[2] - a[5] * r[1]
        f[1] = a[1] + a[5] * r[0] - a[3] * r[2]
        f[2] = a[2] + a[3] * r[1] - a[4] * r[0]
        along = limb[3] * f[0] + limb[4] * f[1] + limb[5] * f[2]
        for i in range(3):
            f[i] = link * (f[i] / 3.0 + limb[3 + i] * accel[j] / 6.0)
        f[2] += 0.5 * link * GRAVITY
        add_force(f, r, wrench)
        force[j] = link * (along / 6.0 + accel[j] / 3.0) + (carriage + armature) * accel[j]
        force[j] += limb[5] * (0.5 * link + carriage) * GRAVITY
    for j in range(6):
        for i in range(6):
            force[j] += inverse[i, j] * wrench[i]


@njit(cache=True)
def add_force(f, r, wrench):
    """Add the force ``f`` at the arm ``r`` to ``wrench`` (6,)."""
    wrench[0] += f[0]
    wrench[1] += f[1]
    wrench[2] += f[2]
    wrench[3] += r[1] * f[2] - r[2] * f[1]
    wrench[4] += r[2] * f[0] - r[0] * f[2]
    wrench[5] += r[0] * f[1] - r[1] * f[0]


# A drive's share of the mass moved in heave: platform and mechanism 350 kg, three links, carriages
# and armatures of 97 kg, over 3.
MOVED_PER_DRIVE = 214.0  # [kg]
# [N/m] 300 N at 6 um: machine-tool drives give 1 to 50 um before they break away
PRESLIDING = 5.0e7
KP, KV, ENCODER = range(3)  # [N/m], [N s/m], resolution [m], 0: not quantised


@njit(cache=True)
def _aim(limbs, constants, targets, cycles, plan):
    """Plan a tick of the sliders, with the drives' forces in place of accelerations."""
    poses, twists = targets.poses, targets.twists
    k = plan.ticks[0]
    jac, inverse, at, accel = np.empty((6, 6)), np.empty((6, 6)), np.empty(6), np.empty(6)
    q, v = np.empty(3), np.empty(3)
    for i in range(poses.shape[0]):
        pose, length = poses[i, 0], cycles.length[i]
        jacobian(limbs, pose, at, jac)
        if k < 0:
            for j in range(6):
                joints(limbs[j], pose, twists[i, 0], q, v)
                plan.goal[i, j], plan.leave[i, j] = q[0], v[0]
            continue
        if k % length == 0:
            for j in range(6):
                plan.goal[i, j], plan.leave[i, j] = at[j], 0.0
                for c in range(6):
                    plan.leave[i, j] += jac[j, c] * twists[i, 0, c]
            sample(cycles, plan, i)
        plan_tick(cycles, plan, i)
        if k % length == length - 1:  # at the command itself, without the cubic's rounding
            for j in range(6):
                plan.reference[i, j] = plan.span[i, LEAVE, 0, j]
        invert(jac, inverse)
        for s in range(plan.steps.shape[1]):
            for j in range(6):
                accel[j] = plan.steps[i, s, 2, j]
            drive_forces(limbs, constants, pose, inverse, accel, plan.steps[i, s, 2])
    if k >= 0:
        plan.ticks[0] = k + 1


@njit(cache=True)
def _push(gains, axes, inputs, plan, sub, qpos, qvel, ctrl):
    """Forces of the drives [N] at the start of substep ``sub``; ``gains`` (n, 3)."""
    for i in range(qpos.shape[0]):
        p = gains[i]
        for j in range(axes.shape[1]):
            s = quantised(qpos[i, axes[0, j]], p[ENCODER])
            ctrl[i, inputs[j]] = (
                plan[i, sub, 2, j]
                + p[KP] * (plan[i, sub, 0, j] - s)
                + p[KV] * (plan[i, sub, 1, j] - qvel[i, axes[1, j]])
            )


@njit(cache=True)
def _observe(adr, centre, readings, sides, qpos, qvel, limit, diverged):
    """Pose and twist of A from the platform's free joint, and the sliders; returns whether a run
    has just exceeded ``limit`` or become non-finite.
    """
    pose, twist = sides.pose, sides.twist
    arm, turn = np.empty(3), np.empty(3)
    lost = False
    p, d = adr[0, 6], adr[1, 6]
    for i in range(qpos.shape[0]):
        if diverged[i] or has_diverged(qpos[i], qvel[i], limit):
            lost = lost or not diverged[i]
            diverged[i] = True
            continue
        for k in range(3):
            pose[i, 3 + k] = qpos[i, p + 4 + k]
        pose[i, 6] = qpos[i, p + 3]
        rotate(pose[i, 3:7], centre, arm)
        rotate(pose[i, 3:7], qvel[i, d + 3 : d + 6], turn)
        for k in range(3):
            pose[i, k] = qpos[i, p + k] - arm[k]
            twist[i, 3 + k] = turn[k]
        twist[i, 0] = qvel[i, d] - (turn[1] * arm[2] - turn[2] * arm[1])
        twist[i, 1] = qvel[i, d + 1] - (turn[2] * arm[0] - turn[0] * arm[2])
        twist[i, 2] = qvel[i, d + 2] - (turn[0] * arm[1] - turn[1] * arm[0])
        for j in range(6):
            readings.joints[i, j], readings.rates[i, j] = qpos[i, adr[0, j]], qvel[i, adr[1, j]]
    return lost


class SliderDrives(Drives):
    """Drives of the six sliders of `n` runs.

    Attributes:
        gains: (n, 3) of a drive: KP, KV, ENCODER.
    """

    kinematics: SliderKinematics

    def __init__(self, model: mujoco.MjModel, kinematics: SliderKinematics, runs: Runs) -> None:
        super().__init__(model, kinematics, runs)
        self.place_A, self.motion_A = self.pose, self.twist  # P is W
        self._constants = load_constants(model, kinematics.tools[0])
        band, damping = runs.numbers("bandwidth"), runs.numbers("damping_ratio")
        self.gains = np.column_stack(
            [
                MOVED_PER_DRIVE * (2.0 * math.pi * band) ** 2,
                2.0 * damping * MOVED_PER_DRIVE * 2.0 * math.pi * band,
                runs.numbers("encoder_resolution"),
            ]
        )
        self.encoder = self.gains[:, ENCODER]
        carried = float(self._constants[14] + self._constants[15])  # carriage and armature
        self.rub([s.actuator.law() for s in runs.settings], PRESLIDING, carried)

    @property
    def solution(self) -> Array:
        return np.array([self.kinematics.solve(poses)[0] for poses in self.poses])

    @cached_property
    def _solve(self) -> Callable[[], None]:
        limbs = self.kinematics.limbs
        return bound(_aim, limbs, self._constants, self.targets, self.cycles, self.plan)

    @cached_property
    def _seen(self) -> Call:
        at = self.kinematics.addresses, self.kinematics.centre
        return Call(_observe, *at, self.readings, self.sides, *(GIVEN,) * 4)

    @cached_property
    def _pushed(self) -> Call:
        law = self.gains, self._axes, self._inputs, self.plan.steps
        return Call(_push, *law, ..., GIVEN, GIVEN, GIVEN)


class Pss33Facility(Facility):
    """The platform of ``models/pss33``."""

    settings: Pss33

    @property
    def axes(self) -> tuple[Axis, ...]:
        s = self.settings.limits
        return tuple(
            Axis(f"slider_{j}", "m", -s.stroke, s.stroke, s.speed, s.acceleration, s.force)
            for j in range(6)
        )

    def spec(self) -> mujoco.MjSpec:
        spec = load("pss33/pss33")
        frame_of(spec)
        add_carrier(spec.worldbody)
        spec.option.gravity = [0.0, 0.0, -9.81]
        return spec

    def kinematics(self, model: mujoco.MjModel, tool: str = MOUNT) -> SliderKinematics:
        origin = MOUNT_HOME[:3] if tool == MOUNT else UPRIGHT[:3]
        return SliderKinematics(model, tool, self.axes, origin)

    def drives(self, model: mujoco.MjModel, runs: Runs, tool: str = MOUNT) -> SliderDrives:
        return SliderDrives(model, self.kinematics(model, tool), runs)

    def bandwidth(self) -> float:
        return self.settings.bandwidth
