"""Latches between the sides: MuJoCo's weld and connect equalities, made to exert the forces of
springs, dampers and the contact law.

A closure holds a site of the active side at a pose in a site of the passive one. Its force in the
passive site's frame is K (r - r_hold) + C r', along z that of the contact's law if the closure is
the contact itself; its torque is K radius^2 times the rotation vector, plus the corresponding
damping. MuJoCo's equality takes spring and damper from its ``solref``; its two anchors are placed
before each step, 1/STIFFER of the deflection apart, so that force and reaction act along one line
and any force law can be exerted.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from hiltestbed.compiled.jit import copied, njit
from hiltestbed.contact.composition import (
    NO_DAMPING,
    SITE,
    Structure,
    closures_of,
    inverse_mass,
)
from hiltestbed.contact.facets import CarriedFrames
from hiltestbed.contact.law import STATES, contact_force
from hiltestbed.contact.parameters import DAMPING, STIFFNESS
from hiltestbed.contact.wrench import relate_one
from hiltestbed.frames import Array, quat_exp, quat_mul, quat_mul_conj, rotate, rotation_vector

# stiffness of MuJoCo's spring over that of the closure; the distance of the anchors is smaller by
# the same factor
STIFFER = 1e4


class _Fixed(NamedTuple):
    """The numbers of the closures, for the kernel."""

    rows: Array  # (n, PARAMETERS) of the closure that is the contact itself
    springs: Array  # (n, K, 3)
    law: NDArray[np.bool_]  # (K,)
    turns: NDArray[np.bool_]
    frames: NDArray[np.int64]  # (K, 2)
    places: Array  # (K, 2, 7)
    ids: NDArray[np.int64]  # (K,) of MuJoCo's equalities


class _Now(NamedTuple):
    """Their state, and MuJoCo's arrays of each run."""

    closed: NDArray[np.bool_]  # (n, K)
    closing: NDArray[np.bool_]  # (n, K)
    hold: Array  # (n, K, 7)
    state: Array  # (n, STATES) of the contact's law
    pose: Array  # (n, K, 7) of the active site in the passive one
    twist: Array  # (n, K, 6)
    active: NDArray[np.bool_]  # eq_active
    data: Array  # eq_data


class Latches:
    """The closures of `n` runs.

    Attributes:
        closed: (n, K) bool. springs: (n, K, 3) stiffness [N/m], damping [N s/m] and radius [m] of
            each.
        hold: (n, K, 7) the held pose of each, of the active site in the passive one.
    """

    def __init__(self, batch: Batch, structure: Structure, rows: Array) -> None:
        """``rows``: (n, PARAMETERS) of the closure that is the contact itself."""
        m, n, self.closures = batch.model, len(rows), closures_of(structure)
        count = len(self.closures)
        self._ids = np.array([m.equality(c.name).id for c in self.closures], dtype=np.int64)
        bodies = np.stack([m.eq_obj1id[self._ids], m.eq_obj2id[self._ids]])
        gain, weight = inverse_mass(m, bodies), m.body_invweight0[bodies].sum(axis=0)
        self.springs = np.zeros((n, count, 3))
        for k, c in enumerate(self.closures):
            self.springs[:, k, 0] = rows[:, STIFFNESS] if c.stiffness is None else c.stiffness
            self.springs[:, k, 1] = rows[:, DAMPING] if c.damping is None else c.damping
            self.springs[:, k, 2] = c.radius
        solref, data = batch.expand("eq_solref"), batch.expand("eq_data")
        solref[:, self._ids, 0] = -STIFFER * self.springs[..., 0] * gain
        solref[:, self._ids, 1] = np.minimum(-self.springs[..., 1] * gain, NO_DAMPING)
        turning = 2.0 * self.springs[..., 2] * np.sqrt(weight[:, 1] / weight[:, 0])
        turns, law, self._together = (
            np.array([getattr(c, name) for c in self.closures], dtype=bool)
            for name in ("turns", "law", "together")
        )
        data[:, self._ids[turns], 10] = turning[:, turns]
        frames = np.array([c.frames for c in self.closures], dtype=np.int64).reshape(count, 2)
        places = np.array([c.places for c in self.closures]).reshape(count, 2, 7)
        self._fixed = _Fixed(rows, self.springs, law, turns, frames, places, self._ids)
        self.closed, self._closing = (np.zeros((n, count), dtype=bool) for _ in range(2))
        self.hold, self.pose = (np.zeros((n, count, 7)) for _ in range(2))
        self.state, self.twist = np.zeros((n, STATES)), np.zeros((n, count, 6))
        self._active = batch.bind("eq_active")
        self._now = _Now(
            self.closed,
            self._closing,
            self.hold,
            self.state,
            self.pose,
            self.twist,
            self._active,
            data,
        )

    def open(self, captured: bool) -> None:
        """Open all closures; or hold A at P if the mechanism is ``captured`` from the start."""
        self.closed[:] = captured
        self._closing[:] = False
        self.state[:] = 0.0
        self.hold[:] = SITE
        self._active[:, self._ids] = captured

    def number(self, name: str) -> int:
        """The index of the closure of this name."""
        return [c.name for c in self.closures].index(name)

    def close(self, k: int, which: NDArray[np.bool_], force: Array) -> None:
        """Close closure ``k`` at the present pose of its sites, in the runs ``which`` (n,), from
        the next update on.

        Its springs carry the ``force`` (n, 3) on the passive side, in the passive site's frame.
        """
        self.hold[which, k] = SITE if self._together[k] else self.pose[which, k]
        if not self._together[k]:
            self.hold[which, k, :3] -= force[which] / self.springs[which, k, :1]
        self.closed[which, k] = self._closing[which, k] = True

    def holding(self, dt: float, bodies: CarriedFrames) -> tuple[Any, ...] | None:
        """The arguments of :func:`hold`; None without closures."""
        return (dt, self._fixed, self._now, bodies) if self.closures else None


@njit(cache=True)
def hold(dt, fixed, now, bodies):
    """Relative pose and twist of the sites of each closure, and the anchors of closed closures."""
    rows, spring, law, turns, pairs, places, ids = fixed
    closed, closing, hold, state, pose, twist, active, data = now
    frames, motions, carry = bodies
    site = np.empty((2, 7))
    velocity = np.empty((2, 6))
    work, turn, f = np.empty((1, 3)), np.empty(3), np.empty(3)
    q, r, s = np.empty(4), np.empty(4), np.empty(4)
    for i in range(pose.shape[0]):
        for k in range(ids.shape[0]):
            for side in range(2):
                site_state(
                    frames[i, pairs[k, side]],
                    motions[i, pairs[k, side]],
                    places[k, side],
                    site[side],
                    velocity[side],
                )
            at, rate = pose[i, k], twist[i, k]
            if closing[i, k]:
                active[i, ids[k]], closing[i, k] = True, False
            relate_one(site[0], velocity[0], site[1], velocity[1], at, rate, work)
            if not closed[i, k]:
                continue
            stiffness, damping, out = spring[i, k, 0], spring[i, k, 1], data[i, ids[k]]
            for j in range(3):
                f[j] = stiffness * (at[j] - hold[i, k, j])
            if law[k]:
                f[2] = (
                    contact_force(at[2] - hold[i, k, 2], rate[2], dt, rows[i], state[i], True)
                    - damping * rate[2]
                )
            carrier, passive = carry[i, pairs[k, 0]], carry[i, pairs[k, 1]]
            # positions in eq_data of the anchors of the active and the passive body
            first, second = (0, 3) if turns[k] else (3, 0)
            _anchor(carrier, places[k, 0], 0.0 * f, out[first : first + 3], r)
            for j in range(3):
                f[j] = at[j] - f[j] / (STIFFER * stiffness)
            _anchor(passive, places[k, 1], f, out[second : second + 3], r)
            if turns[k]:
                # the attitude turned back by 1/STIFFER of its rotation from that which is held
                quat_mul_conj(at[3:7], hold[i, k, 3:7], q)
                rotation_vector(q, turn)
                for j in range(3):
                    turn[j] /= -STIFFER
                quat_exp(turn, r)
                quat_mul(r, at[3:7], q)
                # that of the active body in the passive one, if the site has the former
                quat_mul(passive[3:7], places[k, 1, 3:7], r)
                quat_mul(r, q, s)
                quat_mul_conj(s, places[k, 0, 3:7], q)
                quat_mul_conj(q, carrier[3:7], r)
                out[6], out[7], out[8], out[9] = r[3], r[0], r[1], r[2]


@njit(cache=True)
def site_state(frame, motion, place, pose, twist):
    """Pose (7,) and twist (6,) in W of a site at the pose ``place`` (7,) in a frame."""
    rotate(frame[3:7], place[0:3], pose[0:3])
    quat_mul(frame[3:7], place[3:7], pose[3:7])
    x, y, z = pose[0], pose[1], pose[2]
    copied(motion, twist)
    twist[0] += motion[4] * z - motion[5] * y
    twist[1] += motion[5] * x - motion[3] * z
    twist[2] += motion[3] * y - motion[4] * x
    for j in range(3):
        pose[j] += frame[j]


@njit(cache=True)
def _anchor(carry, place, at, out, scratch):
    """``out`` (3,): a point ``at`` (3,) of a site, at ``place`` in a frame at ``carry`` in its
    body.
    """
    v = scratch[0:3]
    rotate(place[3:7], at, v)
    for j in range(3):
        v[j] += place[j]
    rotate(carry[3:7], v, out)
    for j in range(3):
        out[j] += carry[j]
