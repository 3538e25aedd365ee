"""A compliant mount in closed form, integrated as MuJoCo does: for a replay, which does not step the rig."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from scipy.signal import lfilter

from hiltestbed.contact.composition import PASSIVE, add_side
from hiltestbed.contact.mount import MOUNTED
from hiltestbed.frames import Array
from hiltestbed.jit import njit

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario


@dataclass(frozen=True)
class MountDynamics:
    """The mounts of R runs, integrated as in MuJoCo: six joints and one rigid body whose weight is balanced at its centre of mass.

    Attributes:
        stiffness, damping: (R, 6) [N/m, N m/rad; N s/m, N m s/rad].
        body: (BODY,) mass [kg], centre of mass (3,) [m] and inertia (3, 3) [kg m^2] about P's origin, in the passive mechanism's axes.
    """

    stiffness: Array
    damping: Array
    body: Array

    @classmethod
    def of(cls, scenarios: Sequence[Scenario]) -> MountDynamics | None:
        """The mounts of scenarios with one mechanism; None if its mount is rigid."""
        if scenarios[0].mechanism.mount is None:
            return None
        mounts = [s.mechanism.mount for s in scenarios if s.mechanism.mount is not None]
        spec = mujoco.MjSpec()
        add_side(spec, scenarios[0].mechanism, PASSIVE, spec.worldbody.add_body(name=MOUNTED))
        body = carried(spec.compile(), MOUNTED)
        return cls(np.array([m.stiffness for m in mounts]), np.array([m.damping for m in mounts]), body)


def borne(scenario: Scenario, reading: Array) -> Array:
    """``(N, 6)`` contact wrench for a ``reading`` (N, 6) of the sensor behind the mount, both in P at P's origin.

    The body on the mount has inertia: w = r + M q'' with r = K q + C q', to first order in the mount's motion q.
    Without a compliant mount they are equal.
    """
    dynamics = MountDynamics.of([scenario])
    if dynamics is None:
        return reading
    stiffness, damping, body, h = dynamics.stiffness[0], dynamics.damping[0], dynamics.body, scenario.tick
    rate = np.empty_like(reading)
    for j in range(6):
        if damping[j] > 0.0:  # q' = (r - K q)/C, r linear over a tick
            stays = math.exp(-stiffness[j] * h / damping[j])
            mean = (1.0 - stays) * damping[j] / (stiffness[j] * h)
            pressed = lfilter([1.0 - mean, mean - stays], [1.0, -stays], reading[:, j])  # K q
            rate[:, j] = (reading[:, j] - pressed) / damping[j]
        else:
            rate[:, j] = np.gradient(reading[:, j], h) / stiffness[j]
    return np.asarray(reading + np.gradient(rate, h, axis=0) @ _inertia(body).T)


def _inertia(body: Array) -> Array:
    """``(6, 6)`` inertia of a body (BODY,) about P's origin: from the rate of a twist (linear, then angular) to force and moment."""
    m, c = body[MASS], body[CENTRE : CENTRE + 3]
    cross = np.array([[0.0, -c[2], c[1]], [c[2], 0.0, -c[0]], [-c[1], c[0], 0.0]])
    return np.block([[m * np.eye(3), -m * cross], [m * cross, body[INERTIA:BODY].reshape(3, 3)]])


MASS, CENTRE, INERTIA, BODY = 0, 1, 4, 13  # start of each part of a body row, and its length
SCRATCH = 17  # scratch rows of 3 that a step of one mount needs


def carried(model: mujoco.MjModel, body: str) -> Array:
    """``(BODY,)`` a body and everything that it carries, as one rigid body, about the body's origin in its axes."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    root = model.body(body).id
    origin, axes = data.xpos[root], data.xmat[root].reshape(3, 3)
    mass, moment, inertia = 0.0, np.zeros(3), np.zeros((3, 3))
    for b in range(model.nbody):
        ancestor = b
        while ancestor not in (0, root):
            ancestor = model.body_parentid[ancestor]
        if ancestor != root:
            continue
        m, r = model.body_mass[b], axes.T @ (data.xipos[b] - origin)
        own = axes.T @ data.ximat[b].reshape(3, 3)
        mass += m
        moment += m * r
        inertia += own @ np.diag(model.body_inertia[b]) @ own.T + m * (r @ r * np.eye(3) - np.outer(r, r))
    return np.concatenate([[mass], moment / mass if mass > 0.0 else moment, inertia.ravel()])


@njit(cache=True)
def _axes(q, axes, turn):
    """``axes`` (3, 3): axis of each hinge as a row, rotated by those before it; ``turn`` (3, 3): the resulting attitude."""
    cx, sx, cy, sy, cz, sz = math.cos(q[3]), math.sin(q[3]), math.cos(q[4]), math.sin(q[4]), math.cos(q[5]), math.sin(q[5])
    axes[0, 0], axes[0, 1], axes[0, 2] = 1.0, 0.0, 0.0
    axes[1, 0], axes[1, 1], axes[1, 2] = 0.0, cx, sx
    axes[2, 0], axes[2, 1], axes[2, 2] = sy, -sx * cy, cx * cy
    turn[0, 0], turn[0, 1], turn[0, 2] = cy * cz, -cy * sz, sy
    turn[1, 0], turn[1, 1], turn[1, 2] = cx * sz + sx * sy * cz, cx * cz - sx * sy * sz, -sx * cy
    turn[2, 0], turn[2, 1], turn[2, 2] = sx * sz - cx * sy * cz, sx * cz + cx * sy * sz, cx * cy


@njit(cache=True)
def mount_step(stiffness, damping, body, dt, wrench, q, qd, work):
    """One step of one mount under ``wrench`` (6,) on the passive side, in W at W's origin: rates first, dampers implicit, as in MuJoCo.

    Newton-Euler equations of the body about the point that the slides carry, projected onto the joints (R. Featherstone, Rigid Body
    Dynamics Algorithms, 2008, chapter 3). ``q``, ``qd`` (6,) are updated; ``work`` (SCRATCH, 3) is scratch.
    """
    axes, turn, inertia, half = work[0:3], work[3:6], work[6:9], work[10:13]
    w, m = work[9], body[MASS]
    _axes(q, axes, turn)
    ax, ay, az = axes[0], axes[1], axes[2]
    for j in range(3):
        w[j] = qd[3] * ax[j] + qd[4] * ay[j] + qd[5] * az[j]
    cx = turn[0, 0] * body[1] + turn[0, 1] * body[2] + turn[0, 2] * body[3]  # centre of mass from the hinges' point
    cy = turn[1, 0] * body[1] + turn[1, 1] * body[2] + turn[1, 2] * body[3]
    cz = turn[2, 0] * body[1] + turn[2, 1] * body[2] + turn[2, 2] * body[3]
    for a in range(3):  # turn times inertia times turn transposed, in two products
        for j in range(3):
            half[a, j] = turn[a, 0] * body[INERTIA + j] + turn[a, 1] * body[INERTIA + 3 + j] + turn[a, 2] * body[INERTIA + 6 + j]
    for a in range(3):
        for b in range(a, 3):
            inertia[a, b] = inertia[b, a] = half[a, 0] * turn[b, 0] + half[a, 1] * turn[b, 1] + half[a, 2] * turn[b, 2]
    # Velocity-dependent part of the angular acceleration, from the rotation of the hinges' axes
    ux, uy, uz = qd[3] * ax[0] + qd[4] * ay[0], qd[3] * ax[1] + qd[4] * ay[1], qd[3] * ax[2] + qd[4] * ay[2]
    bx = qd[4] * qd[3] * (ax[1] * ay[2] - ax[2] * ay[1]) + qd[5] * (uy * az[2] - uz * az[1])
    by = qd[4] * qd[3] * (ax[2] * ay[0] - ax[0] * ay[2]) + qd[5] * (uz * az[0] - ux * az[2])
    bz = qd[4] * qd[3] * (ax[0] * ay[1] - ax[1] * ay[0]) + qd[5] * (ux * az[1] - uy * az[0])
    spin_x = inertia[0, 0] * w[0] + inertia[0, 1] * w[1] + inertia[0, 2] * w[2]
    spin_y = inertia[1, 0] * w[0] + inertia[1, 1] * w[1] + inertia[1, 2] * w[2]
    spin_z = inertia[2, 0] * w[0] + inertia[2, 1] * w[1] + inertia[2, 2] * w[2]
    tx = wrench[3] - (q[1] * wrench[2] - q[2] * wrench[1]) - (w[1] * spin_z - w[2] * spin_y)
    ty = wrench[4] - (q[2] * wrench[0] - q[0] * wrench[2]) - (w[2] * spin_x - w[0] * spin_z)
    tz = wrench[5] - (q[0] * wrench[1] - q[1] * wrench[0]) - (w[0] * spin_y - w[1] * spin_x)
    tx -= inertia[0, 0] * bx + inertia[0, 1] * by + inertia[0, 2] * bz
    ty -= inertia[1, 0] * bx + inertia[1, 1] * by + inertia[1, 2] * bz
    tz -= inertia[2, 0] * bx + inertia[2, 1] * by + inertia[2, 2] * bz
    along = w[0] * cx + w[1] * cy + w[2] * cz
    square = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    fx = wrench[0] - m * (by * cz - bz * cy + w[0] * along - cx * square) - stiffness[0] * q[0] - damping[0] * qd[0]
    fy = wrench[1] - m * (bz * cx - bx * cz + w[1] * along - cy * square) - stiffness[1] * q[1] - damping[1] * qd[1]
    fz = wrench[2] - m * (bx * cy - by * cx + w[2] * along - cz * square) - stiffness[2] * q[2] - damping[2] * qd[2]
    _accelerate(stiffness, damping, m, cx, cy, cz, dt, (fx, fy, fz), (tx, ty, tz), axes, inertia, q, qd, work[13:16], work[16])
    for j in range(6):
        q[j] += dt * qd[j]


@njit(cache=True)
def _accelerate(stiffness, damping, m, cx, cy, cz, dt, force, torque, axes, inertia, q, qd, taken, load):
    """Add ``dt (M + dt C)^-1`` times force (3,) and torque (3,) to the rates; the slides, whose block is diagonal, are eliminated first.

    ``taken`` (3, 3), ``load`` (3,): scratch.
    """
    ix, iy, iz = 1.0 / (m + dt * damping[0]), 1.0 / (m + dt * damping[1]), 1.0 / (m + dt * damping[2])
    fx, fy, fz = force
    tx, ty, tz = torque
    for a in range(3):  # the force that a hinge's acceleration requires, and the load on the hinge
        wx, wy, wz, hinge = axes[a, 0], axes[a, 1], axes[a, 2], 3 + a
        px, py, pz = m * (wy * cz - wz * cy), m * (wz * cx - wx * cz), m * (wx * cy - wy * cx)
        taken[a, 0], taken[a, 1], taken[a, 2] = px, py, pz
        load[a] = wx * tx + wy * ty + wz * tz - stiffness[hinge] * q[hinge] - damping[hinge] * qd[hinge]
        load[a] -= px * ix * fx + py * iy * fy + pz * iz * fz
    d00 = _between(axes[0], axes[0], taken[0], taken[0], inertia, ix, iy, iz) + dt * damping[3]
    d11 = _between(axes[1], axes[1], taken[1], taken[1], inertia, ix, iy, iz) + dt * damping[4]
    d22 = _between(axes[2], axes[2], taken[2], taken[2], inertia, ix, iy, iz) + dt * damping[5]
    d01 = _between(axes[0], axes[1], taken[0], taken[1], inertia, ix, iy, iz)
    d02 = _between(axes[0], axes[2], taken[0], taken[2], inertia, ix, iy, iz)
    d12 = _between(axes[1], axes[2], taken[1], taken[2], inertia, ix, iy, iz)
    s0, s1, s2 = _solved(d00, d01, d02, d11, d12, d22, load[0], load[1], load[2])
    fx -= s0 * taken[0, 0] + s1 * taken[1, 0] + s2 * taken[2, 0]
    fy -= s0 * taken[0, 1] + s1 * taken[1, 1] + s2 * taken[2, 1]
    fz -= s0 * taken[0, 2] + s1 * taken[1, 2] + s2 * taken[2, 2]
    qd[0] += dt * ix * fx
    qd[1] += dt * iy * fy
    qd[2] += dt * iz * fz
    qd[3] += dt * s0
    qd[4] += dt * s1
    qd[5] += dt * s2


@njit(cache=True)
def _between(w, v, p, r, inertia, ix, iy, iz):
    """Entry of the hinges' reduced inertia matrix about ``w`` and ``v`` (3,), whose accelerations require forces ``p`` and ``r`` (3,)."""
    total = -(p[0] * ix * r[0] + p[1] * iy * r[1] + p[2] * iz * r[2])
    for i in range(3):
        total += w[i] * (inertia[i, 0] * v[0] + inertia[i, 1] * v[1] + inertia[i, 2] * v[2])
    return total


@njit(cache=True)
def _solved(a, b, c, d, e, f, u, v, w):
    """Solution of a symmetric positive definite matrix (a b c; b d e; c e f) for the right-hand side (u, v, w)."""
    aa, ab, ac = d * f - e * e, c * e - b * f, b * e - c * d
    dd, de, ff = a * f - c * c, b * c - a * e, a * d - b * b
    scale = 1.0 / (a * aa + b * ab + c * ac)
    return scale * (aa * u + ab * v + ac * w), scale * (ab * u + dd * v + de * w), scale * (ac * u + de * v + ff * w)


@njit(cache=True)
def mount_reading(stiffness, damping, q, qd, out):
    """``out`` (6,): the wrench that the mount transmits to the sensor, in W at W's origin.

    A hinge's torque is the moment's component along its axis; the moment is solved from the three axes, which are not orthogonal.
    """
    for j in range(6):
        out[j] = stiffness[j] * q[j] + damping[j] * qd[j]
    cx, sx, cy, sy = math.cos(q[3]), math.sin(q[3]), math.cos(q[4]), math.sin(q[4])
    across = (out[5] - sy * out[3]) / cy
    out[4], out[5] = cx * out[4] - sx * across, sx * out[4] + cx * across
    out[3] += q[1] * out[2] - q[2] * out[1]
    out[4] += q[2] * out[0] - q[0] * out[2]
    out[5] += q[0] * out[1] - q[1] * out[0]
