"""The upper platform with its three drives, in MuJoCo, and the payload's load on the force sensor.

Only runs whose upper platform is not clamped at home are stepped. The control law of a drive is
that of the lower platform (:mod:`hiltestbed.platform.pss33.drives`), with feed-forward of the
forces for the planned motion and gravity. The payload's weight and inertia in the planned motion
(:mod:`hiltestbed.platform.payload`) are subtracted from the sensor's reading; the residual is
due to the difference between planned and actual acceleration. The passive mechanism moves with the
platform as one rigid body: a compliant mount is assumed locked until the upper platform is clamped.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call, bound
from hiltestbed.compiled.jit import njit
from hiltestbed.contact.mount import CARRIER
from hiltestbed.frames import Array, rotate, rotate_back, twist_between
from hiltestbed.platform import model
from hiltestbed.platform.facilities.mover import has_diverged
from hiltestbed.platform.payload import GRAVITY, carry, load_of
from hiltestbed.platform.prs3.geometry import Upper, jacobian, motion, place, slider, write_joints
from hiltestbed.platform.pss33.drives import add_force, invert, load_constants

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hiltestbed.scenario.like import ScenarioLike as Scenario

MOVED_PER_DRIVE = 240.0  # [kg] a third of platform, payload and links, carriage and armature
# [Hz] of the position loop, critically damped: longer limbs than the lower platform's
BANDWIDTH = 25.0
SPEED_LIMIT = 1e3  # [m/s], [rad/s] a joint faster than this has diverged


class UpperMotion(NamedTuple):
    """The motion of n upper platforms.

    Attributes:
        x, rate, speed: (n, 3) coordinates, their mean rate over the last tick, and the velocity of
            the cubic at its end. still: (n,) ticks at home. away, was_away: (n,) bool, not clamped
            in this tick and in the last one. xs: (n, m, 3) coordinates at the ends of the substeps.
        planned (n, 7), slope (n, 6): P in W at the end, and its slope over the tick. sliders: (n,
            3) at the end. reached (n, 7), twist (n, 6) and slid (n, 3): set to these.
    """

    x: Array
    rate: Array
    speed: Array
    still: NDArray[np.int64]
    away: NDArray[np.bool_]
    was_away: NDArray[np.bool_]
    xs: Array
    planned: Array
    slope: Array
    sliders: Array
    reached: Array
    twist: Array
    slid: Array


class UpperPlan(NamedTuple):
    """The planned motion of n upper platforms.

    Attributes:
        pose (n, 7), twist (n, 6) of P, target and velocity (n, 3) of the sliders: at the end of the
            last substep. steps: (n, m + 1, 3, 3) position, velocity and force of the drives at the
            start of each substep and at the end; load: (n, m + 1, 6) the payload's wrench on the
            sensor then, in P.
    """

    pose: Array
    twist: Array
    target: Array
    velocity: Array
    steps: Array
    load: Array


@njit(cache=True)
def _drive_forces(upper, constants, x, moved, slider_accel, force):
    """``force`` (3,) [N] of the drives at ``x`` (3,), for the sliders' acceleration; moved: pose
    (7,), twist (6,) and acceleration (6,) of P.
    """
    legs = upper.legs
    pose, twist, accel = moved
    rates, jac, sliders = np.empty((6, 3)), np.empty((3, 6)), np.empty(3)
    lever, inverse = np.zeros((3, 3)), np.empty((3, 3))
    wrench, arm, f = np.empty(6), np.empty(3), np.empty(3)
    link, carriage, armature = constants[13], constants[14], constants[15]
    carry(constants, pose[3:7], twist[3:6], accel, wrench)
    for j in range(3):
        slider(legs[j], pose, arm)
        a = slider_accel[j]
        f[0] = accel[0] + accel[4] * arm[2] - accel[5] * arm[1]
        f[1] = accel[1] + accel[5] * arm[0] - accel[3] * arm[2]
        f[2] = accel[2] + accel[3] * arm[1] - accel[4] * arm[0]
        force[j] = (
            link * (f[2] / 6.0 + a / 3.0)
            + (carriage + armature) * a
            + (0.5 * link + carriage) * GRAVITY
        )
        for c in range(3):
            f[c] *= link / 3.0
        f[2] += link * (a / 6.0 + 0.5 * GRAVITY)
        add_force(f, arm, wrench)
    motion(upper.shape, x, rates)
    jacobian(legs, pose, sliders, jac)
    for i in range(3):
        for j in range(3):
            for k in range(6):
                lever[i, j] += jac[i, k] * rates[k, j]
    invert(lever, inverse)
    for i in range(3):
        along = 0.0
        for k in range(6):
            along += rates[k, i] * wrench[k]
        for j in range(3):
            force[j] += inverse[i, j] * along


@njit(cache=True)
def _aim(upper, dt, constants, payload, plan, away, xs):
    """Plan a tick.

    constants: (16,) (:func:`hiltestbed.platform.pss33.drives.load_constants`). payload: (13,).
        xs: (n, m, 3) coordinates at the ends of the substeps.
    """
    pose, twist, target, velocity = plan.pose, plan.twist, plan.target, plan.velocity
    m = xs.shape[1]
    x = np.empty(3)
    goal, rate, accel = np.empty(7), np.empty(6), np.empty(6)
    now, speed, bend, arm, load = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(6)
    for i in range(xs.shape[0]):
        if not away[i]:
            continue
        for s in range(m + 1):
            if s < m:
                x[:] = xs[i, s]
                place(upper.shape, x, goal)
                twist_between(pose[i], goal, dt, rate)
                for c in range(6):
                    accel[c] = (rate[c] - twist[i, c]) / dt
                for j in range(3):
                    now[j] = slider(upper.legs[j], goal, arm)
                    speed[j] = (now[j] - target[i, j]) / dt
                    bend[j] = (speed[j] - velocity[i, j]) / dt
                moved = pose[i], twist[i], accel
                _drive_forces(upper, constants, x, moved, bend, plan.steps[i, s, 2])
            else:
                plan.steps[i, m, 2] = plan.steps[i, m - 1, 2]
            plan.steps[i, s, 0] = target[i]
            plan.steps[i, s, 1] = velocity[i]
            carry(payload, pose[i, 3:7], twist[i, 3:6], accel, load)
            rotate_back(pose[i, 3:7], load[0:3], plan.load[i, s, 0:3])
            rotate_back(pose[i, 3:7], load[3:6], plan.load[i, s, 3:6])
            if s < m:
                pose[i], twist[i], target[i], velocity[i] = goal, rate, now, speed


@njit(cache=True)
def _push(gains, adr, plan, qpos, qvel, force, away, sub):
    kp, kv = gains
    for i in range(force.shape[0]):
        if away[i]:
            for j in range(3):
                held = kp * (plan.steps[i, sub, 0, j] - qpos[i, adr[0, j]]) + kv * (
                    plan.steps[i, sub, 1, j] - qvel[i, adr[1, j]]
                )
                force[i, j] = plan.steps[i, sub, 2, j] + held


@njit(cache=True)
def _take_out(plan, reading, residual, left, away, sub):
    """Subtract the payload from the sensor's reading: the residual is a wrench of active on passive
    side, zero while clamped.

    left: (n, 2) largest residual force and torque so far.
    """
    for i in range(reading.shape[0]):
        w = residual[i, sub]
        for j in range(6):
            w[j] = plan.load[i, sub + 1, j] - reading[i, j] if away[i] else 0.0
        left[i, 0] = max(left[i, 0], math.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2))
        left[i, 1] = max(left[i, 1], math.sqrt(w[3] ** 2 + w[4] ** 2 + w[5] ** 2))


@njit(cache=True)
def _observe(above, adr, qpos, qvel, upper, diverged):
    """Read the motion of P in W, and the sliders; returns whether a run has just diverged."""
    pose, twist = upper.reached, upper.twist
    arm, lost = np.empty(3), False
    p, d = adr[0, 3], adr[1, 3]
    for i in range(qpos.shape[0]):
        if not upper.away[i] or diverged[i]:
            continue
        if has_diverged(qpos[i], qvel[i], SPEED_LIMIT):
            diverged[i] = lost = True
            continue
        for j in range(3):
            upper.slid[i, j] = qpos[i, adr[0, j]]
        pose[i, 3:6] = qpos[i, p + 4 : p + 7]
        pose[i, 6] = qpos[i, p + 3]
        arm[0] = arm[1] = 0.0
        arm[2] = -above
        rotate(pose[i, 3:7], arm, arm)
        rotate(pose[i, 3:7], qvel[i, d + 3 : d + 6], twist[i, 3:6])
        for k in range(3):
            pose[i, k] = qpos[i, p + k] + arm[k]
        twist[i, 0] = qvel[i, d] + twist[i, 4] * arm[2] - twist[i, 5] * arm[1]
        twist[i, 1] = qvel[i, d + 1] + twist[i, 5] * arm[0] - twist[i, 3] * arm[2]
        twist[i, 2] = qvel[i, d + 2] + twist[i, 3] * arm[1] - twist[i, 4] * arm[0]
    return lost


class UpperDrives:
    """The driven upper platforms of `n` runs.

    Attributes:
        payload: (13,) load on the sensor (:func:`hiltestbed.platform.payload.load_of`).
        residual: (n, m, 6) residual of the payload in the reading, at the m instants of the tick,
            in P at P's origin [N, N m].
        left: (n, 2) its largest force [N] and torque [N m] so far.
    """

    def __init__(self, scenarios: Sequence[Scenario], nthread: int, motion: UpperMotion) -> None:
        first, n = scenarios[0], len(scenarios)
        self._dt = first.tick / first.substeps
        self.model = m = model.upper_model(first.mechanism, self._dt)
        self.batch = Batch(m, n, nthread)
        self.upper = Upper.load()
        data = mujoco.MjData(m)
        mujoco.mj_forward(m, data)
        platform, carrier = m.body("platform").id, m.body(CARRIER).id
        carried = [b for b in range(carrier, m.nbody) if m.body_rootid[b] == platform]
        self.payload = load_of(m, data, carried, data.site("P_nominal").xpos)
        bind = self.batch.bind
        self._qpos, self._qvel, ctrl = bind("qpos"), bind("qvel"), bind("ctrl")
        self._warmstart, reading = bind("qacc_warmstart"), bind("sensordata")
        joints = [m.joint(f"slider_{j}") for j in range(3)] + [m.joint("platform")]
        adr = np.array([[int(j.qposadr[0]) for j in joints], [int(j.dofadr[0]) for j in joints]])
        self._adr, steps = adr, first.substeps
        gains = (
            MOVED_PER_DRIVE * (2.0 * math.pi * BANDWIDTH) ** 2,
            2.0 * MOVED_PER_DRIVE * 2.0 * math.pi * BANDWIDTH,
        )
        self._plan = plan = UpperPlan(
            pose=np.zeros((n, 7)),
            twist=np.zeros((n, 6)),
            target=np.zeros((n, 3)),
            velocity=np.zeros((n, 3)),
            steps=np.zeros((n, steps + 1, 3, 3)),
            load=np.zeros((n, steps + 1, 6)),
        )
        self.residual, self.left = np.zeros((n, steps, 6)), np.zeros((n, 2))
        constants, state = load_constants(m, "P_nominal"), (self._qpos, self._qvel)
        parts = self.upper, self._dt, constants, self.payload, plan
        self._aim = bound(_aim, *parts, motion.away, motion.xs)
        self._push = bound(_push, gains, adr, plan, *state, ctrl, motion.away, ...)
        taken = plan, reading, self.residual, self.left, motion.away
        self._take_out = bound(_take_out, *taken, ...)
        above = float(self.upper.shape[1])
        self._seen = Call(_observe, above, adr, *state, motion, GIVEN)

    def settle(self, i: int, x: Array, rates: Array) -> None:
        """Put run ``i`` in a motion with ``rates`` (3,) at the coordinates ``x`` (3,)."""
        self._warmstart[i] = 0.0
        arm, before, plan = np.empty(3), np.empty(7), self._plan
        joints = np.tile(self.model.qpos0, (3, 1))
        for q, side in zip(joints, (-1.0, 0.0, 1.0), strict=True):
            place(self.upper.shape, x + side * self._dt * rates, before)
            write_joints(self.model, before, q)
        self._qpos[i] = joints[1]
        mujoco.mj_differentiatePos(self.model, self._qvel[i], 2.0 * self._dt, joints[0], joints[2])
        place(self.upper.shape, x, plan.pose[i])
        place(self.upper.shape, x - self._dt * rates, before)
        twist_between(before, plan.pose[i], self._dt, plan.twist[i])
        for j, leg in enumerate(self.upper.legs):
            plan.target[i, j] = slider(leg, plan.pose[i], arm)
            plan.velocity[i, j] = (plan.target[i, j] - slider(leg, before, arm)) / self._dt

    def run(self, going: NDArray[np.intp]) -> None:
        """One tick of the planned motion for the runs ``going``, which are away."""
        self._aim()
        if not going.size:
            self.residual[:] = 0.0
            return
        m = self.residual.shape[1]
        for s in range(m + 1):
            self._push(s)
            if s < m:
                self.batch.step(going)
            else:
                self.batch.forward(going)
            if s > 0:  # a step gives the reading at its start
                self._take_out(s - 1)

    def observe(self, diverged: NDArray[np.bool_]) -> bool:
        """Read the motion of P in W, and the sliders; returns whether a run has just diverged."""
        return self._seen.on(diverged)()
