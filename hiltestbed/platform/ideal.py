"""Ideal tracking: over each tick the pose moves linearly to the commanded one.

The active mechanism is a free body whose position and velocity are written before every evaluation
of the contact; the platform's motion is not integrated. The contact is evaluated at the substeps of
the tick that ends, so that the last one gives the force at t_(k+1) with the slope of that tick.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np
from mujoco.batch import Batch

from hiltestbed.compiled.bound import bound
from hiltestbed.compiled.jit import interpreted, njit
from hiltestbed.contact.contacts import Contacts
from hiltestbed.frames import Array, pose_step, rotate_back, twist_between
from hiltestbed.platform.facilities.composed import (
    INTEGRATED_MASS,
    TOOL,
    facility_model,
    ideal_model,
    sensor_columns,
)
from hiltestbed.platform.facilities.drives import Drives
from hiltestbed.platform.facilities.response import ResponsePath
from hiltestbed.platform.parameters import RigParameters
from hiltestbed.platform.response import PlatformResponse

if TYPE_CHECKING:
    from hiltestbed.contact.contacts import AppliedForce


@njit(cache=True)
def _slope(pose_before, pose_now, h, twist):
    for i in range(pose_now.shape[0]):
        twist_between(pose_before[i], pose_now[i], h, twist[i])


@njit(cache=True)
def _put(body, s, time, last, bent):
    """Write the pose of A ``time`` [s] after ``before``, at the end of substep ``s``, to ``pose``
    and MuJoCo's free joint (w-first, angular velocity in the body).

    If the platform deviates from the straight line (``bent``), its position is that in ``along``.

    body: its pose (n, 7) at both ends of the tick, its twist (n, 6), positions within it (n, m, 3);
    the pose written last (n, 7); positions and rates of all joints, and the addresses (2,) of the
    free one.
    """
    before, now, twist, along, pose, qpos, qvel, joint = body
    q, d = joint[0], joint[1]
    for i in range(pose.shape[0]):
        if last:
            for j in range(7):
                pose[i, j] = now[i, j]
        else:
            pose_step(before[i], twist[i], time, pose[i])
        for j in range(3):
            if bent:
                pose[i, j] = along[i, s - 1, j]
            qpos[i, q + j] = pose[i, j]
            qpos[i, q + 4 + j] = pose[i, 3 + j]
            qvel[i, d + j] = twist[i, j]
        qpos[i, q + 3] = pose[i, 6]
        rotate_back(pose[i, 3:7], twist[i, 3:6], qvel[i, d + 3 : d + 6])


@njit(cache=True)
def _change(pose, twist, qvel, at, per_step, push):
    """Force and torque (in the body's axes) that give the free joint its ``twist`` in one step."""
    turn = np.empty(3)
    for i in range(pose.shape[0]):
        rotate_back(pose[i, 3:7], twist[i, 3:6], turn)
        for j in range(3):
            push[i, j] = per_step * (twist[i, j] - qvel[i, at + j])
            push[i, 3 + j] = per_step * (turn[j] - qvel[i, at + 3 + j])


NONE = int(mujoco.mjtStage.mjSTAGE_NONE)


class IdealTracking:
    """The mechanisms of `n` runs; arrays as in :class:`hiltestbed.platform.plant.Plant`."""

    def __init__(
        self,
        parameters: RigParameters,
        nthread: int,
        force: AppliedForce | None = None,
    ) -> None:
        runs, structure, n = parameters.runs, parameters.structure, len(parameters.start)
        self.tick, self.substeps, dt = runs.tick, runs.substeps, runs.step
        self.model = ideal_model(structure, dt)
        self.batch = Batch(self.model, n, nthread)
        self.contacts = Contacts(self.batch, parameters.mechanism, structure, dt, 0.0, force)
        self.path = PlatformResponse(
            parameters.responses, parameters.start, self.substeps, parameters.departs
        )
        answers = runs.settings[0].tracking == "response"
        settings = [s.response for s in runs.settings] if answers else []
        self.response = ResponsePath(settings, self.tick, self.substeps) if answers else None
        # whether positions within a tick are taken from _along
        self._bent = self.path.active or answers
        self._along = self.path.path if self.path.active else np.zeros((n, self.substeps, 3))
        self._ticks = np.zeros(1, dtype=np.int64)
        facility = parameters.facility
        self.units = tuple(axis.unit for axis in facility.axes)
        stepped = facility_model(facility, structure, dt)
        joints = facility.drives(stepped, runs, TOOL)
        assert isinstance(joints, Drives)
        self._joints = joints
        bind = self.batch.bind
        self._qpos, self._qvel, self._warmstart = bind("qpos"), bind("qvel"), bind("qacc_warmstart")
        self._reading = bind("sensordata")[:, sensor_columns(self.model)]
        free = self.model.joint("A_joint")
        self._joint = np.array([free.qposadr[0], free.dofadr[0]])
        self._push = (
            bind("qfrc_applied")[:, int(free.dofadr[0]) : int(free.dofadr[0]) + 6]
            if structure.sides.moving
            else None
        )
        self._integrated = self.contacts.mount.moves or structure.sides.moving
        self._goal = np.zeros((n, 7))
        # poses (m, n, 7), twists (m, n, 6) of a tick, if given
        self._way: tuple[Array, Array] | None = None
        self._before, self._between = np.zeros((n, 7)), np.zeros((n, 7))
        self.pose_act, self.twist_act = np.zeros((n, 7)), np.zeros((n, 6))
        body = (
            self._before,
            self.pose_act,
            self.twist_act,
            self._along,
            self._between,
            self._qpos,
            self._qvel,
            self._joint,
        )
        self._put = bound(_put, body, ..., ..., ..., ...)
        self.wrench_sub = np.zeros((n, self.substeps, 6))
        self.contact_now = self.contacts.touching
        self.slider_act, self.slider_cmd = self._joints.joints, self._joints.reference
        # the platform cannot diverge; the loop ends a run whose command is lost
        self.diverged = np.zeros(n, dtype=bool)
        self.causes = [""] * n

    def reset(self, pose: Array, twist: Array) -> None:
        """Start at ``pose`` (n, 7) after a uniform motion with ``twist`` (n, 6)."""
        self.batch.reset(stage=0)
        self._ticks[0], self._way = 0, None
        self.pose_act[:], self.twist_act[:] = pose, twist
        for before, at, rate in zip(self._before, pose, twist, strict=True):
            interpreted(pose_step)(at, rate, -self.tick, before)
        self.contacts.reset()
        self._along[:, :] = self.pose_act[:, None, :3]
        if self.response is not None:
            self.response.begin(pose, twist)
        self.wrench_sub[:] = 0.0
        self._place(self.substeps)
        self.batch.forward()
        self._read(-1)
        self._conclude()

    def begin(self, pose_cmd: Array, twist_cmd: Array, accel_cmd: Array) -> None:
        """Start the tick towards ``pose_cmd`` (n, 7); its derivatives are not used."""
        self._goal[:] = pose_cmd

    def carry(self, poses: Array, twists: Array) -> None:
        """See :meth:`hiltestbed.platform.plant.Plant.carry`."""
        self._way = poses, twists
        self._move()

    def finish(self) -> None:
        """Move over the tick."""
        self._before[:] = self.pose_act
        self.pose_act[:] = self._goal
        if self.response is not None:
            track = self.response.advance(self._goal)
            self.pose_act[:] = track[:, -1]
            if not self.path.active:
                self._along[:] = track[:, :, :3]
        if self.path.active:
            self.path.advance(int(self._ticks[0]), self.pose_act)
            self.pose_act[:, :3] = self.path.path[:, -1]
        self._ticks[0] += 1
        _slope(self._before, self.pose_act, self.tick, self.twist_act)
        self._move()

    def _move(self) -> None:
        if self._integrated:
            self._run()
        else:
            self._evaluate()
        self._conclude()

    def bare_steps(self, count: int) -> None:
        """``count`` evaluations of the contact at the current pose."""
        for _ in range(count):
            self.batch.forward()

    def _evaluate(self) -> None:
        for s in range(1, self.substeps + 1):
            self._place(s)
            self.batch.forward()
            self._read(s - 1)

    def _run(self) -> None:
        """Integrate mount and moving parts: a step gives the wrench at its start."""
        for s in range(1, self.substeps + 1):
            # None: A keeps its velocity
            push = self._push if s == 1 or self._way is not None else None
            if push is not None:
                self._accelerate(s, push)
            self.batch.step()
            if push is not None:
                push[:] = 0.0
            if s > 1:
                self._read(s - 2)
            self._place(s)
        self.batch.forward()
        self._read(-1)

    def _read(self, s: int) -> None:
        """The wrench at substep ``s``; there is no gravity."""
        self.wrench_sub[:, s] = 0.0 - self._reading

    def _accelerate(self, s: int, push: Array) -> None:
        """Accelerate A in step ``s`` by ``push`` (n, 6), so that its moving parts react to it."""
        per_step = INTEGRATED_MASS * self.substeps / self.tick
        twist = self.twist_act if self._way is None else self._way[1][s - 1]
        _change(self._between, twist, self._qvel, self._joint[1], per_step, push)

    def _place(self, s: int) -> None:
        """Place A at the end of substep ``s`` of m, and apply the contact wrench of that state."""
        m = self.substeps
        if self._way is not None:
            self.pose_act[:], self.twist_act[:] = self._way[0][s - 1], self._way[1][s - 1]
            self._put(s, 0.0, True, False)
        else:
            self._put(s, self.tick * s / m, s == m, self._bent)
        if self.contacts.stage != NONE:
            self.batch.forward(stage=self.contacts.stage)
        if self.contacts.written:
            self.contacts.meet(self._between, self.twist_act)

    def _conclude(self) -> None:
        self.contacts.look()
        self._joints.follow(self.pose_act, self.twist_act)
