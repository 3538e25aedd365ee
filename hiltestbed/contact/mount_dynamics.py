"""A compliant mount in closed form, integrated as MuJoCo does: for a replay, which does not step
the rig.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from scipy.signal import lfilter

from hiltestbed.compiled.jit import njit
from hiltestbed.contact.composition import PASSIVE, add_side
from hiltestbed.contact.mount import MOUNTED
from hiltestbed.contact.parameters import mounts_of
from hiltestbed.frames import Array, add_moment, sin_cos

if TYPE_CHECKING:
    from hiltestbed.contact.settings import Mechanism


@dataclass(frozen=True)
class MountDynamics:
    """The mounts of R runs, integrated as in MuJoCo: six joints and one rigid body whose weight is
    balanced at its centre of mass.

    Attributes:
        stiffness, damping: (R, 6) [N/m, N m/rad; N s/m, N m s/rad].
        body: (BODY,) mass [kg], centre of mass (3,) [m] and inertia (3, 3) [kg m^2] about P's
            origin, in the passive mechanism's axes.
    """

    stiffness: Array
    damping: Array
    body: Array

    @classmethod
    def of(cls, mechanisms: Sequence[Mechanism]) -> MountDynamics | None:
        """The mounts of mechanisms of one shape; None if they are rigid."""
        springs = mounts_of(mechanisms)
        if springs is None:
            return None
        spec = mujoco.MjSpec()
        add_side(spec, mechanisms[0], PASSIVE, spec.worldbody.add_body(name=MOUNTED))
        return cls(*springs, carried(spec.compile()))

    @cached_property
    def mobility(self) -> tuple[float, float]:
        """Most that a force accelerates the origin [1/kg], and a moment turns it [1/(kg m^2)]."""
        inverse = np.linalg.inv(_inertia(self.body))
        return float(np.linalg.norm(inverse[:3, :3], 2)), float(np.linalg.norm(inverse[3:, 3:], 2))

    def slowest(self) -> float:
        """[s] of the slowest mode of M q'' + C q' + K q = 0, of all runs; inf without damping."""
        m, out = _inertia(self.body), 0.0
        for stiffness, damping in zip(self.stiffness, self.damping, strict=True):
            rates = np.linalg.solve(m, np.hstack([-np.diag(stiffness), -np.diag(damping)]))
            slowest = -np.linalg.eigvals(np.vstack([np.eye(6, 12, 6), rates])).real.max()
            out = max(out, 1.0 / slowest if slowest > 0.0 else math.inf)
        return out


def borne(mechanism: Mechanism, tick: float, reading: Array) -> Array:
    """``(N, 6)`` contact wrench for a ``reading`` (N, 6) of the sensor behind the mount, both in P
    at P's origin, one row per ``tick`` [s].

    The body on the mount has inertia: w = r + M q'' with r = K q + C q', to first order in the
        mount's motion q. Without a compliant mount they are equal.
    """
    dynamics = MountDynamics.of([mechanism])
    if dynamics is None:
        return reading
    stiffness, damping, h = dynamics.stiffness[0], dynamics.damping[0], tick
    rate = np.empty_like(reading)
    for j in range(6):
        if damping[j] > 0.0:  # q' = (r - K q)/C, r linear over a tick
            stays = math.exp(-stiffness[j] * h / damping[j])
            mean = (1.0 - stays) * damping[j] / (stiffness[j] * h)
            pressed = lfilter([1.0 - mean, mean - stays], [1.0, -stays], reading[:, j])  # K q
            rate[:, j] = (reading[:, j] - pressed) / damping[j]
        else:
            rate[:, j] = np.gradient(reading[:, j], h) / stiffness[j]
    return np.asarray(reading + np.gradient(rate, h, axis=0) @ _inertia(dynamics.body).T)


def _inertia(body: Array) -> Array:
    """``(6, 6)`` inertia of a body (BODY,) about P's origin; linear first."""
    m, c = body[MASS], body[CENTRE : CENTRE + 3]
    cross = np.array([[0.0, -c[2], c[1]], [c[2], 0.0, -c[0]], [-c[1], c[0], 0.0]])
    return np.block([[m * np.eye(3), -m * cross], [m * cross, body[INERTIA:BODY].reshape(3, 3)]])


MASS, CENTRE, INERTIA, BODY = 0, 1, 4, 13  # start of each part of a body row, and its length


def carried(model: mujoco.MjModel) -> Array:
    """``(BODY,)`` all bodies of a model as one, about the origin."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    mass, moment, inertia = 0.0, np.zeros(3), np.zeros((3, 3))
    for b in range(1, model.nbody):
        m, r, own = model.body_mass[b], data.xipos[b], data.ximat[b].reshape(3, 3)
        mass += m
        moment += m * r
        inertia += own @ np.diag(model.body_inertia[b]) @ own.T + m * (
            r @ r * np.eye(3) - np.outer(r, r)
        )
    return np.concatenate([[mass], moment / mass if mass > 0.0 else moment, inertia.ravel()])


@njit(cache=True)
def mount_step(stiffness, damping, body, kick, drift, leapfrog, wrench, q, qd):
    """One step of one mount under ``wrench`` (6,) on the passive side, in W at W's origin: rates
    first, by ``kick`` [s], then ``drift`` [s] of the joints with them. As in MuJoCo, both are the
    step, and dampers are implicit.

    ``leapfrog``: the rates are those of the middle of the steps before and after, and dampers take
        their mean: second order (L. Verlet, Phys. Rev. 159, 1967) instead of first. Newton-Euler
        equations of the body about the point that the slides carry, projected onto the joints (R.
        Featherstone, Rigid Body Dynamics Algorithms, 2008, chapter 3). ``q``, ``qd`` (6,) are
        updated. Scalars throughout, which stay in registers.
    """
    m, q0, q1, q2 = body[MASS], q[0], q[1], q[2]
    # [s] by which the dampers' rate is that after the step
    ahead = 0.5 * kick if leapfrog else kick
    v0, v1, v2, r0, r1, r2 = qd[0], qd[1], qd[2], qd[3], qd[4], qd[5]
    (s0, c0), (s1, c1), (s2, c2) = sin_cos(q[3]), sin_cos(q[4]), sin_cos(q[5])
    # Axes of the hinges, rotated by those before: (1, 0, 0), (0, c0, s0) and (zx, zy, zz); the
    # attitude; the angular velocity
    zx, zy, zz = s1, -s0 * c1, c0 * c1
    t00, t01, t10, t11 = c1 * c2, -c1 * s2, c0 * s2 + s0 * s1 * c2, c0 * c2 - s0 * s1 * s2
    t20, t21 = s0 * s2 - c0 * s1 * c2, s0 * c2 + c0 * s1 * s2
    ux, uy, uz = r0, r1 * c0, r1 * s0  # of the second hinge's frame
    wx, wy, wz = ux + r2 * zx, uy + r2 * zy, uz + r2 * zz
    x, y, z = body[CENTRE], body[CENTRE + 1], body[CENTRE + 2]
    # centre of mass from the hinges' point
    cx, cy, cz = t00 * x + t01 * y + zx * z, t10 * x + t11 * y + zy * z, t20 * x + t21 * y + zz * z
    i00, i01, i02 = body[INERTIA], body[INERTIA + 1], body[INERTIA + 2]
    i10, i11, i12 = body[INERTIA + 3], body[INERTIA + 4], body[INERTIA + 5]
    i20, i21, i22 = body[INERTIA + 6], body[INERTIA + 7], body[INERTIA + 8]
    h00 = t00 * i00 + t01 * i10 + zx * i20
    h01 = t00 * i01 + t01 * i11 + zx * i21
    h02 = t00 * i02 + t01 * i12 + zx * i22
    h10 = t10 * i00 + t11 * i10 + zy * i20
    h11 = t10 * i01 + t11 * i11 + zy * i21
    h12 = t10 * i02 + t11 * i12 + zy * i22
    h20 = t20 * i00 + t21 * i10 + zz * i20
    h21 = t20 * i01 + t21 * i11 + zz * i21
    h22 = t20 * i02 + t21 * i12 + zz * i22
    xx = h00 * t00 + h01 * t01 + h02 * zx
    xy = h00 * t10 + h01 * t11 + h02 * zy
    xz = h00 * t20 + h01 * t21 + h02 * zz
    yy = h10 * t10 + h11 * t11 + h12 * zy
    yz = h10 * t20 + h11 * t21 + h12 * zz
    izz = h20 * t20 + h21 * t21 + h22 * zz
    # Velocity-dependent part of the angular acceleration, from the rotation of the hinges' axes
    bx = r2 * (uy * zz - uz * zy)
    by = r2 * (uz * zx - ux * zz) - r0 * r1 * s0
    bz = r2 * (ux * zy - uy * zx) + r0 * r1 * c0
    lx = xx * wx + xy * wy + xz * wz
    ly = xy * wx + yy * wy + yz * wz
    lz = xz * wx + yz * wy + izz * wz
    w0, w1, w2 = wrench[0], wrench[1], wrench[2]
    tx = wrench[3] - (q1 * w2 - q2 * w1) - (wy * lz - wz * ly) - (xx * bx + xy * by + xz * bz)
    ty = wrench[4] - (q2 * w0 - q0 * w2) - (wz * lx - wx * lz) - (xy * bx + yy * by + yz * bz)
    tz = wrench[5] - (q0 * w1 - q1 * w0) - (wx * ly - wy * lx) - (xz * bx + yz * by + izz * bz)
    along, square = wx * cx + wy * cy + wz * cz, wx * wx + wy * wy + wz * wz
    fx = w0 - m * (by * cz - bz * cy + wx * along - cx * square)
    fy = w1 - m * (bz * cx - bx * cz + wy * along - cy * square)
    fz = w2 - m * (bx * cy - by * cx + wz * along - cz * square)
    fx = fx - stiffness[0] * q0 - damping[0] * v0
    fy = fy - stiffness[1] * q1 - damping[1] * v1
    fz = fz - stiffness[2] * q2 - damping[2] * v2
    # (M + ahead C)^-1 times force and torque: the slides, of a diagonal block, are eliminated; p:
    # forces that a hinge's acceleration needs
    ix = 1.0 / (m + ahead * damping[0])
    iy = 1.0 / (m + ahead * damping[1])
    iz = 1.0 / (m + ahead * damping[2])
    p01, p02 = -m * cz, m * cy
    p10, p11, p12 = m * (c0 * cz - s0 * cy), m * s0 * cx, -m * c0 * cx
    p20, p21, p22 = m * (zy * cz - zz * cy), m * (zz * cx - zx * cz), m * (zx * cy - zy * cx)
    gx, gy, gz = ix * fx, iy * fy, iz * fz
    a0 = tx - stiffness[3] * q[3] - damping[3] * r0 - p01 * gy - p02 * gz
    a1 = c0 * ty + s0 * tz - stiffness[4] * q[4] - damping[4] * r1 - p10 * gx - p11 * gy - p12 * gz
    a2 = zx * tx + zy * ty + zz * tz - stiffness[5] * q[5] - damping[5] * r2
    a2 = a2 - p20 * gx - p21 * gy - p22 * gz
    # inertia times the second axis, and the third
    jx, jy, jz = xy * c0 + xz * s0, yy * c0 + yz * s0, yz * c0 + izz * s0
    kx = xx * zx + xy * zy + xz * zz
    ky = xy * zx + yy * zy + yz * zz
    kz = xz * zx + yz * zy + izz * zz
    d00 = xx - (p01 * iy * p01 + p02 * iz * p02) + ahead * damping[3]
    d01 = jx - (p01 * iy * p11 + p02 * iz * p12)
    d02 = kx - (p01 * iy * p21 + p02 * iz * p22)
    d11 = c0 * jy + s0 * jz - (p10 * ix * p10 + p11 * iy * p11 + p12 * iz * p12)
    d12 = c0 * ky + s0 * kz - (p10 * ix * p20 + p11 * iy * p21 + p12 * iz * p22)
    d22 = zx * kx + zy * ky + zz * kz - (p20 * ix * p20 + p21 * iy * p21 + p22 * iz * p22)
    d11, d22 = d11 + ahead * damping[4], d22 + ahead * damping[5]
    # the positive definite (d00 d01 d02; d01 d11 d12; d02 d12 d22) is inverted by its cofactors
    b00, b01, b02 = d11 * d22 - d12 * d12, d02 * d12 - d01 * d22, d01 * d12 - d02 * d11
    b11, b12, b22 = d00 * d22 - d02 * d02, d02 * d01 - d00 * d12, d00 * d11 - d01 * d01
    scale = 1.0 / (d00 * b00 + d01 * b01 + d02 * b02)
    a0, a1, a2 = (
        scale * (b00 * a0 + b01 * a1 + b02 * a2),
        scale * (b01 * a0 + b11 * a1 + b12 * a2),
        scale * (b02 * a0 + b12 * a1 + b22 * a2),
    )
    qd[0] = v0 + kick * ix * (fx - (a1 * p10 + a2 * p20))
    qd[1] = v1 + kick * iy * (fy - (a0 * p01 + a1 * p11 + a2 * p21))
    qd[2] = v2 + kick * iz * (fz - (a0 * p02 + a1 * p12 + a2 * p22))
    qd[3] = r0 + kick * a0
    qd[4] = r1 + kick * a1
    qd[5] = r2 + kick * a2
    for j in range(6):
        q[j] += drift * qd[j]


@njit(cache=True)
def mount_reading(stiffness, damping, q, qd, out):
    """``out`` (6,): the wrench that the mount transmits to the sensor, in W at W's origin.

    A hinge's torque is the moment's component along its axis; the moment is solved from the three
    axes, which are not orthogonal.
    """
    for j in range(6):
        out[j] = stiffness[j] * q[j] + damping[j] * qd[j]
    (sx, cx), (sy, cy) = sin_cos(q[3]), sin_cos(q[4])
    across = (out[5] - sy * out[3]) / cy
    out[4], out[5] = cx * out[4] - sx * across, sx * out[4] + cx * across
    add_moment(1.0, q, out)
