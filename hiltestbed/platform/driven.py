"""Servo tracking: the whole rig in MuJoCo, with its platform driven to the commanded pose or with
freely moving bodies.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call, bound
from hiltestbed.compiled.jit import njit
from hiltestbed.contact.contacts import Contacts
from hiltestbed.frames import Array
from hiltestbed.platform.facilities.composed import (
    TOOL,
    carried_reading,
    facility_model,
    rest_reading,
    sensor_columns,
)
from hiltestbed.platform.facilities.limits import Watch
from hiltestbed.platform.parameters import RigParameters
from hiltestbed.platform.response import PlatformResponse

if TYPE_CHECKING:
    from hiltestbed.contact.contacts import AppliedForce

SPEED_LIMIT = 1e3  # [m/s], [rad/s] a joint faster than this has diverged
# [kg] half the effective mass at a point of the platform: its viscous friction cannot reverse a
# speed in one step
YIELDING = 150.0
_S = mujoco.mjtStage
NONE, VEL, ACC = int(_S.mjSTAGE_NONE), int(_S.mjSTAGE_VEL), int(_S.mjSTAGE_ACC)


def least_creep(dt: float) -> float:
    """Smallest viscous creep [m/s per N] of friction on driven masses, in steps of ``dt`` [s]."""
    return dt / YIELDING


class ServoTracking:
    """The rigs of `n` runs under servo tracking; arrays as in
    :class:`hiltestbed.platform.plant.Plant`.

    The force at t_(k+1) is read from a forward evaluation of the new state, without a step's delay;
    the readings at the substeps in between come from the sensor's history. A run whose force may
    come `late` skips that evaluation, a fifth of the cost of two physics steps per tick: its force
    at t_k is read in the first step of the tick that starts there.
    """

    def __init__(
        self,
        parameters: RigParameters,
        nthread: int,
        late: NDArray[np.bool_] | None = None,
        force: AppliedForce | None = None,
    ) -> None:
        runs, structure, n = parameters.runs, parameters.structure, len(parameters.start)
        # else MuJoCo writes MUJOCO_LOG.TXT into the working folder
        if mujoco.get_mju_user_warning() is None:
            mujoco.set_mju_user_warning(_log_warning)
        self.substeps, dt, facility = runs.substeps, runs.step, parameters.facility
        m = self.substeps
        self.moves_passive = facility.moves_passive
        # a sensor that moves needs its load's compensation in each reading: none is kept in
        # MuJoCo's history
        self.model = facility_model(facility, structure, dt, 0 if self.moves_passive else m)
        self.units = tuple(axis.unit for axis in facility.axes)
        self.batch = Batch(self.model, n, nthread, persistent=True)
        self.contacts = Contacts(
            self.batch, parameters.mechanism, structure, dt, least_creep(dt), force
        )
        self.path = PlatformResponse(parameters.responses, parameters.start, m, parameters.departs)
        self._ticks = np.zeros(1, dtype=np.int64)
        self._goal = np.zeros((n, 7))
        self.mover = mover = facility.drives(self.model, runs, TOOL)
        self.watch: Watch | None = None
        if (watched := parameters.watched) is not None:
            self.watch = Watch(facility.axes, mover.kinematics.joints_home, n, runs.tick, watched)
        # state and contacts are read after every step
        self._stepwise = self.contacts.written or self.moves_passive
        bind = self.batch.bind
        self._qpos, self._qvel, self._time = bind("qpos"), bind("qvel"), bind("time")
        self._inputs, self._forces = bind(mover.writes), bind("qfrc_actuator")
        self._warmstart, self._history = bind("qacc_warmstart"), bind("history")
        sensordata = bind("sensordata")
        self._tare, self._all = self._rest_readings(), np.arange(n)
        self.pose_act, self.twist_act, self.slider_act = mover.pose, mover.twist, mover.joints
        self.slider_cmd = mover.reference
        self.wrench_sub = np.zeros((n, m, 6))
        self.contact_now = self.contacts.touching
        self.diverged = np.zeros(n, dtype=bool)
        self.causes = [""] * n
        self._late = np.zeros(n, dtype=bool) if late is None else late
        self._going: NDArray[np.intp] | None = None  # the runs that are stepped; None: all
        self._lost = False  # whether a run has just diverged
        self._seen = mover.observing(self._qpos, self._qvel, SPEED_LIMIT, self.diverged)
        self._read_now = (
            carried_reading(
                self.model,
                mover.kinematics.home,
                sensordata,
                mover.place_P,
                self.wrench_sub,
            )
            if self.moves_passive
            else Call(
                _read_now,
                sensordata[:, sensor_columns(self.model)],
                self._tare,
                GIVEN,
                self.wrench_sub,
                ...,
            )
        )
        self._read_history = bound(_read_history, self._history, self._tare, self.wrench_sub)
        # pose and twist of A in W, and those of P if it moves
        self._sides = (self.pose_act, self.twist_act)
        if self.moves_passive:
            self._sides = (mover.place_A, mover.motion_A, mover.place_P, mover.motion_P)

    def _rest_readings(self) -> Array:
        """``(n, 6)`` the sensor's reading at rest; zero if the sensor moves, whose load is then
        subtracted from every reading instead.
        """
        mount, columns = self.contacts.mount, sensor_columns(self.model)
        if self.moves_passive:
            return np.zeros((len(mount.balance), 6))
        at = self.model, self.mover.kinematics.home, columns, mount.body
        loads = zip(mount.balance, mount.centre, strict=True)
        return np.array([rest_reading(*at, balance, centre) for balance, centre in loads])

    def reset(self, pose: Array, twist: Array) -> None:
        """Start at ``pose`` (n, 7), moving with ``twist`` (n, 6); forces start from zero."""
        self.batch.reset(stage=NONE)
        self.diverged[:] = False
        self._going = None
        self._group()
        self._qpos[:] = self.mover.kinematics.home
        self.mover.settle(pose, twist, self._qpos, self._qvel)
        self._ticks[0] = 0
        self.contacts.reset()
        self._seen()
        if self.contacts.written:
            if self.contacts.stage != NONE:
                self.batch.forward(self._going, stage=self.contacts.stage)
            self._meet()
        self.batch.forward()
        self.wrench_sub[:] = 0.0
        self._read(self._all, self.substeps - 1)
        self._observe()

    def begin(self, pose_cmd: Array, twist_cmd: Array, accel_cmd: Array) -> None:
        """Start the tick towards ``pose_cmd`` (n, 7), with its derivatives: its first step."""
        goal = pose_cmd
        if self.path.active:
            goal = self._goal
            goal[:] = pose_cmd
            goal[:, :3] = self.path.advance(int(self._ticks[0]), pose_cmd)[:, -1]
            self._ticks[0] += 1
        self.mover.aim(goal, twist_cmd, accel_cmd)
        self._step(0)
        if self._latecomers.size:
            self._read(self._latecomers, self.substeps - 1)

    def finish(self) -> None:
        """The rest of the tick. Stepwise, each step gives the reading at its start, and a separate
        forward evaluation gives that of the last instant.
        """
        if self._stepwise:
            self._lost |= self._meet()
        for s in range(1, self.substeps):
            self._step(s)
            if self._stepwise:
                self._read(self._all, s - 1)
                self._lost |= self._meet()
        if not self._stepwise:
            self._read_history()
        if self._prompt.size:
            if self._stepwise:
                self.batch.forward(self._groups[0][0])
            self._read(self._prompt, self.substeps - 1)
        self.mover.arrive()
        self._observe()

    def bare_steps(self, count: int) -> None:
        """``count`` steps with unchanged inputs."""
        for _ in range(count):
            self.batch.step()

    def joint_limit(self, i: int) -> str | None:
        """The limit that run ``i`` has exceeded, in words; None if there is none."""
        return self.watch.reason(i) if self.watch is not None else None

    def joint_limit_passed(self) -> bool:
        """Whether a run has exceeded a limit of its joints at this tick."""
        d = self.mover
        return self.watch is not None and self.watch.passed(
            d.joints, d.joint_rates, self._forces, d.missed, d.kinematics.v
        )

    def _step(self, sub: int) -> None:
        self.mover.push(sub, self._qpos, self._qvel, self._inputs)
        if self._stepwise or sub < self.substeps - 1:
            self.batch.step(self._going, stage=self.contacts.stage)
            return
        for ids, stage in self._groups:
            self.batch.step(ids, stage=stage)

    def _read(self, runs: NDArray[np.intp], sub: int) -> None:
        """Read the wrench of the last evaluation of the physics into substep ``sub``."""
        self._read_now.on(runs)(sub)

    def _meet(self) -> bool:
        """Read the state and evaluate the contact; returns whether a run has just diverged."""
        lost = self._seen()
        if self.contacts.written:
            self.contacts.meet(*self._sides)
        return lost

    def _observe(self) -> None:
        lost = self._lost if self._stepwise else self._seen()
        self.contacts.look()
        if lost:
            self._lost = False
            self._leave_out()
        if self._going is not None:
            self.wrench_sub[self.diverged] = 0.0

    def _leave_out(self) -> None:
        """Record why runs have just diverged, and step only the others from now on."""
        for i in np.flatnonzero(self.diverged):
            if not self.causes[i]:
                self.causes[i] = _cause(self.model, self._qpos[i], self._qvel[i])
        self._going = np.flatnonzero(~self.diverged)
        self._group()

    def _group(self) -> None:
        """Divide the runs into those whose force is needed at once and late ones, with stages."""
        going = ~self.diverged
        self._prompt, self._latecomers = (
            self._all if which.all() else np.flatnonzero(which)
            for which in (going & ~self._late, going & self._late)
        )
        self._groups: list[tuple[NDArray[np.intp] | None, int]] = [
            (None if len(ids) == len(going) else ids, stage)
            for ids, stage in ((self._prompt, ACC), (self._latecomers, VEL))
            if ids.size
        ]


def _log_warning(message: str) -> None:
    """Log a warning of MuJoCo as debug output: divergence is detected and reported here."""
    logging.getLogger("hiltestbed.platform").debug("MuJoCo: %s", message)


def _cause(m: mujoco.MjModel, qpos: Array, qvel: Array) -> str:
    """The fastest joint of a rig that diverged, and its speed."""
    speed = np.where(np.isfinite(qvel), np.abs(qvel), np.inf)
    if np.all(speed < SPEED_LIMIT):
        return "a position of the rig is not a number"
    dof = int(np.argmax(speed))
    joint = m.joint(int(m.dof_jntid[dof]))
    kind = int(joint.type[0])
    turns = kind in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_BALL) or (
        kind == mujoco.mjtJoint.mjJNT_FREE and dof - joint.dofadr[0] > 2
    )
    unit = "rad/s" if turns else "m/s"
    return f"{joint.name} moves at {qvel[dof]:.3g} {unit} (limit {SPEED_LIMIT:g})"


@njit(cache=True)
def _read_now(reading, tare, runs, wrench_sub, sub):
    """``wrench_sub[runs, sub] = tare - reading``, both (n, 6): MuJoCo's sensors give the wrench
    that the parent exerts on the child (tests/sensor/test_force_sensor.py hangs a known weight on
    one).
    """
    for i in runs:
        for j in range(6):
            wrench_sub[i, sub, j] = tare[i, j] - reading[i, j]


@njit(cache=True)
def _read_history(history, tare, wrench_sub):
    """Fill ``wrench_sub[:, :-1]`` from the histories of the two sensors, the last m readings of
    each.

    A tick's m steps leave readings at t_k, t_k + dt, ..; the first is already in the wrench of the
    tick before. MuJoCo keeps one ring
    buffer per sensor: user value, cursor of the newest, m times, m values of 3.
    """
    m = wrench_sub.shape[1]
    size = 2 + 4 * m
    for i in range(history.shape[0]):
        for part in range(2):
            start = part * size
            newest = int(history[i, start + 1])
            for s in range(m - 1):
                slot = (newest - (m - 2 - s)) % m
                for j in range(3):
                    wrench_sub[i, s, 3 * part + j] = (
                        tare[i, 3 * part + j] - history[i, start + 2 + m + 3 * slot + j]
                    )
