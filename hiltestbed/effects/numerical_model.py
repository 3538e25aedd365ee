"""The numerical model with what it may have wrong, in the loop: the parameters and kernels of :mod:`hiltestbed.effects.dynamics`.

``mass``, ``inertia`` and ``port`` stay what the scenario believes; a compensation that keeps a copy of the model builds it from them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from hiltestbed.effects.access import effects_of
from hiltestbed.effects.dynamics import RATIO, appendage_force, dynamics_effects, swing_on
from hiltestbed.frames import Array, pose_step
from hiltestbed.scenario import Scenario
from hiltestbed.spacecraft import FreeFlyers, Spacecraft, load_wrench, move, place_at_start, relative_states


class DepartingSpacecraft(Spacecraft):
    """Two free-flyers a run that are not what they are believed to be.

    A mass, an inertia, a port that differ; a part of a mass that hangs on a spring; poses that are handed on late; the explicit
    Euler step. ``pose`` and ``twist`` are what is handed on.
    """

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        super().__init__(scenarios)
        effects = [dynamics_effects(effects_of(s)) for s in scenarios]
        self.port = self.port.copy()
        self._real_port = self.port.copy()
        self._real_port[..., :3] += np.array([e.port for e in effects])
        self._appendage = np.array([e.appendage for e in effects])
        self._whole = self.mass * np.array([e.mass for e in effects])
        self._rigid = self._whole * (1.0 - self._appendage[..., RATIO])
        self.flyers = FreeFlyers(self._rigid, self.inertia * np.array([e.inertia for e in effects])[..., None, None])
        self._explicit = np.array([e.explicit for e in effects])[:, None, None]
        self._late = np.array([e.late for e in effects])
        self._swing = np.zeros((self.n, 2, 2, 3))
        self._handed = np.zeros((self.n, int(self._late.max()) + 1, 13))
        self._clock = np.zeros(1, dtype=np.int64)
        place_at_start(self._approach, self._real_port, self.q, self.v)
        relative_states(self.q, self.v, self._real_port, self.pose, self.twist)
        _run_back(self.pose, self.twist, self.tick, self._handed)

    def advance(self, wrench: Array) -> None:
        """One step under ``wrench`` ``(n, 6)``; hands on the pose of so many ticks before."""
        load_wrench(self.q, self._real_port, wrench, self._tau)
        _swing(self._appendage, self._whole, self._rigid, self.tick, self._swing, self._tau)
        before = self.v.copy()
        self.flyers.accelerate(self.q, self.v, self._tau, self.tick)
        move(self.q, np.where(self._explicit, before, self.v), self.tick)
        relative_states(self.q, self.v, self._real_port, self.pose, self.twist)
        self._clock[0] += 1
        _hand_on(int(self._clock[0]), self._late, self._handed, self.pose, self.twist)

    def buffers(self) -> dict[str, Array]:
        return super().buffers() | {"swing": self._swing, "handed": self._handed, "clock": self._clock}


@njit(cache=True)
def _run_back(pose, twist, h, handed):
    """Before the start the approach was uniform: tick -j at slot -j modulo the length."""
    length = handed.shape[1]
    for i in range(pose.shape[0]):
        for j in range(length):
            pose_step(pose[i], twist[i], -j * h, handed[i, -j % length, 0:7])
            handed[i, -j % length, 7:13] = twist[i]


@njit(cache=True)
def _hand_on(k, late, handed, pose, twist):
    length = handed.shape[1]
    for i in range(pose.shape[0]):
        handed[i, k % length, 0:7] = pose[i]
        handed[i, k % length, 7:13] = twist[i]
        pose[i] = handed[i, (k - late[i]) % length, 0:7]
        twist[i] = handed[i, (k - late[i]) % length, 7:13]


@njit(cache=True)
def _swing(appendage, whole, rigid, h, swing, tau):
    """Add what the appendages do to their bodies to ``tau`` (n, 2, 6), and advance them."""
    pull, acceleration = np.empty(3), np.empty(3)
    for i in range(tau.shape[0]):
        for b in range(2):
            if appendage[i, b, RATIO] > 0.0:
                appendage_force(appendage[i, b, RATIO], whole[i, b], appendage[i, b], swing[i, b], pull)
                for j in range(3):
                    tau[i, b, j] += pull[j]
                    acceleration[j] = tau[i, b, j] / rigid[i, b]
                swing_on(appendage[i, b], acceleration, h, swing[i, b])
