"""The numerical model: chaser and target as free-flyers, driven by the compensated wrench.

A tick is a semi-implicit Euler step: each body's twist first, then its pose with the new twist. What the model may have wrong (masses,
inertias, ports, appendages, forces, the integrator, late steps) are numbers beside what is believed; with none of them the step is the
nominal one.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from hiltestbed.frames import Array, pose_step
from hiltestbed.numerical_model.bodies import approach_state, inertia_matrix, port_pose
from hiltestbed.numerical_model.free_flyers import FreeFlyers
from hiltestbed.numerical_model.kernels import load_wrench, move, place_at_start, relative_states
from hiltestbed.numerical_model.parameters import DAMPING, RATIO, STIFFNESS, Departures, DynamicsParameters, stack
from hiltestbed.numerical_model.resistance import resist_between, resist_bodies

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario


class NumericalModel:
    """Two free-flyers a run, for ``n`` runs, and the relative motion of their ports.

    Attributes:
        mass: ``(n, 2)``, inertia: ``(n, 2, 3, 3)``, port: ``(n, 2, 7)`` as believed: a compensation that keeps a copy builds it from them.
        q: ``(n, 2, 7)`` pose of the chaser's and the target's centre of mass in the inertial frame.
        v: ``(n, 2, 6)`` linear velocity in the inertial frame, angular velocity in the body frame.
        pose: ``(n, 7)`` pose of A in P that is handed on. twist: ``(n, 6)`` velocity of A relative to P, in P.
    """

    def __init__(self, scenarios: Sequence[Scenario], departures: Departures | None = None) -> None:
        """``departures``: of the model that runs from the one believed; by default the effects of the scenarios."""
        n = len(scenarios)
        self.n = n
        self.tick = 1.0 / scenarios[0].rate
        bodies = [(s.spacecraft.chaser, s.spacecraft.target) for s in scenarios]
        self.mass = np.array([[b.mass for b in pair] for pair in bodies])
        self.inertia = np.array([[inertia_matrix(b.inertia) for b in pair] for pair in bodies])
        self.port = np.array([[port_pose(b) for b in pair] for pair in bodies])
        self.q, self.v = np.zeros((n, 2, 7)), np.zeros((n, 2, 6))
        self.pose, self.twist = np.zeros((n, 7)), np.zeros((n, 6))
        self._tau, self._before = np.zeros((n, 2, 6)), np.zeros((n, 2, 6))
        self._approach = np.array([approach_state(s) for s in scenarios])
        self._depart(stack([DynamicsParameters.of(s.effects) for s in scenarios]) if departures is None else departures)
        self.reset()

    def _depart(self, d: Departures) -> None:
        """Take the departures of the model that runs into its numbers."""
        self._port = self.port.copy()
        self._port[..., :3] += d.port
        self._appendage = d.appendage
        self._whole = self.mass * d.mass
        self._rigid = self._whole * (1.0 - d.appendage[..., RATIO].sum(axis=-1))
        self._inertia = self.inertia * d.inertia[..., None, None]
        self._swing = np.zeros((*d.appendage.shape[:3], 2, 3))
        self._force = d.force
        self._resisted = np.zeros((self.n, 6)) if d.force.size else None
        self._inverse = np.linalg.inv(self._inertia)
        self._swings = bool(d.appendage[..., RATIO].any())
        self._explicit = d.explicit if d.explicit.any() else None
        self._late = d.late if d.late.any() else None
        self._handed = np.zeros((self.n, int(d.late.max()) + 1, 13))
        self._clock = np.zeros(1, dtype=np.int64)

    @cached_property
    def flyers(self) -> FreeFlyers:
        """The bodies in Pinocchio, made when they first accelerate."""
        return FreeFlyers(self._rigid, self._inertia)

    def reset(self) -> None:
        """Target at rest with P at the inertial origin; chaser where and as fast as ``approach`` says."""
        place_at_start(self._approach, self._port, self.q, self.v)
        relative_states(self.q, self.v, self._port, self.pose, self.twist)
        if self._late is not None:
            run_back(self.pose, self.twist, self.tick, self._handed)

    def advance(self, wrench: Array) -> None:
        """One step under ``wrench`` ``(n, 6)``, active on passive, in P at P's origin: twists, then poses."""
        if self._resisted is not None:
            self._resisted[:] = wrench
            wrench = self._resisted
            resist_between(self._force, self.q, self.v, self._port, self._rigid, self._inverse, self.tick, wrench)
        load_wrench(self.q, self._port, wrench, self._tau)
        if self._resisted is not None:
            resist_bodies(self._force, self.v, self._rigid, self.tick, self._tau)
        if self._swings:
            swing(self._appendage, self._whole, self._rigid, self.tick, self._swing, self._tau)
        if self._explicit is not None:
            self._before[:] = self.v
        self.flyers.accelerate(self.q, self.v, self._tau, self.tick)
        moving = self.v if self._explicit is None else np.where(self._explicit[:, None, None], self._before, self.v)
        move(self.q, moving, self.tick)
        relative_states(self.q, self.v, self._port, self.pose, self.twist)
        if self._late is not None:
            self._clock[0] += 1
            hand_on(int(self._clock[0]), self._late, self._handed, self.pose, self.twist)


@njit(cache=True)
def run_back(pose, twist, h, handed):
    """Before the start the approach was uniform: tick -j at slot -j modulo the length."""
    length = handed.shape[1]
    for i in range(pose.shape[0]):
        for j in range(length):
            pose_step(pose[i], twist[i], -j * h, handed[i, -j % length, 0:7])
            handed[i, -j % length, 7:13] = twist[i]


@njit(cache=True)
def hand_on(k, late, handed, pose, twist):
    """Keep pose (n, 7) and twist (n, 6) of tick ``k`` in ``handed`` (n, L, 13); put those of ``late`` (n,) ticks before in their place."""
    length = handed.shape[1]
    for i in range(pose.shape[0]):
        handed[i, k % length, 0:7] = pose[i]
        handed[i, k % length, 7:13] = twist[i]
        pose[i] = handed[i, (k - late[i]) % length, 0:7]
        twist[i] = handed[i, (k - late[i]) % length, 7:13]


@njit(cache=True)
def swing(appendage, whole, rigid, h, swing, tau):
    """Add what the appendages do to their bodies to ``tau`` (n, 2, 6), and advance them: velocity first, then displacement.

    swing: (n, 2, S, 2, 3) displacement [m] and velocity [m/s] of each appendage relative to its body, in inertial axes.
    """
    acceleration = np.empty(3)
    for i in range(tau.shape[0]):
        for b in range(2):
            for s in range(appendage.shape[2]):
                a = appendage[i, b, s]
                for j in range(3):
                    tau[i, b, j] += a[RATIO] * whole[i, b] * (a[STIFFNESS] * swing[i, b, s, 0, j] + a[DAMPING] * swing[i, b, s, 1, j])
            for j in range(3):
                acceleration[j] = tau[i, b, j] / rigid[i, b]
            for s in range(appendage.shape[2]):
                a = appendage[i, b, s]
                if a[RATIO] > 0.0:
                    for j in range(3):
                        q = swing[i, b, s]
                        q[1, j] -= h * (a[STIFFNESS] * q[0, j] + a[DAMPING] * q[1, j] + acceleration[j])
                        q[0, j] += h * q[1, j]
