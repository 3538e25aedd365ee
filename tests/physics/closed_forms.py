"""What theory says of two free bodies and of their bounce: the yardsticks of the tests."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from hiltestbed.frames import Array, rotation_matrix
from hiltestbed.numerical_model.bodies import inertia_matrix
from hiltestbed.scenario.spacecraft import Body


def cor_at_zero_force(k: float, c: float, mu: float) -> float:
    """Coefficient of restitution of ``mu x'' = -(k x + c x')`` from x = 0 to the first F = 0.

    With z = c/(2 sqrt(k mu)), s = sqrt(1 - z^2), the phase at which F vanishes is pi - atan2(2 z s,
    1 - 2 z^2), and the speed has decayed by exp(-z/s times that phase) while F = 0 makes the
    velocity -v0 times the decay.
    """
    z = c / (2.0 * math.sqrt(k * mu))
    s = math.sqrt(1.0 - z * z)
    return math.exp(-(z / s) * (math.pi - math.atan2(2.0 * z * s, 1.0 - 2.0 * z * z)))


def bounce(
    k: float, c: float, mu: float, speed: float, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Penetration, its rate and the force at times from the touch; free before it and after F = 0."""
    w, z = math.sqrt(k / mu), c / (2.0 * math.sqrt(k * mu))
    wd = w * math.sqrt(1.0 - z * z)
    decay = np.exp(-z * w * t)
    x = np.where(t < 0, speed * t, speed / wd * decay * np.sin(wd * t))
    v = np.where(t < 0, speed, speed * decay * (np.cos(wd * t) - z * w / wd * np.sin(wd * t)))
    force = np.maximum(k * x + c * v, 0.0) * (t >= 0)
    end = int(np.argmax((force <= 0.0) & (t * wd > 0.5)))
    x[end:], v[end:], force[end:] = x[end] + v[end] * (t[end:] - t[end]), v[end], 0.0
    return x, v, force


def cor_pure_delay(w: float, tau: float) -> float:
    """Coefficient of restitution of an undamped contact whose force arrives ``tau`` late.

    The method of steps on ``x'' = -w^2 x(t - tau)``, x = v0 t before: x(t) = v0 sum_n (-1)^n w^(2n)
    (t - n tau)_+^(2n+1)/(2n+1)!,
    contact until its first zero, and the whole impulse arrives: e = w^2/v0 times the integral of x,
    less 1.
    """

    def x(t: float) -> float:
        return sum(
            (-1) ** n
            * w ** (2 * n)
            * max(t - n * tau, 0.0) ** (2 * n + 1)
            / math.factorial(2 * n + 1)
            for n in range(60)
        )

    times = np.linspace(1e-6, 6.0 / w, 2000)
    after = int(np.argmax(np.array([x(t) for t in times]) < 0.0))
    end = brentq(x, times[after - 1], times[after])
    return w * w * quad(x, 0.0, end, limit=200)[0] - 1.0


def newton_euler(
    bodies: Sequence[Body], state: np.ndarray, force: np.ndarray, torque: np.ndarray, at: np.ndarray
) -> np.ndarray:
    """(26,) rates of p, q, v, w of chaser and target, state (2, 13), w in the body, under what the
    chaser exerts on the target at a point, in inertial axes.
    """
    out = np.empty((2, 13))
    for body, given, rate, sign in zip(bodies, state, out, (-1.0, 1.0), strict=True):
        p, q, v, w = np.split(given, [3, 7, 10])
        inertia = inertia_matrix(body.inertia)
        moment = Rotation.from_quat(q).inv().apply(sign * (torque + np.cross(at - p, force)))
        rate[:3] = v
        rate[3:7] = 0.5 * np.concatenate([q[3] * w + np.cross(q[:3], w), [-q[:3] @ w]])
        rate[7:10] = sign * force / body.mass
        rate[10:] = np.linalg.solve(inertia, moment - np.cross(w, inertia @ w))
    return out.ravel()


def pair_momentum(mass: Array, inertia: Array, q: Array, v: Array) -> Array:
    """Linear [kg m/s] and angular [N m s] momentum of both bodies together, about the inertial
    origin.

    Args:
        mass: ``(..., 2)``. inertia: ``(..., 2, 3, 3)``. q: ``(..., 2, 7)``. v: ``(..., 2, 6)``.

    Returns:
        ``(..., 6)``.
    """
    linear = mass[..., None] * v[..., :3]
    spin = np.einsum("...ij,...j->...i", rotation_matrix(q[..., 3:]) @ inertia, v[..., 3:])
    angular = np.cross(q[..., :3], linear) + spin
    return np.concatenate([linear.sum(axis=-2), angular.sum(axis=-2)], axis=-1)
