"""The 3-3 PSS platform of ``models/pss33``: six sliders, each with a link to the platform, whose
drives have a position loop each and the inverse dynamics of the planned motion fed forward.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, cached_property

import mujoco
import numpy as np

from hiltestbed.compiled.bound import bound
from hiltestbed.compiled.jit import njit
from hiltestbed.config.models import load
from hiltestbed.frames import Array
from hiltestbed.platform.facilities.facility import (
    MOUNT,
    MOUNT_HOME,
    UPRIGHT,
    Facility,
    Runs,
    standing,
)
from hiltestbed.platform.facilities.force_servo import ForceServo
from hiltestbed.platform.facilities.kinematics import Axis
from hiltestbed.platform.facilities.limbs import (
    LimbKinematics,
    invert,
    jacobian,
    limb_forces,
    limbs_of,
    moved_masses,
)
from hiltestbed.platform.facilities.motion import GRAVITY
from hiltestbed.platform.facilities.reference import LEAVE, plan_tick, sample
from hiltestbed.platform.shipped.pss33 import Pss33

# A drive's share of the mass moved in heave: platform and mechanism 350 kg, three links, carriages
# and armatures of 97 kg, over 3.
MOVED_PER_DRIVE = 214.0  # [kg]
# [N/m] 300 N at 6 um: machine-tool drives give 1 to 50 um before they break away
PRESLIDING = 5.0e7


@njit(cache=True)
def _aim(limbs, moved, share, targets, plan):
    """Plan a tick of the sliders, the acceleration of each the force of its drive over ``share``.

    The motion is planned at rest: at 0.3 m/s and 0.2 rad/s the terms that depend on velocity are
    below 1 N of some 7000 N.
    """
    poses, twists = targets.poses, targets.twists
    k = plan.ticks[0]
    jac, ways, at, accel = np.empty((6, 6)), np.empty((6, 6)), np.empty(6), np.empty(6)
    bend, still, work = np.empty(6), np.zeros(3), np.empty((8, 3))
    for i in range(poses.shape[0]):
        pose, length = poses[i, 0], plan.length[i]
        jacobian(limbs, pose, at, jac)
        if k < 0 or k % length == 0:
            for j in range(6):
                plan.goal[i, j], plan.leave[i, j] = at[j], 0.0
                for c in range(6):
                    plan.leave[i, j] += jac[j, c] * twists[i, 0, c]
        if k < 0:
            continue
        if k % length == 0:
            sample(plan, i)
        plan_tick(plan, i)
        if k % length == length - 1:  # at the command itself, without the cubic's rounding
            for j in range(6):
                plan.reference[i, j] = plan.span[i, LEAVE, 0, j]
        invert(jac, ways)
        for s in range(plan.steps.shape[1]):
            for c in range(6):
                accel[c], bend[c] = plan.steps[i, s, 2, c], 0.0
                for j in range(6):
                    bend[c] += ways[c, j] * plan.steps[i, s, 2, j]
            bend[2] += GRAVITY
            force = plan.steps[i, s, 2]
            limb_forces(limbs, moved, ways, (pose, still, bend), accel, work, force)
            for j in range(6):
                force[j] /= share
    if k >= 0:
        plan.ticks[0] = k + 1


class SliderDrives(ForceServo):
    """Drives of the sliders of `n` runs of a platform on limbs.

    Attributes:
        moved: (16,) as in :func:`hiltestbed.platform.facilities.limbs.moved_masses`.
    """

    kinematics: LimbKinematics

    def __init__(
        self, model: mujoco.MjModel, kinematics: LimbKinematics, runs: Runs, share: float
    ) -> None:
        """``share``: of the moved mass, for which each drive's position loop is tuned [kg]."""
        super().__init__(model, kinematics, runs, mass=share * np.eye(len(kinematics.axes)))
        self.share, self.moved = share, moved_masses(model, kinematics.tools[0])

    @property
    def solution(self) -> Array:
        return np.array([self.kinematics.solve(poses)[0] for poses in self.poses])

    @cached_property
    def _solve(self) -> Callable[[], None]:
        masses = self.moved, self.share
        return bound(_aim, self.kinematics.limbs, *masses, self.targets, self.plan)


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
        return standing("pss33/pss33")

    def kinematics(self, model: mujoco.MjModel, tool: str = MOUNT) -> LimbKinematics:
        origin = MOUNT_HOME[:3] if tool == MOUNT else UPRIGHT[:3]
        return LimbKinematics(model, tool, self.axes, origin)

    def drives(self, model: mujoco.MjModel, runs: Runs, tool: str = MOUNT) -> SliderDrives:
        drives = SliderDrives(model, self.kinematics(model, tool), runs, MOVED_PER_DRIVE)
        carried = float(drives.moved[14:].sum())  # carriage and armature
        drives.rub([s.actuator.law() for s in runs.settings], PRESLIDING, carried)
        return drives

    def bandwidth(self) -> float:
        return self.settings.bandwidth


@cache
def shipped_limbs() -> Array:
    """``(6, 10)`` limbs of ``models/pss33``, with A's home at W's origin."""
    return limbs_of(load("pss33/pss33").compile(), np.zeros(3))
