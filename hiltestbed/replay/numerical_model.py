"""The numerical model on recorded wrenches."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hiltestbed.compiled.jit import copied, njit
from hiltestbed.frames import Array
from hiltestbed.numerical_model.bodies import inertia_matrix, port_pose
from hiltestbed.numerical_model.kernels import (
    load_wrench,
    move,
    newton_euler,
    place_at_start,
    relative_states,
)
from hiltestbed.numerical_model.model import hand_on, hang, hung_at_a_place, rests, run_back, swing
from hiltestbed.numerical_model.parameters import RATIO, Departures
from hiltestbed.numerical_model.resistance import resist_between, resist_bodies

if TYPE_CHECKING:
    from hiltestbed.scenario.spacecraft import Spacecraft


def replay_model(
    model: Departing, wrench: Array, run: np.ndarray, old: Array | None = None
) -> Array:
    """``(L, N, 7)`` pose_cmd of numerical models that are driven by recorded wrenches ``(R, N,
    6)``; row k is commanded at t_k.

    The step is that of :class:`hiltestbed.numerical_model.model.NumericalModel`, with compiled
    Newton-Euler equations where the loop calls
    Pinocchio. old: (L,) weight of the old twist in each new pose; None: that of the departures, 0
        or 1.
    """
    d, n = model.departures, len(run)
    part = np.maximum(d.explicit.astype(float), 0.0 if old is None else old)
    state = (
        np.zeros((n, 2, 7)),
        np.zeros((n, 2, 6)),
        np.zeros((n, 2, 6)),
        np.zeros((*d.appendage.shape[:3], 2, 3)),
        np.zeros((n, int(d.late.max()) + 1, 13)),
    )
    out = np.empty((n, wrench.shape[1], 7))
    inverse = np.asarray(np.linalg.inv(model.inertia), dtype=np.float64)
    bodies = model.port, model.whole, model.rigid, model.inertia, inverse
    hung, laws = (d.appendage, model.placed, model.rest), (d.force, part, d.late)
    _replay_model(
        wrench, np.asarray(run), model.approach, bodies, hung, laws, model.tick, state, out
    )
    return out


class Departing:
    """The parameters of the models of L lanes: nominal, with departures.

    Attributes:
        approach: (L, 13). port: (L, 2, 7). whole, rigid: (L, 2) mass with and without appendages.
            inertia: (L, 2, 3, 3). tick: [s].
        placed, rest: (L, 2), (L, 2, 3) see :func:`~hiltestbed.numerical_model.model.rests`; port
            and inertia are those of the bodies without appendages.
    """

    def __init__(
        self, spacecraft: Sequence[Spacecraft], approach: Array, tick: float, departures: Departures
    ) -> None:
        bodies = [(pair.chaser, pair.target) for pair in spacecraft]
        self.departures, self.tick, self.approach = departures, tick, approach
        self.port = np.array([[port_pose(b) for b in pair] for pair in bodies])
        self.port[..., :3] += departures.port
        self.whole = np.array([[b.mass for b in pair] for pair in bodies]) * departures.mass
        self.rigid = self.whole * (1.0 - departures.appendage[..., RATIO].sum(axis=-1))
        inertia = np.array([[inertia_matrix(b.inertia) for b in pair] for pair in bodies])
        self.placed = hung_at_a_place(departures.appendage)
        self.rest, self.inertia = rests(
            departures.appendage, self.whole, inertia * departures.inertia[..., None, None]
        )
        self.port[..., :3] -= self.rest


@njit(cache=True)
def _replay_model(wrench, run, approach, bodies, hung, laws, h, state, out):
    """``laws``: resistances, weight of the old twist in each new pose, and delay [ticks]."""
    port, whole, rigid, inertia, inverse = bodies
    appendage, placed, rest = hung
    force, old, late = laws
    q, v, tau, swinging, handed = state
    n = len(run)
    pose, twist, push = np.empty((n, 7)), np.empty((n, 6)), np.empty((n, 6))
    before = np.empty((n, 2, 6))
    place_at_start(approach, port, q, v)
    hang(appendage, placed, rest, q, v, swinging)
    relative_states(q, v, port, pose, twist)
    run_back(pose, twist, h, handed)
    for k in range(wrench.shape[1]):
        for i in range(n):
            copied(wrench[run[i], k], push[i])
        resist_between(force, q, v, port, rigid, inverse, h, push)
        load_wrench(q, port, push, tau)
        resist_bodies(force, v, rigid, h, tau)
        swing(hung, (whole, rigid), q, v, h, swinging, tau)
        copied(v, before)
        newton_euler(rigid, inertia, inverse, tau, h, v)
        for i in range(n):
            if old[i] < 1.0:
                for b in range(2):
                    for j in range(6):
                        before[i, b, j] = v[i, b, j] + old[i] * (before[i, b, j] - v[i, b, j])
        move(q, before, h)
        relative_states(q, v, port, pose, twist)
        hand_on(k + 1, late, handed, pose, twist)
        copied(pose, out[:, k])
