"""The upper platform with its three drives, in MuJoCo, and the payload's load on the force sensor.

Only runs whose upper platform is not clamped at home are stepped. Its drives are those of the lower
platform (:mod:`hiltestbed.platform.facilities.pss33`), but their references follow the planned
coordinates from step to step. The payload's weight and inertia in the planned motion
(:func:`hiltestbed.platform.facilities.motion.carry`) are subtracted from the sensor's
reading; the residual is due to the difference between planned and actual acceleration. The passive
mechanism moves with the platform as one rigid body: a compliant mount is assumed locked until the
upper platform is clamped.
"""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import copied, njit
from hiltestbed.config.models import load
from hiltestbed.contact.composition import add_passive, drawn
from hiltestbed.contact.mount import CARRIER
from hiltestbed.contact.settings import Mechanism
from hiltestbed.frames import Array, rotate_back, twist_between
from hiltestbed.platform.driven import SPEED_LIMIT
from hiltestbed.platform.facilities.composed import carried_load
from hiltestbed.platform.facilities.facility import Runs, compiled
from hiltestbed.platform.facilities.limbs import invert, jacobian, limb_forces, slider
from hiltestbed.platform.facilities.motion import GRAVITY, carry
from hiltestbed.platform.facilities.prs3 import Upper, motion, place, upper_kinematics
from hiltestbed.platform.facilities.pss33 import SliderDrives
from hiltestbed.platform.shipped.pss33 import Pss33

MOVED_PER_DRIVE = 240.0  # [kg] a third of platform, payload and links, carriage and armature
# [Hz] of the position loop, critically damped: longer limbs than the lower platform's
BANDWIDTH = 25.0


def add_upper_passive(spec: mujoco.MjSpec, mechanism: Mechanism, prefix: str = "") -> None:
    """Add force sensor and passive mechanism to the upper platform in ``spec``; ``prefix`` of its
    names.
    """
    place = spec.site(f"{prefix}mount").pos
    carrier = spec.body(f"{prefix}platform").add_body(name=CARRIER, pos=place)
    add_passive(spec, drawn(mechanism), carrier)


def upper_model(mechanism: Mechanism, timestep: float) -> mujoco.MjModel:
    """The upper platform alone, with force sensor and passive mechanism."""
    spec = load("prs3/prs3")
    spec.modelname = f"prs3-{mechanism.kind}"
    spec.option.cone, spec.option.gravity = mujoco.mjtCone.mjCONE_ELLIPTIC, [0.0, 0.0, -9.81]
    add_upper_passive(spec, mechanism)
    return compiled(spec, timestep)


@njit(cache=True)
def _aim(upper, masses, payload, dt, port, plan, away, xs):
    """Plan a tick, as :class:`hiltestbed.platform.facilities.pss33.SliderDrives`, and its end.

    masses: of the platform (16,) and a drive's share. payload: (13,). port: pose (n, 7) and twist
    (n, 6) of P in W at the end of the last substep; load (n, m + 1, 6), the payload's wrench on the
    sensor at the start of each substep and at the end, in P. xs: (n, m, 3) coordinates at the ends
    of the substeps.
    """
    (moved, share), (pose, twist, loads) = masses, port
    target, velocity = plan.reference, plan.velocity
    m = xs.shape[1]
    rates, jac, sliders = np.empty((6, 3)), np.empty((3, 6)), np.empty(3)
    lever, inverse, ways = np.empty((3, 3)), np.empty((3, 3)), np.empty((6, 3))
    goal, rate, accel, work = np.empty(7), np.empty(6), np.empty(6), np.empty((8, 3))
    now, speed, bend, arm, load = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(6)
    for i in range(xs.shape[0]):
        if not away[i]:
            continue
        for s in range(m + 1):
            step = plan.steps[i, s]
            if s < m:
                place(upper.shape, xs[i, s], goal)
                twist_between(pose[i], goal, dt, rate)
                for c in range(6):
                    accel[c] = (rate[c] - twist[i, c]) / dt
                accel[2] += GRAVITY
                for j in range(3):
                    now[j] = slider(upper.limbs[j], goal, arm)
                    speed[j] = (now[j] - target[i, j]) / dt
                    bend[j] = (speed[j] - velocity[i, j]) / dt
                motion(upper.shape, xs[i, s], rates)
                jacobian(upper.limbs, pose[i], sliders, jac)
                for a in range(3):
                    for b in range(3):
                        lever[a, b] = 0.0
                        for c in range(6):
                            lever[a, b] += jac[a, c] * rates[c, b]
                invert(lever, inverse)
                for c in range(6):
                    for j in range(3):
                        ways[c, j] = 0.0
                        for a in range(3):
                            ways[c, j] += rates[c, a] * inverse[a, j]
                moving = pose[i], twist[i, 3:6], accel
                limb_forces(upper.limbs, moved, ways, moving, bend, work, step[2])
                for j in range(3):
                    step[2, j] /= share
            else:
                copied(plan.steps[i, m - 1, 2], step[2])
            copied(target[i], step[0])
            copied(velocity[i], step[1])
            carry(payload, pose[i, 3:7], twist[i, 3:6], accel, work, load)
            rotate_back(pose[i, 3:7], load[0:3], loads[i, s, 0:3])
            rotate_back(pose[i, 3:7], load[3:6], loads[i, s, 3:6])
            if s < m:
                copied(goal, pose[i])
                copied(rate, twist[i])
                copied(now, target[i])
                copied(speed, velocity[i])


class UpperDrives(SliderDrives):
    """The driven upper platforms of `n` runs.

    Attributes:
        payload: (13,) load on the sensor
            (:func:`hiltestbed.platform.facilities.motion.load_of`).
        residual: (n, m, 6) residual of the payload in the reading, at the m instants of the tick,
            in P at P's origin [N, N m].
        left: (n, 2) its largest force [N] and torque [N m] so far.
    """

    def __init__(
        self, mechanism: Mechanism, tick: float, substeps: int, n: int, nthread: int
    ) -> None:
        """``mechanism``: carries its passive side. ``tick`` [s] of the loop, in ``substeps``."""
        m = upper_model(mechanism, tick / substeps)
        settings = Pss33.model_validate({"kind": "pss33", "bandwidth": BANDWIDTH})
        runs = Runs(tick, substeps, [settings] * n, np.ones(n, dtype=bool))
        super().__init__(m, upper_kinematics(m), runs, MOVED_PER_DRIVE)
        self.batch, self.upper = Batch(m, n, nthread), Upper.load()
        self.payload = carried_load(m, m.qpos0)
        bind, steps = self.batch.bind, substeps
        self._qpos, self._qvel, self._ctrl = bind("qpos"), bind("qvel"), bind("ctrl")
        self._warmstart, self._reading = bind("qacc_warmstart"), bind("sensordata")
        self._port = np.zeros((n, 7)), np.zeros((n, 6)), np.zeros((n, steps + 1, 6))
        self.plan = self.plan._replace(steps=np.zeros((n, steps + 1, 3, 3)))
        self.residual, self.left = np.zeros((n, steps, 6)), np.zeros((n, 2))
        self._passed_over = np.zeros(n, dtype=bool)
        self._observe = self.observing(self._qpos, self._qvel, SPEED_LIMIT, self._passed_over)
        given = (self.moved, self.share), self.payload, self.step, self._port, self.plan
        self._planned = Call(_aim, self.upper, *given, GIVEN, GIVEN)

    def start(self, i: int, x: Array, rates: Array) -> None:
        """Put run ``i`` in a motion with ``rates`` (3,) at the coordinates ``x`` (3,)."""
        self._warmstart[i] = 0.0
        arm, before, ways, none = np.empty(3), np.empty(7), np.empty((6, 3)), np.empty(0)
        pose, twist = self._port[0][i], self._port[1][i]
        place(self.upper.shape, x, pose)
        motion(self.upper.shape, x, ways)
        self._qpos[i], self._qvel[i] = self.kinematics.motion(pose, ways @ rates, none, none)
        place(self.upper.shape, x - self.step * rates, before)
        twist_between(before, pose, self.step, twist)
        for j, limb in enumerate(self.upper.limbs):
            self.plan.reference[i, j] = at = slider(limb, pose, arm)
            self.plan.velocity[i, j] = (at - slider(limb, before, arm)) / self.step

    def run(self, away: NDArray[np.bool_], xs: Array) -> None:
        """One tick through the coordinates ``xs`` (n, m, 3) at the ends of the substeps, for the
        runs that are ``away`` (n,).
        """
        self._planned.on(away, xs)()
        self.residual[:] = 0.0
        going = np.flatnonzero(away)
        if not going.size:
            return
        m = self.residual.shape[1]
        for s in range(m + 1):
            self.push(s, self._qpos, self._qvel, self._ctrl)
            if s < m:
                self.batch.step(going)
            else:
                self.batch.forward(going)
            if s > 0:  # a step gives the reading at its start
                self._take_out(going, s - 1)

    def _take_out(self, going: NDArray[np.intp], s: int) -> None:
        """Subtract the payload from the sensor's reading: the residual is a wrench of active on
        passive side, zero while clamped.
        """
        rest = self._port[2][going, s + 1] - self._reading[going, :6]
        self.residual[going, s] = rest
        x, y, z = np.moveaxis(rest.reshape(-1, 2, 3), 2, 0)
        size = np.sqrt(x**2 + y**2 + z**2)
        self.left[going] = np.maximum(self.left[going], size)

    def look(self, away: NDArray[np.bool_], diverged: NDArray[np.bool_]) -> bool:
        """Read the motion of P in W, and the sliders, of the runs that are ``away``; returns
        whether a run has just diverged.
        """
        over = self._passed_over
        np.logical_or(diverged, ~away, out=over)
        lost = self._observe()
        if lost:
            diverged |= over & away
        return lost
