"""Drives of the 3-3 PSS platform: a position loop of each slider, with the inverse dynamics of the
planned motion fed forward.

A controller plans the sliders' references as described in
:mod:`hiltestbed.platform.facilities.reference`. The force of a drive is

    f = kp (s_ref - s) + kv (s_ref' - s') + f_ff,   f_ff the inverse dynamics
    (:mod:`hiltestbed.platform.pss33.dynamics`)

with velocity and acceleration as differences at the physics step, so that without contact MuJoCo's
integrator reproduces the reference.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property

import mujoco
import numpy as np

from hiltestbed.compiled.bound import GIVEN, Call, bound
from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array, rotate
from hiltestbed.platform.facilities.drives import Drives
from hiltestbed.platform.facilities.force_servo import quantised
from hiltestbed.platform.facilities.mover import Runs, has_diverged
from hiltestbed.platform.facilities.reference import LEAVE, plan_tick, sample
from hiltestbed.platform.pss33.dynamics import drive_forces, invert, load_constants
from hiltestbed.platform.pss33.kinematics import SliderKinematics, jacobian, joints

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
        return Call(_observe, *at, self.readings, self.sides, GIVEN, GIVEN, ..., GIVEN)

    @cached_property
    def _pushed(self) -> Call:
        law = self.gains, self._axes, self._inputs, self.plan.steps
        return Call(_push, *law, ..., GIVEN, GIVEN, GIVEN)
