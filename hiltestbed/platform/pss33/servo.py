"""The motion platform with its six drives.

Over a tick each slider's reference follows the cubic that starts from the last reference with its
velocity, reaches the commanded pose at t_(k+1), and leaves it with the velocity that the numerical
model will have there: that of the tick plus half a tick of its acceleration, since a semi-implicit
velocity belongs to the middle of its tick. A controller with a cycle of several ticks, or with a
delay, interpolates as described in :mod:`hiltestbed.platform.facilities.reference`. The force of a
drive is

    f = kp (s_ref - s) + kv (s_ref' - s') + f_ff,   f_ff the inverse dynamics
    (:mod:`hiltestbed.platform.pss33.dynamics`)

with velocity and acceleration as differences at the physics step, so that without contact MuJoCo's
integrator reproduces the reference.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array, pose_step, rotate, rotate_back
from hiltestbed.platform.divergence import has_diverged
from hiltestbed.platform.facilities.reference import LEAVE, START, cubic, sample
from hiltestbed.platform.friction import DriveFriction
from hiltestbed.platform.pss33.dynamics import drive_forces, invert, load_constants
from hiltestbed.platform.pss33.kinematics import Platform, jacobian, joints
from hiltestbed.platform.pss33.settings import pss33_of

if TYPE_CHECKING:
    from hiltestbed.platform.pss33.settings import Pss33
    from hiltestbed.scenario.like import ScenarioLike as Scenario

# A drive's share of the mass moved in heave: platform and mechanism 350 kg, three links, carriages
# and armatures of 97 kg, over 3.
MOVED_PER_DRIVE = 214.0  # [kg]


@njit(cache=True)
def _aim(
    limbs,
    load,
    feed,
    k,
    cycles,
    lates,
    h,
    pose_cmd,
    twist_cmd,
    accel_cmd,
    target,
    ring,
    span,
    velocity,
    plan,
    ahead,
):
    """Write ``plan`` (n, m, 3, 6), position, velocity and force at the start of each substep of
    tick ``k``, and its end ``ahead`` (n, 6).

    cycles, lates: (n,) of the controllers. target: (n, 6) slider references [m]; velocity:
        difference at the last substep, updated.
    ring, span: see :func:`hiltestbed.platform.facilities.reference.sample`.
    Without ``feed`` (n,) only positions are commanded, interpolated linearly.
    """
    n, m = plan.shape[0], plan.shape[1]
    dt = h / m
    jac, inverse = np.empty((6, 6)), np.empty((6, 6))
    goal, leave, now, before = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    rate, accel, force = np.empty(6), np.empty(6), np.empty(6)
    for i in range(n):
        jacobian(limbs, pose_cmd[i], goal, jac)
        part = k % cycles[i]
        if part == 0:
            for j in range(6):
                leave[j] = 0.0
                for c in range(6):
                    leave[j] += jac[j, c] * (twist_cmd[i, c] + 0.5 * h * accel_cmd[i, c])
            sample(k, cycles[i], lates[i], ring, span, i, goal, leave)
        invert(jac, inverse)
        for j in range(6):
            before[j] = target[i, j]
        for s in range(m):
            t = (part * m + s + 1.0) / (cycles[i] * m)
            for j in range(6):
                s0, s1 = span[i, START, 0, j], span[i, LEAVE, 0, j]
                if feed[i]:
                    now[j] = cubic(
                        t, s0, span[i, START, 1, j], s1, span[i, LEAVE, 1, j], cycles[i] * h
                    )
                    rate[j] = (now[j] - before[j]) / dt
                    accel[j] = (rate[j] - velocity[i, j]) / dt
                else:
                    now[j] = s0 + t * (s1 - s0)
                    rate[j] = accel[j] = velocity[i, j] = 0.0
            drive_forces(limbs, load, pose_cmd[i], inverse, accel, force)
            for j in range(6):
                plan[i, s, 0, j] = before[j]
                plan[i, s, 1, j] = velocity[i, j]
                plan[i, s, 2, j] = force[j]
                velocity[i, j] = rate[j]
                before[j] = now[j]
        for j in range(6):
            ahead[i, j] = span[i, LEAVE, 0, j] if part == cycles[i] - 1 else now[j]


@njit(cache=True)
def _push(plan, sub, kp, kv, step, adr, qpos, qvel, force):
    """``force`` (n, 6) [N] of the drives at the start of substep ``sub``; ``step`` (n,) encoder
    resolution [m], 0: not quantised.
    """
    for i in range(force.shape[0]):
        for j in range(6):
            s = qpos[i, adr[0, j]]
            if step[i] > 0.0:
                s = step[i] * np.rint(s / step[i])
            force[i, j] = (
                plan[i, sub, 2, j]
                + kp[i] * (plan[i, sub, 0, j] - s)
                + kv[i] * (plan[i, sub, 1, j] - qvel[i, adr[1, j]])
            )


@njit(cache=True)
def _settle(limbs, pose, twist, target, speed, velocity, qpos, qvel, adr, platform, centre):
    """Joints, rates and references of a rig that moves uniformly with ``twist`` (n, 6) through
    ``pose`` (n, 7).
    """
    q, v = np.empty(3), np.empty(3)
    arm, turn = np.empty(3), np.empty(3)
    for i in range(pose.shape[0]):
        for j in range(6):
            joints(limbs[j], pose[i], twist[i], q, v)
            for k in range(3):
                qpos[i, adr[0, j] + k] = q[k]
                qvel[i, adr[1, j] + k] = v[k]
            target[i, j] = q[0]
            speed[i, j] = velocity[i, j] = v[0]
        rotate(pose[i, 3:7], centre, arm)
        rotate_back(pose[i, 3:7], twist[i, 3:6], turn)
        p, d = platform[0], platform[1]
        for k in range(3):
            qpos[i, p + k] = pose[i, k] + arm[k]
            qpos[i, p + 4 + k] = pose[i, 3 + k]
            qvel[i, d + 3 + k] = turn[k]
        qpos[i, p + 3] = pose[i, 6]
        qvel[i, d] = twist[i, 0] + twist[i, 4] * arm[2] - twist[i, 5] * arm[1]
        qvel[i, d + 1] = twist[i, 1] + twist[i, 5] * arm[0] - twist[i, 3] * arm[2]
        qvel[i, d + 2] = twist[i, 2] + twist[i, 3] * arm[1] - twist[i, 4] * arm[0]


@njit(cache=True)
def _observe(qpos, qvel, adr, platform, centre, limit, pose, twist, sliders, diverged):
    """Pose, twist and sliders from the joints; returns whether a run has just exceeded ``limit`` or
    become non-finite.
    """
    arm, turn = np.empty(3), np.empty(3)
    lost = False
    p, d = platform[0], platform[1]
    for i in range(qpos.shape[0]):
        if diverged[i]:
            continue
        if has_diverged(qpos[i], qvel[i], limit):
            diverged[i] = True
            lost = True
            continue
        pose[i, 3:6] = qpos[i, p + 4 : p + 7]
        pose[i, 6] = qpos[i, p + 3]
        rotate(pose[i, 3:7], centre, arm)
        rotate(pose[i, 3:7], qvel[i, d + 3 : d + 6], turn)
        twist[i, 3:6] = turn
        twist[i, 0] = qvel[i, d] - (turn[1] * arm[2] - turn[2] * arm[1])
        twist[i, 1] = qvel[i, d + 1] - (turn[2] * arm[0] - turn[0] * arm[2])
        twist[i, 2] = qvel[i, d + 2] - (turn[0] * arm[1] - turn[1] * arm[0])
        for k in range(3):
            pose[i, k] = qpos[i, p + k] - arm[k]
        for j in range(6):
            sliders[i, j] = qpos[i, adr[0, j]]
    return lost


class Servo:
    """References and inputs of the drives of `n` rigs, and the readings of the model's joints.

    Attributes:
        target: (n, 6) slider references at t_k [m].
        kp, kv: (n,) gains of a drive [N/m], [N s/m].
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        platforms: Sequence[Pss33],
        tick: float,
        substeps: int,
        feed: NDArray[np.bool_],
        tool: str = "active_A",
    ) -> None:
        """``tool``: the site that follows the command."""
        n = len(platforms)
        self.platform = Platform.load()
        self.tick, self._feed = tick, feed
        self._load = load_constants(model, tool)
        self.kp = np.array(
            [MOVED_PER_DRIVE * (2.0 * math.pi * p.bandwidth) ** 2 for p in platforms]
        )
        self.kv = np.array(
            [
                2.0 * p.damping_ratio * MOVED_PER_DRIVE * 2.0 * math.pi * p.bandwidth
                for p in platforms
            ]
        )
        self._encoder = np.array([p.encoder_resolution for p in platforms])
        sliders = [model.joint(f"slider_{j}") for j in range(6)]
        free = model.joint("platform")
        self._adr = np.array([[s.qposadr[0] for s in sliders], [s.dofadr[0] for s in sliders]])
        self._free = np.array([free.qposadr[0], free.dofadr[0]])
        self.target, self.speed, self.velocity = (
            np.zeros((n, 6)),
            np.zeros((n, 6)),
            np.zeros((n, 6)),
        )
        self._cycles = np.array([p.command.cycle(1.0 / tick) for p in platforms], dtype=np.int64)
        self._lates = np.array([p.command.delay_cycles for p in platforms], dtype=np.int64)
        self._ring, self._span = (
            np.zeros((n, int(self._lates.max(initial=0)) + 1, 2, 6)),
            np.zeros((n, 2, 2, 6)),
        )
        self._start, self._ticks = np.zeros((n, 7)), np.zeros(1, dtype=np.int64)
        self._plan, self._ahead = np.zeros((n, substeps, 3, 6)), np.zeros((n, 6))
        self._step, self._least = tick / substeps, float(self._load[14] + self._load[15])
        self._friction: DriveFriction | None = None
        self._applied = np.zeros((n, model.nv))
        self._aimed = Call(
            _aim,
            self.platform.limbs,
            self._load,
            self._feed,
            ...,
            self._cycles,
            self._lates,
            tick,
            GIVEN,
            GIVEN,
            GIVEN,
            self.target,
            self._ring,
            self._span,
            self.velocity,
            self._plan,
            self._ahead,
        )
        self._pushed = Call(
            _push, self._plan, ..., self.kp, self.kv, self._encoder, self._adr, GIVEN, GIVEN, GIVEN
        )
        self._seen = Call(
            _observe, GIVEN, GIVEN, self._adr, self._free, self.platform.centre, *(GIVEN,) * 5
        )

    def add_friction(self, scenarios: Sequence[Scenario], applied: Array) -> None:
        """Add the friction of the scenarios' actuators to the generalised forces ``applied`` (n,
        nv), if any has friction.
        """
        friction = DriveFriction(
            [pss33_of(s).actuator for s in scenarios], self._adr[1], self._least, self._step
        )
        if friction.acts:
            self._friction, self._applied = friction, applied

    def settle(self, pose: Array, twist: Array, qpos: Array, qvel: Array) -> None:
        """Initialise joints and references in a uniform motion with ``twist`` (n, 6) whose command
        is at ``pose`` (n, 7): the platform is behind by the controller's lag.
        """
        lag = self.tick * (self._cycles * (self._lates + 1) - 1)
        self._start[:] = pose
        for i in np.flatnonzero(lag):
            pose_step(pose[i], twist[i], -lag[i], self._start[i])
        _settle(
            self.platform.limbs, self._start, twist, self.target, self.speed, self.velocity,
            qpos, qvel, self._adr, self._free, self.platform.centre,
        )  # fmt: skip
        self._ticks[0] = 0
        self._span[:, :, 0], self._span[:, :, 1] = self.target[:, None], self.speed[:, None]
        for back in range(1, self._ring.shape[1]):  # commands that are still delayed
            ahead = self.tick * self._cycles * (self._lates + 1 - back)
            self._ring[:, -back % self._ring.shape[1], 0] = (
                self.target + self.speed * ahead[:, None]
            )
            self._ring[:, -back % self._ring.shape[1], 1] = self.speed
        if self._friction:
            self._friction.settle(qvel)

    def aim(self, pose_cmd: Array, twist_cmd: Array, accel_cmd: Array) -> None:
        """Plan one tick; ``pose_cmd`` (n, 7) is the commanded pose at its end."""
        self._aimed.on(pose_cmd, twist_cmd, accel_cmd)(int(self._ticks[0]))
        self._ticks[0] += 1

    def arrive(self) -> None:
        """Complete the tick: its end is the start of the next one."""
        self.target[:] = self._ahead

    def state(self) -> dict[str, NDArray[Any]]:
        """The arrays of the state between two ticks; restoring them resumes the drives from
        there.
        """
        return {
            "sliders": self.target,
            "slope": self.velocity,
            "held": self._ring,
            "between": self._span,
            "cycle": self._ticks,
        }

    def push(self, sub: int, qpos: Array, qvel: Array, force: Array) -> None:
        """``force`` (n, 6) [N] of the drives for substep ``sub`` of the tick, from the current
        joint state.
        """
        self._pushed.on(qpos, qvel, force)(sub)
        if self._friction:
            self._friction.act(qvel, self._applied)

    def observe(
        self,
        qpos: Array,
        qvel: Array,
        limit: float,
        pose: Array,
        twist: Array,
        sliders: Array,
        diverged: Array,
    ) -> bool:
        """Read pose, twist and sliders; returns whether a run has just exceeded ``limit`` [m/s,
        rad/s], and marks it in ``diverged``.
        """
        return self._seen.on(qpos, qvel, limit, pose, twist, sliders, diverged)()
