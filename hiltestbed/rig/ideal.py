"""Ideal tracking: the pose runs linearly over each tick to the commanded one.

The active mechanism is a free body whose position and velocity are written before every evaluation of the contact; nothing is
integrated. Evaluated are the sub-instants of the tick that ends, so that the last one is the force at t_(k+1) with the slope of
that tick.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from mujoco.batch import Batch
from numba import njit
from numpy.typing import NDArray

from hiltestbed.frames import Array, pose_step, rotate_back, twist_between
from hiltestbed.rig import contact, model
from hiltestbed.rig.batch_wrench import read_wrench
from hiltestbed.rig.kinematics import Platform, inverse
from hiltestbed.rig.surfaces import tip_against_plane

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario


@njit(cache=True)
def _slope(pose_before, pose_now, h, twist):
    for i in range(pose_now.shape[0]):
        twist_between(pose_before[i], pose_now[i], h, twist[i])


@njit(cache=True)
def _back(pose, twist, h, out):
    for i in range(pose.shape[0]):
        pose_step(pose[i], twist[i], -h, out[i])


@njit(cache=True)
def _between(pose_before, pose_now, twist, time, last, pose, qpos, qvel):
    """Where A is ``time`` [s] after ``pose_before``: into ``pose``, and into MuJoCo's free joint (w-first, angular in body)."""
    for i in range(pose_now.shape[0]):
        if last:
            pose[i] = pose_now[i]
        else:
            pose_step(pose_before[i], twist[i], time, pose[i])
        qpos[i, 0:3] = pose[i, 0:3]
        qpos[i, 3] = pose[i, 6]
        qpos[i, 4:7] = pose[i, 3:6]
        qvel[i, 0:3] = twist[i, 0:3]
        rotate_back(pose[i, 3:7], twist[i, 3:6], qvel[i, 3:6])


class IdealTracking:
    """The mechanisms of `n` runs under ideal tracking; arrays as in :class:`hiltestbed.rig.plant.Plant`."""

    def __init__(self, scenarios: Sequence[Scenario], nthread: int) -> None:
        first, n = scenarios[0], len(scenarios)
        self.tick, self.substeps = first.tick, first.substeps
        self.model = model.ideal_model(first.mechanism.kind, first.mechanism.contact.friction > 0)
        self.batch = Batch(self.model, n, nthread)
        # Nothing yields, so there is no static deflection to allow for: the impedance is taken out of the stiffness.
        self.contact = contact.PairContact(self.batch, scenarios, scale=1.0 - model.IMPEDANCE)
        self.platform = Platform.load()
        self._qpos, self._qvel = self.batch.bind("qpos"), self.batch.bind("qvel")
        self._reading, self._ncon = self.batch.bind("sensordata"), self.batch.bind("ncon")
        self._warmstart = self.batch.bind("qacc_warmstart")
        self._tare = np.zeros((n, 6))  # there is no gravity
        self._before, self._between = np.zeros((n, 7)), np.zeros((n, 7))
        self._depth, self._rate = np.zeros(n), np.zeros(n)
        self.pose_act, self.twist_act = np.zeros((n, 7)), np.zeros((n, 6))
        self.wrench_sub = np.zeros((n, self.substeps, 6))
        self.contact_now = np.zeros(n, dtype=bool)
        self.slider_act = np.zeros((n, 6))
        self.slider_cmd = np.zeros((n, 6))
        self.diverged = np.zeros(n, dtype=bool)  # nothing is integrated here: a command that is lost is the loop's to end
        self.causes = [""] * n

    def reset(self, pose: Array, twist: Array) -> None:
        """Start at ``pose`` (n, 7) with the uniform ``twist`` (n, 6) that brought it there."""
        self.pose_act[:], self.twist_act[:] = pose, twist
        _back(self.pose_act, self.twist_act, self.tick, self._before)
        self._evaluate()

    def bare_steps(self, count: int) -> None:
        """``count`` evaluations of the contact where it is."""
        for _ in range(count):
            self.batch.forward()

    def advance(self, pose_cmd: Array, twist_cmd: Array, accel_cmd: Array) -> None:
        """Move to ``pose_cmd`` (n, 7) over one tick; its derivatives are not needed here."""
        self._before[:] = self.pose_act
        self.pose_act[:] = pose_cmd
        _slope(self._before, self.pose_act, self.tick, self.twist_act)
        self._evaluate()

    def _evaluate(self) -> None:
        m = self.substeps
        for s in range(1, m + 1):
            _between(self._before, self.pose_act, self.twist_act, self.tick * s / m, s == m, self._between, self._qpos, self._qvel)
            if self.contact.law is not None:
                tip_against_plane(self._between, self.twist_act, self._depth, self._rate)
                self.contact.update(self._depth, self._rate)
            self.batch.forward()
            read_wrench(self._reading, self._tare, self.wrench_sub, s - 1)
        np.greater(self._ncon, 0, out=self.contact_now)
        inverse(self.platform.limbs, self.pose_act, self.slider_act)
        self.slider_cmd[:] = self.slider_act

    def buffers(self) -> dict[str, NDArray[Any]]:
        """The state between two ticks."""
        return {
            "pose_act": self.pose_act,
            "twist_act": self.twist_act,
            "wrench_sub": self.wrench_sub,
            "contact": self.contact_now,
            "slider_act": self.slider_act,
            "slider_cmd": self.slider_cmd,
            "warmstart": self._warmstart,
        }
