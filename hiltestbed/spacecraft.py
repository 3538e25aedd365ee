"""The numerical model: chaser and target as free-flyers, computed by Pinocchio.

One Pinocchio model holds the bodies of up to :data:`RUNS_PER_MODEL` runs, so that one call of the articulated-body algorithm
(R. Featherstone, Rigid Body Dynamics Algorithms, 2008, table 9.6) accelerates them all. The linear velocity is kept in the inertial
frame, so that the semi-implicit step adds ``h f/m`` to the momentum of one body and takes it from the other; in the body frame, that
of Pinocchio's free-flyer joint, the same step would lose momentum with every turn of the frame. What a body is accelerated by does
not depend on its linear velocity: Pinocchio is given each body as it is seen by an observer who moves along with it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numba import njit

from hiltestbed.frames import (
    Array,
    cross,
    pose_between,
    quat_exp,
    quat_from_attitude_deg,
    quat_mul,
    quat_normalise,
    rotate,
    rotate_back,
    rotation_matrix,
)
from hiltestbed.scenario import Scenario
from hiltestbed.scenario_parts import Body

RUNS_PER_MODEL = (
    6  # Pinocchio's Data holds several (nv, nv, nv) tensors: at 6 runs, nv = 72, 12 MB and 2 ms to make; at 16, 230 MB and 0.2 s
)
CHASER, TARGET = 0, 1
WORK = 9  # rows of scratch that the kernels of one run need


class Spacecraft:
    """Two free-flyers a run, for ``n`` runs, and the relative motion of their ports.

    Attributes:
        q: ``(n, 2, 7)`` pose of the chaser's and the target's centre of mass in the inertial frame.
        v: ``(n, 2, 6)`` linear velocity in the inertial frame, angular velocity in the body frame.
        pose: ``(n, 7)`` pose of A in P.
        twist: ``(n, 6)`` velocity of A relative to P, in P.
    """

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        n = len(scenarios)
        self.n = n
        self.tick = 1.0 / scenarios[0].rate
        bodies = [(s.spacecraft.chaser, s.spacecraft.target) for s in scenarios]
        self.mass = np.array([[b.mass for b in pair] for pair in bodies])
        self.inertia = np.array([[inertia_matrix(b.inertia) for b in pair] for pair in bodies])
        self.port = np.array([[port_pose(b) for b in pair] for pair in bodies])
        self.q = np.zeros((n, 2, 7))
        self.v = np.zeros((n, 2, 6))
        self.pose = np.zeros((n, 7))
        self.twist = np.zeros((n, 6))
        self._tau = np.zeros((n, 2, 6))
        self._approach = np.array([approach_state(s) for s in scenarios])
        self.build()
        self.reset()

    def build(self) -> None:
        """(Re)make the Pinocchio models from ``mass`` and ``inertia``."""
        self.flyers = FreeFlyers(self.mass, self.inertia)

    def reset(self) -> None:
        """Target at rest with P at the inertial origin; chaser where and as fast as ``approach`` says."""
        place_at_start(self._approach, self.port, self.q, self.v)
        relative_states(self.q, self.v, self.port, self.pose, self.twist)

    def advance(self, wrench: Array) -> None:
        """One semi-implicit Euler step under ``wrench`` ``(n, 6)``, active on passive, in P at P's origin: twists, then poses."""
        load_wrench(self.q, self.port, wrench, self._tau)
        self.flyers.accelerate(self.q, self.v, self._tau, self.tick)
        move(self.q, self.v, self.tick)
        relative_states(self.q, self.v, self.port, self.pose, self.twist)

    def buffers(self) -> dict[str, Array]:
        """The arrays that make up the state."""
        return {"q": self.q, "v": self.v, "pose": self.pose, "twist": self.twist}


class FreeFlyers:
    """The Pinocchio models of bodies of ``mass`` ``(n, 2)`` [kg] and ``inertia`` ``(n, 2, 3, 3)`` [kg m^2]."""

    def __init__(self, mass: Array, inertia: Array) -> None:
        n = len(mass)
        self._q, self._v, self._tau = np.zeros((n, 2, 7)), np.zeros((n, 2, 6)), np.zeros((n, 2, 6))
        self._acceleration = np.zeros((n, 2, 6))
        self._models = []
        for start in range(0, n, RUNS_PER_MODEL):
            runs = slice(start, start + RUNS_PER_MODEL)
            model = _model(mass[runs], inertia[runs])
            views = [array[runs].reshape(-1) for array in (self._q, self._v, self._tau, self._acceleration)]
            self._models.append((model, model.createData(), *views))

    def accelerate(self, q: Array, v: Array, tau: Array, tick: float) -> None:
        """Add what ``tau`` ``(n, 2, 6)``, force in the inertial frame and torque in the body's, changes in a tick to ``v``."""
        _as_seen(q, v, tau, self._q, self._v, self._tau)
        for model, data, q_, v_, tau_, out in self._models:
            out[:] = pin.aba(model, data, q_, v_, tau_)
        _gain_speed(q, self._acceleration, tick, v)


def _model(mass: Array, inertia: Array) -> pin.Model:
    """Free-flyers of ``mass`` (r, 2) and ``inertia`` (r, 2, 3, 3) about their centres of mass, without gravity."""
    model = pin.Model()
    model.gravity = pin.Motion.Zero()
    for i in range(len(mass)):
        for b in range(2):
            joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"body_{i}_{b}")
            model.appendBodyToJoint(joint, pin.Inertia(mass[i, b], np.zeros(3), inertia[i, b]), pin.SE3.Identity())
    return model


def inertia_matrix(inertia: Sequence[float]) -> Array:
    """``(3, 3)`` from the diagonal, or from xx, yy, zz, xy, xz, yz [kg m^2]."""
    xx, yy, zz, xy, xz, yz = (*inertia, 0.0, 0.0, 0.0)[:6]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def port_pose(body: Body) -> Array:
    """``(7,)`` pose of the port in the body."""
    return np.concatenate([body.port.position, quat_from_attitude_deg(body.port.attitude_deg)])


def approach_state(scenario: Scenario) -> Array:
    """``(13,)``: pose of A in P and relative twist in P at t = 0."""
    a = scenario.approach
    position = [a.offset[0], a.offset[1], -a.gap]
    return np.concatenate([position, quat_from_attitude_deg(a.attitude_deg), a.velocity, np.radians(a.rate_deg)])


def effective_mass(scenario: Scenario) -> float:
    """Reduced mass [kg] of both bodies along the line of approach at P's origin, lever arms included.

    ``1/m = sum of 1/m_i + (r_i x n)^T I_i^-1 (r_i x n)`` with n along z of P, at the start pose with centred ports.
    """
    total = 0.0
    for body in (scenario.spacecraft.chaser, scenario.spacecraft.target):
        port = port_pose(body)
        q = port[3:]
        n = np.array([2 * (q[0] * q[2] + q[1] * q[3]), 2 * (q[1] * q[2] - q[0] * q[3]), 1 - 2 * (q[0] ** 2 + q[1] ** 2)])
        arm = np.cross(port[:3], n)
        total += 1.0 / body.mass + arm @ np.linalg.solve(inertia_matrix(body.inertia), arm)
    return float(1.0 / total)


def pair_momentum(mass: Array, inertia: Array, q: Array, v: Array) -> Array:
    """Linear [kg m/s] and angular [N m s] momentum of both bodies together, about the inertial origin.

    Args:
        mass: ``(..., 2)``. inertia: ``(..., 2, 3, 3)``. q: ``(..., 2, 7)``. v: ``(..., 2, 6)``.

    Returns:
        ``(..., 6)``.
    """
    linear = mass[..., None] * v[..., :3]
    spin = np.einsum("...ij,...j->...i", rotation_matrix(q[..., 3:]) @ inertia, v[..., 3:])
    angular = np.cross(q[..., :3], linear) + spin
    return np.concatenate([linear.sum(axis=-2), angular.sum(axis=-2)], axis=-1)


@njit(cache=True)
def place_bodies(approach, port, q, v):
    """One run: ``q`` (2, 7) and ``v`` (2, 6) at t = 0 from ``approach`` (13,) and ``port`` (2, 7): target at rest, P at the origin."""
    r, w, u, inverse = np.empty(3), np.empty(3), np.empty(3), np.empty(4)
    for b in range(2):  # attitude of the body in P: port attitude in P, less port attitude in the body
        for j in range(3):
            inverse[j] = -port[b, 3 + j]
        inverse[3] = port[b, 6]
        if b == CHASER:
            quat_mul(approach[3:7], inverse, q[b, 3:7])
        else:
            q[b, 3:7] = inverse
        rotate(q[b, 3:7], port[b, 0:3], r)
        for j in range(3):
            q[b, j] = -r[j] + (approach[j] if b == CHASER else 0.0)
        v[b] = 0.0
    rotate(q[CHASER, 3:7], port[CHASER, 0:3], r)  # centre of mass moves slower than the port by w x r
    w[:] = approach[10:13]
    cross(w, r, u)
    for j in range(3):
        v[CHASER, j] = approach[7 + j] - u[j]
    rotate_back(q[CHASER, 3:7], w, v[CHASER, 3:6])


@njit(cache=True)
def place_at_start(approach, port, q, v):
    """All runs: ``q`` (n, 2, 7) and ``v`` (n, 2, 6) at t = 0."""
    for i in range(q.shape[0]):
        place_bodies(approach[i], port[i], q[i], v[i])


@njit(cache=True)
def _port_state(q, v, port, pose, arm, velocity, rate):
    """World pose of a port, its arm from the centre of mass, its velocity and angular rate, all in inertial axes."""
    rotate(q[3:7], port[0:3], arm)
    rotate(q[3:7], v[3:6], rate)
    cross(rate, arm, velocity)
    for j in range(3):
        pose[j] = q[j] + arm[j]
        velocity[j] += v[j]
    quat_mul(q[3:7], port[3:7], pose[3:7])


@njit(cache=True)
def relative_motion(q, v, port, work, pose, twist):
    """One run: ``pose`` (7,) of A in P and ``twist`` (6,) from ``q`` (2, 7), ``v`` (2, 6), ``port`` (2, 7); ``work`` (WORK, 7)."""
    pose_A, pose_P = work[0], work[1]
    arm, u_A, w_A, u_P, w_P, d, s = work[2], work[3], work[4], work[5], work[6], work[7], work[8]
    _port_state(q[CHASER], v[CHASER], port[CHASER], pose_A, arm, u_A, w_A)
    _port_state(q[TARGET], v[TARGET], port[TARGET], pose_P, arm, u_P, w_P)
    pose_between(pose_P, pose_A, pose)
    for j in range(3):
        d[j] = pose_A[j] - pose_P[j]
    cross(w_P, d, s)
    for j in range(3):
        u_A[j] -= u_P[j] + s[j]
        w_A[j] -= w_P[j]
    rotate_back(pose_P[3:7], u_A, twist[0:3])
    rotate_back(pose_P[3:7], w_A, twist[3:6])


@njit(cache=True)
def load_bodies(q, port, wrench, work, tau):
    """One run: generalised forces ``tau`` (2, 6), force in inertial axes and torque about the centre of mass in body axes, of
    ``wrench`` (6,), active on passive, in P at P's origin; ``work`` (WORK, 7)."""
    attitude, force, torque, arm, point, moment = work[0], work[1], work[2], work[3], work[4], work[5]
    quat_mul(q[TARGET, 3:7], port[TARGET, 3:7], attitude)
    rotate(attitude, wrench[0:3], force)
    rotate(attitude, wrench[3:6], torque)
    rotate(q[TARGET, 3:7], port[TARGET, 0:3], arm)
    for j in range(3):
        point[j] = q[TARGET, j] + arm[j]
    for b in range(2):
        sign = 1.0 if b == TARGET else -1.0
        for j in range(3):
            arm[j] = point[j] - q[b, j]
        cross(arm, force, moment)
        for j in range(3):
            tau[b, j] = sign * force[j]
            moment[j] = sign * (moment[j] + torque[j])
        rotate_back(q[b, 3:7], moment, tau[b, 3:6])


@njit(cache=True)
def relative_states(q, v, port, pose, twist):
    work = np.empty((WORK, 7))
    for i in range(q.shape[0]):
        relative_motion(q[i], v[i], port[i], work, pose[i], twist[i])


@njit(cache=True)
def load_wrench(q, port, wrench, tau):
    work = np.empty((WORK, 7))
    for i in range(q.shape[0]):
        load_bodies(q[i], port[i], wrench[i], work, tau[i])


@njit(cache=True)
def _as_seen(q, v, tau, q_seen, v_seen, tau_seen):
    """Poses, velocities and forces in body axes, for an observer who moves along with each body."""
    for i in range(q.shape[0]):
        for b in range(2):
            q_seen[i, b, 3:7] = q[i, b, 3:7]
            v_seen[i, b, 3:6] = v[i, b, 3:6]
            rotate_back(q[i, b, 3:7], tau[i, b, 0:3], tau_seen[i, b, 0:3])
            tau_seen[i, b, 3:6] = tau[i, b, 3:6]


@njit(cache=True)
def _gain_speed(q, acceleration, tick, v):
    linear = np.empty(3)
    for i in range(q.shape[0]):
        for b in range(2):
            rotate(q[i, b, 3:7], acceleration[i, b, 0:3], linear)
            for j in range(3):
                v[i, b, j] += tick * linear[j]
                v[i, b, 3 + j] += tick * acceleration[i, b, 3 + j]


@njit(cache=True)
def move(q, v, tick):
    """Move the poses ``q`` (n, 2, 7) with the velocities ``v`` (n, 2, 6) for a tick [s]."""
    turn, dq, before = np.empty(3), np.empty(4), np.empty(4)
    for i in range(q.shape[0]):
        for b in range(2):
            for j in range(3):
                q[i, b, j] += tick * v[i, b, j]
                turn[j] = tick * v[i, b, 3 + j]
            quat_exp(turn, dq)
            before[:] = q[i, b, 3:7]
            quat_mul(before, dq, q[i, b, 3:7])
            quat_normalise(q[i, b, 3:7])
