"""The numerical model: chaser and target as free-flyers, driven by the compensated wrench.

A tick is a semi-implicit Euler step: each body's twist first, then its pose with the new twist.
Errors of the model (masses, inertias, ports, appendages, forces, integrator, step delay) are
departures from the nominal parameters; without any the step is the nominal one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call, bound
from hiltestbed.compiled.jit import interpreted, njit
from hiltestbed.errors import InputError
from hiltestbed.frames import Array, cross, pose_step, rotate, rotate_back, rotation_matrix
from hiltestbed.numerical_model.bodies import (
    approach_states,
    inertia_matrix,
    port_pose,
    rest_inertia,
)
from hiltestbed.numerical_model.free_flyers import FreeFlyers, as_seen, gain_speed
from hiltestbed.numerical_model.kernels import load_wrench, move, place_at_start, relative_states
from hiltestbed.numerical_model.parameters import (
    BODIES,
    DAMPING,
    PLACE,
    RATIO,
    STIFFNESS,
    Departures,
    DynamicsParameters,
    stack,
)
from hiltestbed.numerical_model.resistance import resist_between, resist_bodies

if TYPE_CHECKING:
    from hiltestbed.scenario.like import ScenarioLike


class NumericalModel:
    """Two free-flyers per run, for ``n`` runs, and the relative motion of their ports.

    Attributes:
        mass: ``(n, 2)``, inertia: ``(n, 2, 3, 3)``, port: ``(n, 2, 7)``, nominal: a compensation
            builds its copy of the model from them.
        q: ``(n, 2, 7)`` pose of the chaser's and the target's centre of mass in the inertial frame;
            for a body with an appendage away from its centre of mass, the centre of mass of the
            body without its appendages.
        v: ``(n, 2, 6)`` linear velocity in the inertial frame, angular velocity in the body frame.
        pose: ``(n, 7)`` output pose of A in P. twist: ``(n, 6)`` output velocity of A relative to
            P, in P.
        ended: runs whose model has ended the simulation by itself, each with the reason.
    """

    def __init__(
        self, scenarios: Sequence[ScenarioLike], departures: Departures | None = None
    ) -> None:
        """``departures``: from the nominal model; by default by the effects of the scenarios."""
        n = len(scenarios)
        self.n = n
        self.ended: dict[int, str] = {}
        self.tick = 1.0 / scenarios[0].rate
        bodies = [(s.spacecraft.chaser, s.spacecraft.target) for s in scenarios]
        self.mass = np.array([[b.mass for b in pair] for pair in bodies])
        self.inertia = np.array([[inertia_matrix(b.inertia) for b in pair] for pair in bodies])
        self.port = np.array([[port_pose(b) for b in pair] for pair in bodies])
        self.q, self.v = np.zeros((n, 2, 7)), np.zeros((n, 2, 6))
        self._centres = np.zeros_like(self.q)
        self.pose, self.twist = np.zeros((n, 7)), np.zeros((n, 6))
        self._tau, self._before = np.zeros((n, 2, 6)), np.zeros((n, 2, 6))
        self._approach = approach_states(s.approach for s in scenarios)
        self._depart(
            stack([DynamicsParameters().with_effects(s.effects) for s in scenarios])
            if departures is None
            else departures
        )
        self.reset()

    def _depart(self, d: Departures) -> None:
        """Apply the departures to the parameters of the model that runs."""
        self._port = self.port.copy()
        self._port[..., :3] += d.port
        self._appendage = d.appendage
        self._whole = self.mass * d.mass
        self._rigid = self._whole * (1.0 - d.appendage[..., RATIO].sum(axis=-1))
        self._placed = hung_at_a_place(d.appendage)
        self._rest, self._inertia = rests(
            d.appendage, self._whole, self.inertia * d.inertia[..., None, None]
        )
        self._port[..., :3] -= self._rest
        self._swing = np.zeros((*d.appendage.shape[:3], 2, 3))
        self._force = d.force
        self._resisted = np.zeros((self.n, 6)) if d.force.size else None
        self._inverse = np.linalg.inv(self._inertia)
        self._swings = bool(d.appendage[..., RATIO].any())
        self._explicit = d.explicit if d.explicit.any() else None
        self._late = d.late if d.late.any() else None
        self._handed = np.zeros((self.n, int(d.late.max()) + 1, 13))
        self._clock = np.zeros(1, dtype=np.int64)
        self._departs = (
            self._resisted is not None
            or self._swings
            or self._explicit is not None
            or self._late is not None
        )

    @cached_property
    def flyers(self) -> FreeFlyers:
        """The bodies in Pinocchio, created at the first acceleration."""
        return FreeFlyers(self._rigid, self._inertia)

    def reset(self) -> None:
        """Target at rest with P at the inertial origin; chaser as ``approach`` says."""
        interpreted(place_at_start)(self._approach, self._port, self.q, self.v)
        self._swing[:] = 0.0
        if self._placed.any():
            hang(self._appendage, self._placed, self._rest, self.q, self.v, self._swing)
        interpreted(relative_states)(self.q, self.v, self._port, self.pose, self.twist)
        if self._late is not None:
            run_back(self.pose, self.twist, self.tick, self._handed)

    def believed_start(self) -> tuple[Array, Array]:
        """``q`` and ``v`` of the nominal bodies at t = 0."""
        q, v = np.zeros_like(self.q), np.zeros_like(self.v)
        interpreted(place_at_start)(self._approach, self.port, q, v)
        return q, v

    def centres(self) -> Array:
        """``(n, 2, 7)`` poses at the centres of mass, appendages undeflected; always one array."""
        if not self._placed.any():
            return self.q
        self._centres[:] = self.q
        arm = rotation_matrix(self.q[..., 3:]) @ self._rest[..., None]
        self._centres[..., :3] -= arm[..., 0]
        return self._centres

    @cached_property
    def _nominal(self) -> tuple[Call, Callable[[float], None]]:
        """The two halves of a nominal step, before and after Pinocchio accelerates the bodies."""
        flyers = self.flyers
        seen = Call(_load, self.q, self.v, self._port, GIVEN, self._tau, *flyers.seen)
        return seen, bound(
            _go_on, self.q, flyers.acceleration, ..., self.v, self._port, self.pose, self.twist
        )

    def advance(self, wrench: Array) -> None:
        """One step under ``wrench`` ``(n, 6)``, active on passive, in P at P's origin."""
        if not self._departs:
            load, go_on = self._nominal
            load.on(wrench)()
            self.flyers.solve()
            go_on(self.tick)
            return
        if self._resisted is not None:
            self._resisted[:] = wrench
            wrench = self._resisted
            body = self._port, self._rigid, self._inverse
            resist_between(self._force, self.q, self.v, *body, self.tick, wrench)
        load_wrench(self.q, self._port, wrench, self._tau)
        if self._resisted is not None:
            resist_bodies(self._force, self.v, self._rigid, self.tick, self._tau)
        if self._swings:
            hung = self._appendage, self._placed, self._rest
            masses = self._whole, self._rigid
            swing(hung, masses, self.q, self.v, self.tick, self._swing, self._tau)
        if self._explicit is not None:
            self._before[:] = self.v
        self.flyers.accelerate(self.q, self.v, self._tau, self.tick)
        moving = (
            self.v
            if self._explicit is None
            else np.where(self._explicit[:, None, None], self._before, self.v)
        )
        move(self.q, moving, self.tick)
        relative_states(self.q, self.v, self._port, self.pose, self.twist)
        if self._late is not None:
            self._clock[0] += 1
            hand_on(int(self._clock[0]), self._late, self._handed, self.pose, self.twist)


@njit(cache=True)
def _load(q, v, port, wrench, tau, *seen):
    """The loads on the bodies, as inputs for Pinocchio."""
    load_wrench(q, port, wrench, tau)
    as_seen(q, v, tau, *seen)


@njit(cache=True)
def _go_on(q, acceleration, tick, v, port, pose, twist):
    """After the acceleration: twists, then poses, then the relative motion of the ports."""
    gain_speed(q, acceleration, tick, v)
    move(q, v, tick)
    relative_states(q, v, port, pose, twist)


@njit(cache=True)
def run_back(pose, twist, h, handed):
    """Fill the delay line with the uniform approach before the start, tick -j at slot -j."""
    length = handed.shape[1]
    for i in range(pose.shape[0]):
        for j in range(length):
            pose_step(pose[i], twist[i], -j * h, handed[i, -j % length, 0:7])
            for m in range(6):
                handed[i, -j % length, 7 + m] = twist[i, m]


@njit(cache=True)
def hand_on(k, late, handed, pose, twist):
    """Replace pose (n, 7) and twist (n, 6) of tick ``k`` by those of ``late`` (n,) ticks before."""
    length = handed.shape[1]
    for i in range(pose.shape[0]):
        now, past = handed[i, k % length], handed[i, (k - late[i]) % length]
        for j in range(7):
            now[j] = pose[i, j]
            pose[i, j] = past[j]
        for j in range(6):
            now[7 + j] = twist[i, j]
            twist[i, j] = past[7 + j]


def hung_at_a_place(appendage: Array) -> NDArray[np.bool_]:
    """``(n, 2)`` which bodies have an appendage away from the centre of mass."""
    return (appendage[..., PLACE:] != 0.0).any(axis=(-1, -2))


def rests(appendage: Array, whole: Array, inertia: Array) -> tuple[Array, Array]:
    """Centres of mass (n, 2, 3) [m], from those of the bodies, and inertias (n, 2, 3, 3) of the
    bodies without their appendages.

    Mass ``whole`` (n, 2) and ``inertia`` (n, 2, 3, 3) are those of a body with undeflected
    appendages. Raises InputError if the appendages take more inertia than it has.
    """
    centre, left = np.zeros((*whole.shape, 3)), inertia.copy()
    for i, b in np.argwhere(hung_at_a_place(appendage)):
        ratio, place = appendage[i, b, :, RATIO], appendage[i, b, :, PLACE:]
        left[i, b] = (
            rest_inertia(float(whole[i, b]), inertia[i, b], ratio, place)
            if ratio.sum() < 1.0
            else -inertia[i, b]
        )
        if np.linalg.eigvalsh(left[i, b]).min() <= 0.0:
            raise InputError(
                f"effects: dynamics.appendage: the appendages of the {BODIES[b]} take more "
                f"inertia than it has; "
                "place them nearer to its centre of mass, or lower their mass_ratio"
            )
        centre[i, b] = -ratio @ place / (1.0 - ratio.sum())
    return centre, left


@njit(cache=True)
def hang(appendage, placed, rest, q, v, swing):
    """Appendages away from the centre of mass begin at rest: inertial position and velocity."""
    arm, turn, u = np.empty(3), np.empty(3), np.empty(3)
    for i in range(q.shape[0]):
        for b in range(2):
            for s in range(appendage.shape[2] if placed[i, b] else 0):
                for j in range(3):
                    arm[j] = appendage[i, b, s, PLACE + j] - rest[i, b, j]
                rotate(q[i, b, 3:7], arm, arm)
                rotate(q[i, b, 3:7], v[i, b, 3:6], turn)
                cross(turn, arm, u)
                for j in range(3):
                    swing[i, b, s, 0, j] = q[i, b, j] + arm[j]
                    swing[i, b, s, 1, j] = v[i, b, j] + u[j]


@njit(cache=True)
def swing(hung, masses, q, v, h, swing, tau):
    """Add the loads of the appendages on their bodies to ``tau`` (n, 2, 6), and advance them:
    velocity first, then displacement.

    hung: the appendages, which bodies are ``placed`` (n, 2), and ``rest`` (n, 2, 3), the centre of
        mass of a body without its appendages. masses: (n, 2) [kg] with and without appendages.
    swing: (n, 2, S, 2, 3) displacement [m] and velocity [m/s] of each appendage relative to its
        body, in inertial axes; for bodies that are ``placed``, its inertial position and velocity.
    q, v: (n, 2, 7), (n, 2, 6) of the bodies.
    """
    appendage, placed, rest = hung
    whole, rigid = masses
    acceleration = np.empty(3)
    for i in range(tau.shape[0]):
        for b in range(2):
            if placed[i, b]:
                _swing_at(
                    appendage[i, b],
                    whole[i, b],
                    rest[i, b],
                    q[i, b],
                    v[i, b],
                    h,
                    swing[i, b],
                    tau[i, b],
                )
                continue
            for s in range(appendage.shape[2]):
                a = appendage[i, b, s]
                for j in range(3):
                    tau[i, b, j] += (
                        a[RATIO]
                        * whole[i, b]
                        * (a[STIFFNESS] * swing[i, b, s, 0, j] + a[DAMPING] * swing[i, b, s, 1, j])
                    )
            for j in range(3):
                acceleration[j] = tau[i, b, j] / rigid[i, b]
            for s in range(appendage.shape[2]):
                a, m = appendage[i, b, s], swing[i, b, s]
                for j in range(3 if a[RATIO] > 0.0 else 0):
                    pull = a[STIFFNESS] * m[0, j] + a[DAMPING] * m[1, j]
                    m[1, j] -= h * (pull + acceleration[j])
                    m[0, j] += h * m[1, j]


@njit(cache=True)
def _swing_at(appendage, whole, rest, q, v, h, swing, tau):
    """As :func:`swing`, of a body with appendages away from its centre of mass: force and reaction
    act along one line, which conserves linear and angular momentum. The damper acts on the velocity
    relative to the body-fixed point at the mass.
    """
    away, arm, turn, drift, push, torque = np.empty((6, 3))
    rotate(q[3:7], v[3:6], turn)
    for s in range(appendage.shape[0]):
        a, m = appendage[s], swing[s]
        for j in range(3):
            arm[j] = a[PLACE + j] - rest[j]
            away[j] = m[0, j] - q[j]
        rotate(q[3:7], arm, arm)
        cross(turn, away, drift)
        for j in range(3):
            push[j] = a[STIFFNESS] * (away[j] - arm[j]) + a[DAMPING] * (m[1, j] - v[j] - drift[j])
        cross(away, push, torque)
        rotate_back(q[3:7], torque, torque)
        for j in range(3):
            tau[j] += a[RATIO] * whole * push[j]
            tau[3 + j] += a[RATIO] * whole * torque[j]
            m[1, j] -= h * push[j]
            m[0, j] += h * m[1, j]
