"""Servo tracking: the whole rig in MuJoCo, with its platform driven to the commanded pose or with
freely moving bodies.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call, together
from hiltestbed.contact.composition import Structure
from hiltestbed.contact.contacts import Contacts
from hiltestbed.frames import Array
from hiltestbed.platform.facilities.rig import FacilityRig
from hiltestbed.platform.model import sensor_columns
from hiltestbed.platform.response import PlatformResponse
from hiltestbed.sensor.readout import read_history, read_wrench

if TYPE_CHECKING:
    from hiltestbed.contact.contacts import AppliedForce
    from hiltestbed.scenario.like import ScenarioLike as Scenario

SPEED_LIMIT = 1e3  # [m/s], [rad/s] a joint faster than this has diverged
# [kg] half the effective mass at a point of the platform: its viscous friction cannot reverse a
# speed in one step
YIELDING = 150.0
NONE, VEL, ACC = (
    int(stage)
    for stage in (
        mujoco.mjtStage.mjSTAGE_NONE,
        mujoco.mjtStage.mjSTAGE_VEL,
        mujoco.mjtStage.mjSTAGE_ACC,
    )
)


def least_creep(dt: float) -> float:
    """Smallest viscous creep [m/s per N] of a friction that acts on driven masses, for steps of
    ``dt`` [s].
    """
    return dt / YIELDING


class ServoTracking:
    """The rigs of `n` runs under servo tracking; arrays as in
    :class:`hiltestbed.platform.plant.Plant`.

    The force at t_(k+1) is read from a forward evaluation of the new state, without a step's delay;
    the readings at the substeps in between come from the sensor's history. A run whose force may
    come `late` skips that evaluation, a fifth of the cost of two physics
    steps per tick: its force at t_k is read in the first step of the tick that starts there.
    """

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        nthread: int,
        structure: Structure,
        late: NDArray[np.bool_] | None = None,
        force: AppliedForce | None = None,
    ) -> None:
        first, n = scenarios[0], len(scenarios)
        # else MuJoCo writes MUJOCO_LOG.TXT into the working folder
        if mujoco.get_mju_user_warning() is None:
            mujoco.set_mju_user_warning(_log_warning)
        self.substeps = m = first.substeps
        dt = first.tick / m
        self.servo = servo = FacilityRig(scenarios, structure, dt)
        self.model = servo.model
        self.batch = Batch(self.model, n, nthread, persistent=True)
        self.contacts = Contacts(self.batch, scenarios, structure, dt, least_creep(dt), force)
        self.path = PlatformResponse(scenarios)
        self._ticks = np.zeros(1, dtype=np.int64)
        self._goal = np.zeros((n, 7))
        servo.start(self.batch, scenarios, dt)
        self._stepwise = self.contacts.written or not servo.keeps_history
        # state and contacts are read after every step
        self._watched = self.contacts.written or servo.moves_passive
        bind = self.batch.bind
        self._qpos, self._qvel, self._ctrl, self._time = (
            bind("qpos"),
            bind("qvel"),
            bind("ctrl"),
            bind("time"),
        )
        self._warmstart, self._history = bind("qacc_warmstart"), bind("history")
        self._sensordata = bind("sensordata")
        columns = sensor_columns(self.model)
        self._reading = self._sensordata[:, columns]
        self._tare, self._all = np.zeros((n, 6)), np.arange(n)
        self.pose_act, self.twist_act, self.slider_act = servo.shown()
        self.wrench_sub = np.zeros((n, m, 6))
        self.contact_now = self.contacts.touching
        self.slider_cmd = servo.target
        self.diverged = np.zeros(n, dtype=bool)
        self.causes = [""] * n
        self._late = np.zeros(n, dtype=bool) if late is None else late
        self._going: NDArray[np.intp] | None = None  # the runs that are stepped; None: all
        self._lost = False  # whether a run has just diverged
        self._read_between, self._read_late = (
            Call(read_wrench, self._reading, self._tare, GIVEN, self.wrench_sub, ...)
            for _ in range(2)
        )
        self._read_history = Call(read_history, self._history, self._tare, self.wrench_sub)
        self._tare[:] = servo.tare(self.contacts, self._reading, columns)
        self._read_state, self._read_and_meet, self._read_and_look = self._readers()

    def reset(self, pose: Array, twist: Array) -> None:
        """Start at ``pose`` (n, 7), moving with ``twist`` (n, 6); forces start from zero."""
        self.batch.reset(stage=NONE)
        self.diverged[:] = False
        self._going = None
        self._group()
        self.servo.settle(pose, twist, self._qpos, self._qvel)
        self._ticks[0] = 0
        self.contacts.reset()
        self._read_state()
        if self.contacts.written:
            self._look_ahead()
            self._read_and_meet()
        self.batch.forward()
        self.wrench_sub[:] = 0.0
        self._read(self._all, self.substeps - 1)
        self._observe()

    def begin(self, pose_cmd: Array, twist_cmd: Array, accel_cmd: Array) -> None:
        """Start the tick towards ``pose_cmd`` (n, 7), with ``twist_cmd`` and ``accel_cmd`` (n, 6):
        its first step.
        """
        goal = pose_cmd
        if self.path.active:
            goal = self._goal
            goal[:] = pose_cmd
            goal[:, :3] = self.path.advance(int(self._ticks[0]), pose_cmd)[:, -1]
            self._ticks[0] += 1
        self.servo.aim(goal, twist_cmd, accel_cmd)
        self._step(0)
        if self._latecomers.size:
            self._read(self._latecomers, self.substeps - 1)

    def finish(self) -> None:
        """The rest of the tick."""
        if self._stepwise:
            self._run_stepwise()
        else:
            self._run()
        self.servo.arrive()
        self._observe()

    def bare_steps(self, count: int) -> None:
        """``count`` steps with unchanged inputs."""
        for _ in range(count):
            self.batch.step()

    def _step(self, sub: int) -> None:
        self.servo.push(sub, self._qpos, self._qvel, self._ctrl)
        if self._stepwise or sub < self.substeps - 1:
            self.batch.step(self._going, stage=self.contacts.stage)
            return
        for ids, stage in self._groups:
            self.batch.step(ids, stage=stage)

    def _run(self) -> None:
        for s in range(1, self.substeps):
            self._step(s)
        self._read_history.on()()
        if self._prompt.size:
            self._read(self._prompt, self.substeps - 1)

    def _run_stepwise(self) -> None:
        """The remaining steps; each gives the reading at its start, and a separate forward
        evaluation gives that of the last instant.
        """
        watched = self._watched
        if watched:
            self._lost |= self._read_and_meet()
        for s in range(1, self.substeps):
            self._step(s)
            self._read(self._all, s - 1)
            if watched:
                self._lost |= self._read_and_meet()
        if self._prompt.size:
            self.batch.forward(self._groups[0][0])
            self._read(self._prompt, self.substeps - 1)

    def _read(self, runs: NDArray[np.intp], sub: int) -> None:
        """Read the wrench of the last evaluation of the physics into substep ``sub``."""
        if self.servo.load is not None:
            self.servo.load.read(
                self._sensordata, self.servo.mover.place_P, runs, self.wrench_sub, sub
            )
        else:
            (self._read_late if sub == self.substeps - 1 else self._read_between).on(runs)(sub)

    def _readers(self) -> tuple[Callable[[], bool], Callable[[], bool], Callable[[], bool]]:
        """Three calls that read pose, twist and joints; the second also evaluates the contact, the
        third also reads MuJoCo's own contacts.

        Each returns whether a run has just diverged.
        """
        shown = self.pose_act, self.twist_act, self.slider_act
        seen = self.servo.observing(self._qpos, self._qvel, SPEED_LIMIT, shown, self.diverged)
        if seen is None:
            return (
                self._read_state_stepwise,
                self._read_and_meet_stepwise,
                self._read_and_look_stepwise,
            )
        met = self.contacts.meeting(*self._sides) if self.contacts.written else []
        meet = (
            together(seen, *met, telling=0)
            if met
            else self._read_and_meet_stepwise
            if self.contacts.written
            else seen
        )
        return seen, meet, together(seen, *self.contacts.looking, telling=0)

    @property
    def _sides(self) -> tuple[Array, ...]:
        """Pose and twist of A in W, and those of P if it moves."""
        mover = self.servo.mover
        if self.servo.moves_passive:
            return mover.place_A, mover.motion_A, mover.place_P, mover.motion_P
        return self.pose_act, self.twist_act

    def _read_state_stepwise(self) -> bool:
        return self.servo.observe(
            self._qpos,
            self._qvel,
            SPEED_LIMIT,
            self.pose_act,
            self.twist_act,
            self.slider_act,
            self.diverged,
        )

    def _read_and_meet_stepwise(self) -> bool:
        lost = self._read_state()
        if self.contacts.written:
            self.contacts.meet(*self._sides)
        return lost

    def _read_and_look_stepwise(self) -> bool:
        lost = self._read_state()
        self.contacts.look()
        return lost

    def _look_ahead(self) -> None:
        """Evaluate MuJoCo up to the stage that the contacts need."""
        if self.contacts.stage != NONE:
            self.batch.forward(self._going, stage=self.contacts.stage)

    def _observe(self) -> None:
        if self._watched:
            lost = self._lost
            self.contacts.look()
        else:
            lost = self._read_and_look()
        if lost:
            self._lost = False
            self._leave_out()
        if self._going is not None:
            self.wrench_sub[self.diverged] = 0.0

    def _leave_out(self) -> None:
        """Record the cause of divergence of the runs that have just diverged, and step only the
        others from now on.
        """
        for i in np.flatnonzero(self.diverged):
            if not self.causes[i]:
                self.causes[i] = _cause(self.model, self._qpos[i], self._qvel[i])
        self._going = np.flatnonzero(~self.diverged)
        self._group()

    def _group(self) -> None:
        """Divide the runs that are stepped into those whose force is needed at once and late ones,
        each with its stage.
        """
        going = ~self.diverged
        self._prompt, self._latecomers = (
            np.flatnonzero(going & ~self._late),
            np.flatnonzero(going & self._late),
        )
        parts = [
            (ids, stage)
            for ids, stage in ((self._prompt, ACC), (self._latecomers, VEL))
            if ids.size
        ]
        self._groups: list[tuple[NDArray[np.intp] | None, int]] = [
            (None if len(ids) == len(going) else ids, stage) for ids, stage in parts
        ]


def _log_warning(message: str) -> None:
    """Log a warning of MuJoCo as debug output: :class:`ServoTracking` detects and reports
    divergence itself.
    """
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
    return (
        f"{joint.name} moves at {qvel[dof]:.3g} {'rad/s' if turns else 'm/s'} (limit "
        f"{SPEED_LIMIT:g})"
    )
