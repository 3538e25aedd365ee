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
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import mujoco
import numpy as np

from hiltestbed.compiled.jit import interpreted, njit
from hiltestbed.frames import Array, quat_exp, rotate
from hiltestbed.platform import model

HEAVE = 2.0  # [m] from home upwards
TILT = math.radians(2.5)  # [rad] in any direction; reason: models/prs3/README.md
RADIUS, ABOVE, COS3, SIN3 = range(4)


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


@njit(cache=True)
def slider(leg, pose, arm):
    """Slider position [m] of one leg at the pose ``(7,)`` of P in W; ``arm`` (3,) becomes the
    anchor from P's origin, in W.

    ``leg`` (7,): foot of the link at home (3) in W, anchor (3) in P, length of the link. The link
    hangs below its slider.
    """
    rotate(pose[3:7], leg[3:6], arm)
    dx, dy = pose[0] + arm[0] - leg[0], pose[1] + arm[1] - leg[1]
    return pose[2] + arm[2] - leg[2] + math.sqrt(max(leg[6] * leg[6] - dx * dx - dy * dy, 0.0))


def inverse(legs, poses, sliders):
    """``sliders`` (n, 3) [m] at the poses ``(n, 7)`` of P in W."""
    arm = np.empty(3)
    for i in range(poses.shape[0]):
        for j in range(3):
            sliders[i, j] = slider(legs[j], poses[i], arm)


@njit(cache=True)
def jacobian(legs, pose, sliders, out):
    """``out`` (3, 6): slider rates from the twist of P in W; ``sliders`` (3,) become those of the
    pose.

    With d the vector along the link, d.(v + w x arm) = d_z s'.
    """
    arm, d = np.empty(3), np.empty(3)
    for j in range(3):
        sliders[j] = slider(legs[j], pose, arm)
        for c in range(3):
            d[c] = pose[c] + arm[c] - legs[j, c]
        d[2] -= sliders[j]
        for c in range(3):
            out[j, c] = d[c] / d[2]
        out[j, 3] = (arm[1] * d[2] - arm[2] * d[1]) / d[2]
        out[j, 4] = (arm[2] * d[0] - arm[0] * d[2]) / d[2]
        out[j, 5] = (arm[0] * d[1] - arm[1] * d[0]) / d[2]


def revolute(leg, pose, arm):
    """Angle [rad] of the leg's revolute joint, 0 at home; ``arm`` (3,) is overwritten."""
    s = slider(leg, pose, arm)
    outward = math.hypot(leg[0], leg[1])
    inward = (
        -(leg[0] * (pose[0] + arm[0] - leg[0]) + leg[1] * (pose[1] + arm[1] - leg[1])) / outward
    )
    down = leg[2] + s - pose[2] - arm[2]
    anchor = math.hypot(leg[3], leg[4])
    at_home = math.atan2(math.sqrt(leg[6] * leg[6] - (outward - anchor) ** 2), outward - anchor)
    return at_home - math.atan2(down, inward)


class Upper(NamedTuple):
    """The upper platform's constants, read from its MJCF at home.

    Attributes:
        shape: (4,) radius of the anchors, height of their plane above P [m], cosine and sine of 3
            phi.
        legs: (3, 7) a leg's constants, as in :func:`slider`.
    """

    shape: Array
    legs: Array

    @staticmethod
    @cache
    def load() -> Upper:
        """The 3-PRS platform of ``models/prs3``; P's home is W's origin."""
        m = model.load("prs3/prs3").compile()
        data = mujoco.MjData(m)
        mujoco.mj_kinematics(m, data)
        legs = np.empty((3, 7))
        for j in range(3):
            legs[j, 0:3] = data.body(f"link_{j}").xpos
            legs[j, 3:6] = data.site(f"anchor_{j}").xpos
            legs[j, 6] = np.linalg.norm(legs[j, 3:6] - legs[j, 0:3])
        x, y, above = legs[0, 3:6]
        phi = math.atan2(y, x)
        return Upper(
            np.array([math.hypot(x, y), above, math.cos(3.0 * phi), math.sin(3.0 * phi)]), legs
        )


def write_joints(m: mujoco.MjModel, pose: Array, q: Array, prefix: str = "") -> None:
    """Write the platform's joint positions at the ``pose`` (7,) of P in W to ``q`` (nq,)."""
    upper, arm = Upper.load(), np.empty(3)
    for j, leg in enumerate(upper.legs):
        q[m.joint(f"{prefix}slider_{j}").qposadr[0]] = interpreted(slider)(leg, pose, arm)
        q[m.joint(f"{prefix}revolute_{j}").qposadr[0]] = interpreted(revolute)(leg, pose, arm)
    rotate(pose[3:7], np.array([0.0, 0.0, upper.shape[ABOVE]]), arm)
    free = int(m.joint(f"{prefix}platform").qposadr[0])
    q[free : free + 3] = pose[:3] + arm
    q[free + 3 : free + 7] = pose[[6, 3, 4, 5]]
