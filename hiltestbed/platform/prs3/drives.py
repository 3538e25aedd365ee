"""The upper platform with its three drives, in MuJoCo, and the payload's load on the force sensor.

Only runs whose upper platform is not clamped at home are stepped. The control law of a drive is
that of the lower platform (:mod:`hiltestbed.platform.pss33.servo`), with feed-forward of the forces
for the planned motion and gravity. The payload's weight and inertia in the planned motion
(:mod:`hiltestbed.platform.payload`) are subtracted from the sensor's reading; the residual is
due to the difference between planned and actual acceleration. The passive mechanism moves with the
platform as one
rigid body: a compliant mount is assumed locked until the upper platform is clamped.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.contact.mount import CARRIER
from hiltestbed.frames import Array, rotate, rotate_back, twist_between
from hiltestbed.platform import model
from hiltestbed.platform.facilities.mover import has_diverged
from hiltestbed.platform.payload import GRAVITY, carry, load_of
from hiltestbed.platform.prs3.geometry import Upper, jacobian, motion, place, revolute, slider
from hiltestbed.platform.pss33.dynamics import add_force, invert, load_constants

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hiltestbed.scenario.like import ScenarioLike as Scenario

MOVED_PER_DRIVE = 240.0  # [kg] a third of platform, payload and links, carriage and armature
# [Hz] of the position loop, critically damped: longer limbs than the lower platform's
BANDWIDTH = 25.0
SPEED_LIMIT = 1e3  # [m/s], [rad/s] a joint faster than this has diverged


@njit(cache=True)
def _drive_forces(shape, legs, constants, x, pose, twist, accel, slider_accel, force):
    """``force`` (3,) [N] of the drives at ``x`` (3,), ``pose`` (7,) of P, for its acceleration
    ``accel`` (6,) and the sliders'.
    """
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
    motion(shape, x, rates)
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
def _aim(shape, legs, dt, away, xs, constants, payload, *given):
    """Write ``plan`` (n, m + 1, 3, 3), position, velocity and force of the drives at the start of
    each substep and at the end, and ``felt`` (n, m + 1, 6), the payload's wrench on the sensor
    then, in P; update the references.

    xs: (n, m, 3) coordinates at the ends of the substeps. constants: (16,)
        (:func:`hiltestbed.platform.pss33.dynamics.load_constants`). given: pose (n, 7), twist (n,
        6) of P, target and velocity (n, 3) of the sliders: planned values at the end of the last
        substep, updated; plan and felt.
    """
    pose, twist, target, velocity, plan, felt = given
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
                place(shape, x, goal)
                twist_between(pose[i], goal, dt, rate)
                for c in range(6):
                    accel[c] = (rate[c] - twist[i, c]) / dt
                for j in range(3):
                    now[j] = slider(legs[j], goal, arm)
                    speed[j] = (now[j] - target[i, j]) / dt
                    bend[j] = (speed[j] - velocity[i, j]) / dt
                _drive_forces(
                    shape, legs, constants, x, pose[i], twist[i], accel, bend, plan[i, s, 2]
                )
            else:
                plan[i, m, 2] = plan[i, m - 1, 2]
            plan[i, s, 0] = target[i]
            plan[i, s, 1] = velocity[i]
            carry(payload, pose[i, 3:7], twist[i, 3:6], accel, load)
            rotate_back(pose[i, 3:7], load[0:3], felt[i, s, 0:3])
            rotate_back(pose[i, 3:7], load[3:6], felt[i, s, 3:6])
            if s < m:
                pose[i], twist[i], target[i], velocity[i] = goal, rate, now, speed


@njit(cache=True)
def _push(away, plan, sub, kp, kv, adr, qpos, qvel, force):
    for i in range(force.shape[0]):
        if away[i]:
            for j in range(3):
                held = kp * (plan[i, sub, 0, j] - qpos[i, adr[0, j]]) + kv * (
                    plan[i, sub, 1, j] - qvel[i, adr[1, j]]
                )
                force[i, j] = plan[i, sub, 2, j] + held


@njit(cache=True)
def _take_out(away, felt, sub, reading, residual, left):
    """Subtract the payload from the sensor's reading: the residual is a wrench of active on passive
    side, zero while clamped.

    left: (n, 2) largest residual force and torque so far.
    """
    for i in range(reading.shape[0]):
        w = residual[i, sub]
        for j in range(6):
            w[j] = felt[i, sub + 1, j] - reading[i, j] if away[i] else 0.0
        left[i, 0] = max(left[i, 0], math.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2))
        left[i, 1] = max(left[i, 1], math.sqrt(w[3] ** 2 + w[4] ** 2 + w[5] ** 2))


@njit(cache=True)
def _observe(away, above, adr, qpos, qvel, diverged, pose, twist, sliders):
    """Pose and twist of P in W from the platform's free joint, and the sliders; returns whether a
    run has just diverged.
    """
    arm, lost = np.empty(3), False
    p, d = adr[0, 3], adr[1, 3]
    for i in range(qpos.shape[0]):
        if not away[i] or diverged[i]:
            continue
        if has_diverged(qpos[i], qvel[i], SPEED_LIMIT):
            diverged[i] = True
            lost = True
            continue
        for j in range(3):
            sliders[i, j] = qpos[i, adr[0, j]]
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

    def __init__(self, scenarios: Sequence[Scenario], nthread: int) -> None:
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
        self._qpos, self._qvel, self._ctrl = bind("qpos"), bind("qvel"), bind("ctrl")
        self._warmstart, self._reading = bind("qacc_warmstart"), bind("sensordata")
        joints = [m.joint(f"slider_{j}") for j in range(3)] + [m.joint("platform")]
        self._adr = np.array([[j.qposadr[0] for j in joints], [j.dofadr[0] for j in joints]])
        self.kp = MOVED_PER_DRIVE * (2.0 * math.pi * BANDWIDTH) ** 2
        self.kv = 2.0 * MOVED_PER_DRIVE * 2.0 * math.pi * BANDWIDTH
        self._pose, self._twist = np.zeros((n, 7)), np.zeros((n, 6))  # planned
        self._target, self._velocity = np.zeros((n, 3)), np.zeros((n, 3))
        self._plan, self._felt = (
            np.zeros((n, first.substeps + 1, 3, 3)),
            np.zeros((n, first.substeps + 1, 6)),
        )
        self._aim = Call(
            _aim,
            self.upper.shape,
            self.upper.legs,
            self._dt,
            GIVEN,
            GIVEN,
            load_constants(m, "P_nominal"),
            self.payload,
            self._pose,
            self._twist,
            self._target,
            self._velocity,
            self._plan,
            self._felt,
        )
        self.residual = np.zeros((n, first.substeps, 6))
        self.left = np.zeros((n, 2))

    def settle(self, i: int, x: Array, rates: Array) -> None:
        """Initialise the joints of run ``i`` in a motion with ``rates`` (3,) at the coordinates
        ``x`` (3,).
        """
        self._warmstart[i] = 0.0
        ahead = [self._joints(x + side * self._dt * rates) for side in (-1.0, 0.0, 1.0)]
        self._qpos[i] = ahead[1]
        mujoco.mj_differentiatePos(self.model, self._qvel[i], 2.0 * self._dt, ahead[0], ahead[2])
        arm, before = np.empty(3), np.empty(7)
        place(self.upper.shape, x, self._pose[i])
        place(self.upper.shape, x - self._dt * rates, before)
        twist_between(before, self._pose[i], self._dt, self._twist[i])
        for j, leg in enumerate(self.upper.legs):
            self._target[i, j] = slider(leg, self._pose[i], arm)
            self._velocity[i, j] = (self._target[i, j] - slider(leg, before, arm)) / self._dt

    def _joints(self, x: Array) -> Array:
        """``(nq,)`` MuJoCo's joints at the coordinates ``x`` (3,)."""
        q, pose, arm = self.model.qpos0.copy(), np.empty(7), np.empty(3)
        place(self.upper.shape, x, pose)
        for j, leg in enumerate(self.upper.legs):
            q[self._adr[0, j]] = slider(leg, pose, arm)
            q[self.model.joint(f"revolute_{j}").qposadr[0]] = revolute(leg, pose, arm)
        rotate(pose[3:7], np.array([0.0, 0.0, self.upper.shape[1]]), arm)
        p = self._adr[0, 3]
        q[p : p + 3] = pose[:3] + arm
        q[p + 3 : p + 7] = pose[[6, 3, 4, 5]]
        return q

    def run(self, xs: Array, away: NDArray[np.bool_], going: NDArray[np.intp]) -> None:
        """One tick through the coordinates ``xs`` (n, m, 3) for the runs ``away`` (n,), whose
        indices are ``going``.
        """
        self._aim.on(away, xs)()
        m = xs.shape[1]
        for s in range(m):
            self._push(s, away)
            if going.size:
                self.batch.step(going)
            if s > 0:  # a step gives the reading at its start
                _take_out(away, self._felt, s - 1, self._reading, self.residual, self.left)
        self._push(m, away)
        if going.size:
            self.batch.forward(going)
        _take_out(away, self._felt, m - 1, self._reading, self.residual, self.left)

    def _push(self, sub: int, away: NDArray[np.bool_]) -> None:
        _push(
            away, self._plan, sub, self.kp, self.kv, self._adr, self._qpos, self._qvel, self._ctrl
        )

    def observe(
        self,
        away: NDArray[np.bool_],
        pose: Array,
        twist: Array,
        sliders: Array,
        diverged: NDArray[np.bool_],
    ) -> bool:
        """Read pose (n, 7) and twist (n, 6) of P in W, and the sliders (n, 3); returns whether a
        run has just diverged.
        """
        return _observe(
            away,
            self.upper.shape[1],
            self._adr,
            self._qpos,
            self._qvel,
            diverged,
            pose,
            twist,
            sliders,
        )
