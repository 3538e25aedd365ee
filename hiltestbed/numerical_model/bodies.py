"""The nominal vehicles and their approach, as arrays."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from hiltestbed.frames import Array, quat_from_attitude_deg, rotation_matrix

if TYPE_CHECKING:
    from hiltestbed.scenario.spacecraft import Approach, Body, Spacecraft


def inertia_matrix(inertia: Sequence[float]) -> Array:
    """``(3, 3)`` from the diagonal, or from xx, yy, zz, xy, xz, yz [kg m^2]."""
    xx, yy, zz, xy, xz, yz = (*inertia, 0.0, 0.0, 0.0)[:6]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def port_pose(body: Body) -> Array:
    """``(7,)`` pose of the port in the body."""
    return np.concatenate([body.port.position, quat_from_attitude_deg(body.port.attitude_deg)])


def approach_state(approach: Approach) -> Array:
    """``(13,)``: pose of A in P and relative twist in P at t = 0."""
    attitude = quat_from_attitude_deg(approach.attitude_deg)
    position, turn = [*approach.offset, -approach.gap], np.radians(approach.rate_deg)
    return np.concatenate([position, attitude, approach.velocity, turn])


def approach_states(approaches: Iterable[Approach]) -> Array:
    """``(n, 13)`` as :func:`approach_state`, of several."""
    return np.array([approach_state(a) for a in approaches])


def effective_mass(spacecraft: Spacecraft) -> float:
    """Reduced mass [kg] of both bodies along the line of approach at P's origin, lever arms
    included.

    ``1/m = sum of 1/m_i + (r_i x n)^T I_i^-1 (r_i x n)`` with n along z of P, at the start pose
    with centred ports.
    """
    total = 0.0
    for body in (spacecraft.chaser, spacecraft.target):
        port = port_pose(body)
        q = port[3:]
        n = np.array(
            [
                2 * (q[0] * q[2] + q[1] * q[3]),
                2 * (q[1] * q[2] - q[0] * q[3]),
                1 - 2 * (q[0] ** 2 + q[1] ** 2),
            ]
        )
        arm = np.cross(port[:3], n)
        total += 1.0 / body.mass + arm @ np.linalg.solve(inertia_matrix(body.inertia), arm)
    return float(1.0 / total)


def rest_inertia(
    mass: float, inertia: Array, ratio: Array | Sequence[float], place: Array
) -> Array:
    """Inertia ``(3, 3)``, about its own centre of mass, of a body without the fractions ``ratio``
    (S,) of its mass at ``place`` (S, 3).

    Parallel-axis theorem: the body's ``inertia`` (3, 3) [kg m^2] about its centre of mass is that
    of the rest plus all point masses.
    """
    ratio = np.asarray(ratio)
    centre = -ratio @ place / (1.0 - ratio.sum())
    points, weights = np.vstack([place, centre]), mass * np.append(ratio, 1.0 - ratio.sum())
    return inertia - sum(
        m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(weights, points, strict=True)
    )


def mobility(spacecraft: Spacecraft) -> Array:
    """``(6, 6)`` M^-1: relative acceleration at A per wrench there, in P, at the nominal touch."""
    return _mobility(spacecraft.chaser) + _mobility(spacecraft.target)


def _mobility(body: Body) -> Array:
    """Of a body at its port: ``[1/m - [r] I^-1 [r], -[r] I^-1; I^-1 [r], I^-1]``, in its axes."""
    port = port_pose(body)
    turn = rotation_matrix(port[3:])
    inverse = turn.T @ np.linalg.inv(inertia_matrix(body.inertia)) @ turn
    x, y, z = turn.T @ port[:3]
    arm = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.block(
        [[np.eye(3) / body.mass - arm @ inverse @ arm, -arm @ inverse], [inverse @ arm, inverse]]
    )
