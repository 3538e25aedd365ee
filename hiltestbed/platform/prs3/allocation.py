"""Redundancy resolution of the nine axes: allocation of the relative pose to the upper and the
lower platform.

The upper platform's pose is a function of the relative pose alone, so that a closed path of the
relative pose is a closed path of the
rig, and the lower platform provides the exact remainder: its pose in W is that of P times the
relative one. With the gap g = -pz and

    w(g) = smooth step from 0 at DOCKING to 1 at DOCKING + BLEND, twice continuously differentiable

the upper platform's heave u has du/dg = w and its tilt is the fraction w of the relative tilt, up
to the limit prs3.TILT. So

- within DOCKING of the touch it stays at home, and the lower platform moves alone;
- beyond DOCKING + BLEND it follows the gap metre for metre, and the lower platform rests DOCKING +
  BLEND/2 below its home;
- near the end of its heave, prs3.HEAVE, it comes to rest in the same way.

At a speed v its acceleration stays below MOST_BENT v^2/BLEND.
"""

from __future__ import annotations

import math

import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array, pose_compose, rotation_vector
from hiltestbed.platform.prs3.geometry import HEAVE, TILT, Upper, place

# [m] the cone's rim is 0.155 m in front of P's origin; the rest takes 0.1 s at 0.3 m/s, enough time
# to come to rest
DOCKING = 0.19
BLEND = 0.10  # [m] the lower platform then rests 0.24 m below home, just within its reach
MOST_BENT = 1.875  # largest slope of the smooth step: 15/8
LONGEST = DOCKING + HEAVE  # [m] gap up to which the upper platform follows metre for metre


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
