"""Kinematics of the upper platform, a 3-PRS mechanism: three vertical sliders, each with a link on
a revolute joint that keeps it in the vertical plane through the platform's axis, and spherical
joints at the platform.

It has three degrees of freedom, here ``x = (u, rx, ry)``: the heave u [m] of the anchors' centre
and the rotation vector (rx, ry, 0) [rad], 0 at home. Each anchor stays in its leg's plane, so that
the platform does not twist about the axis (zero torsion: Bonev, Zlatanov, Gosselin, 2002) and its
centre moves sideways as it tilts by theta towards alpha, for legs at phi, phi + 120, phi + 240 deg
and anchors on the radius r, the parasitic motion

    c_x = r/2 (1 - cos theta) cos(2 alpha - 3 phi),   c_y = -r/2 (1 - cos theta) sin(2 alpha - 3
    phi)

with alpha the direction of the tilt's axis. The quotients are computed as series in theta^2: at 0.3
rad, far beyond the tilt limit, they are accurate to 1e-13.

Redundancy resolution of the nine axes: the platform's pose is a function of the relative pose
alone, so that a closed path of the relative pose is a closed path of the rig, and the lower
platform provides the exact remainder: its pose in W is that of P times the relative one. With the
gap g = -pz and

    w(g) = smooth step from 0 at DOCKING to 1 at DOCKING + BLEND, twice continuously differentiable

the upper platform's heave u has du/dg = w and its tilt is the fraction w of the relative tilt, up
to the limit TILT. So

- within DOCKING of the touch it stays at home, and the lower platform moves alone;
- beyond DOCKING + BLEND it follows the gap metre for metre, and the lower platform rests DOCKING +
  BLEND/2 below its home;
- near the end of its heave, HEAVE, it comes to rest in the same way.

At a speed v its acceleration stays below MOST_BENT v^2/BLEND.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import mujoco
import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.config.models import load
from hiltestbed.frames import Array, pose_compose, quat_exp, rotate, rotation_vector
from hiltestbed.platform.facilities.facility import NOMINAL
from hiltestbed.platform.facilities.kinematics import Axis
from hiltestbed.platform.facilities.limbs import LimbKinematics, limbs_of

HEAVE = 2.0  # [m] from home upwards
TILT = math.radians(2.5)  # [rad] in any direction; reason: models/prs3/README.md
RADIUS, ABOVE, COS3, SIN3 = range(4)
# [m] the cone's rim is 0.155 m in front of P's origin; the rest takes 0.1 s at 0.3 m/s, enough time
# to come to rest
DOCKING = 0.19
BLEND = 0.10  # [m] the lower platform then rests 0.24 m below home, just within its reach
MOST_BENT = 1.875  # largest slope of the smooth step: 15/8
LONGEST = DOCKING + HEAVE  # [m] gap up to which the upper platform follows metre for metre


@njit(cache=True)
def _series(t):
    """(1 - cos)/theta^2, its derivative in theta^2, (theta - sin)/theta^3, for t = theta^2."""
    k = 0.5 - t * (1.0 / 24.0 - t * (1.0 / 720.0 - t * (1.0 / 40320.0 - t / 3628800.0)))
    dk = -1.0 / 24.0 + t * (1.0 / 360.0 - t * (1.0 / 13440.0 - t / 907200.0))
    b = 1.0 / 6.0 - t * (1.0 / 120.0 - t * (1.0 / 5040.0 - t / 362880.0))
    return k, dk, b


@njit(cache=True)
def place(shape, x, pose):
    """``pose`` (7,) of P in W at the coordinates ``x`` (3,); ``shape`` (4,) of the mechanism."""
    turn, arm = np.empty(3), np.empty(3)
    turn[0], turn[1], turn[2] = x[1], x[2], 0.0
    quat_exp(turn, pose[3:7])
    k, _, _ = _series(x[1] * x[1] + x[2] * x[2])
    even, odd = k * (x[1] * x[1] - x[2] * x[2]), 2.0 * k * x[1] * x[2]
    arm[0] = arm[1] = 0.0
    arm[2] = -shape[ABOVE]
    rotate(pose[3:7], arm, arm)
    pose[0] = 0.5 * shape[RADIUS] * (even * shape[COS3] + odd * shape[SIN3]) + arm[0]
    pose[1] = -0.5 * shape[RADIUS] * (odd * shape[COS3] - even * shape[SIN3]) + arm[1]
    pose[2] = x[0] + shape[ABOVE] + arm[2]


@njit(cache=True)
def motion(shape, x, out):
    """``out`` (6, 3): twist of P in W [m/s, rad/s] for each coordinate's rate, at ``x`` (3,)."""
    rx, ry = x[1], x[2]
    k, dk, b = _series(rx * rx + ry * ry)
    turn, q, arm = np.empty(3), np.empty(4), np.empty(3)
    turn[0], turn[1], turn[2] = rx, ry, 0.0
    quat_exp(turn, q)
    arm[0] = arm[1] = 0.0
    arm[2] = -shape[ABOVE]
    rotate(q, arm, arm)
    out[:] = 0.0
    out[2, 0] = 1.0
    half = 0.5 * shape[RADIUS]
    for j in range(2):
        e0, e1 = (1.0, 0.0) if j == 0 else (0.0, 1.0)
        dt = 2.0 * (rx * e0 + ry * e1)
        even = dk * dt * (rx * rx - ry * ry) + 2.0 * k * (rx * e0 - ry * e1)
        odd = 2.0 * dk * dt * rx * ry + 2.0 * k * (ry * e0 + rx * e1)
        # angular velocity e + k (r x e) + b r x (r x e), with r x e along z
        z = rx * e1 - ry * e0
        wx, wy, wz = e0 + b * ry * z, e1 - b * rx * z, k * z
        out[0, 1 + j] = half * (even * shape[COS3] + odd * shape[SIN3]) + wy * arm[2] - wz * arm[1]
        out[1, 1 + j] = -half * (odd * shape[COS3] - even * shape[SIN3]) + wz * arm[0] - wx * arm[2]
        out[2, 1 + j] = wx * arm[1] - wy * arm[0]
        out[3, 1 + j], out[4, 1 + j], out[5, 1 + j] = wx, wy, wz


class Upper(NamedTuple):
    """The upper platform's constants, read from its MJCF at home.

    Attributes:
        shape: (4,) radius of the anchors, height of their plane above P [m], cosine and sine of 3
            phi.
        limbs: (3, 10) as in :func:`hiltestbed.platform.facilities.limbs.slider`.
    """

    shape: Array
    limbs: Array

    @staticmethod
    @cache
    def load() -> Upper:
        """The 3-PRS platform of ``models/prs3``; P's home is W's origin."""
        limbs = limbs_of(load("prs3/prs3").compile(), np.zeros(3))
        x, y, above = limbs[0, 6:9]
        phi = math.atan2(y, x)
        shape = math.hypot(x, y), above, math.cos(3.0 * phi), math.sin(3.0 * phi)
        return Upper(np.array(shape), limbs)


def upper_kinematics(m: mujoco.MjModel, prefix: str = "") -> LimbKinematics:
    """Geometry of the upper platform in a model, with the ``prefix`` of its names."""
    axes = []
    for j in range(3):
        low, high = m.joint(f"{prefix}slider_{j}").range
        axes.append(Axis(f"{prefix}slider_{j}", "m", low, high, math.inf, math.inf, math.inf))
    return LimbKinematics(m, NOMINAL, axes, np.zeros(3), prefix)


@njit(cache=True)
def _step(x):
    """Smooth step, 0 for x <= 0 and 1 for x >= 1."""
    x = min(max(x, 0.0), 1.0)
    return x * x * x * (10.0 - x * (15.0 - 6.0 * x))


@njit(cache=True)
def _ramp(x):
    """Integral of the smooth step from 0."""
    if x >= 1.0:
        return x - 0.5
    x = max(x, 0.0)
    return x * x * x * x * (2.5 - x * (3.0 - x))


@njit(cache=True)
def share(pose, x):
    """``x`` (3,), (u, rx, ry) for the relative ``pose`` (7,); unchanged if not finite."""
    gap = -pose[2]
    if not math.isfinite(pose[0] + pose[1] + gap + pose[3] + pose[4] + pose[5] + pose[6]):
        return
    turn = np.empty(3)
    near = (gap - DOCKING) / BLEND
    x[0] = BLEND * (_ramp(near) - _ramp(near - HEAVE / BLEND))
    rotation_vector(pose[3:7], turn)
    part = -_step(near)
    wanted = math.hypot(turn[0], turn[1]) * abs(part)
    if wanted > 1e-12:
        part *= TILT * math.tanh(wanted / TILT) / wanted
    x[1], x[2] = part * turn[0], part * turn[1]


def lower_pose(pose: Array) -> Array:
    """``(n, 7)`` poses of A in W on the lower platform for the relative poses ``(n, 7)``."""
    x, pose_WP, out = np.zeros(3), np.empty(7), np.empty_like(pose)
    for i in range(len(pose)):
        share(pose[i], x)
        place(Upper.load().shape, x, pose_WP)
        pose_compose(pose_WP, pose[i], out[i])
    return out


def upper_coordinates(pose: Array) -> Array:
    """``(n, 3)`` heave [m] and tilt [rad] of the upper platform for relative poses ``(n, 7)``."""
    out = np.zeros((len(pose), 3))
    for i in range(len(pose)):
        share(pose[i], out[i])
    return out
