"""Motions of the platform before and after a run: to its start, from rest to the approach velocity,
from any velocity to rest.

All follow the fifth-order polynomial whose velocity and acceleration vanish at both ends (T. Flash,
N. Hogan, J. Neurosci. 5, 1985: minimum jerk).
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hiltestbed.frames import Array, pose_step, twist_between

PEAK = 1.875  # largest velocity of the polynomial over its mean


def blend(x: float) -> float:
    """From 0 to 1 as ``x`` goes from 0 to 1, starting and ending at rest."""
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))


def blend_integral(x: float) -> float:
    """The integral of :func:`blend` from 0 to ``x``; 1/2 at 1."""
    return x**4 * (2.5 + x * (x - 3.0))


def travel(start: Array, goal: Array, tick: float, speed: float, rate: float) -> Iterator[Array]:
    """Poses (7,), one per tick, from rest at ``start`` to rest at ``goal``, no faster than
    ``speed`` [m/s] and ``rate`` [rad/s].
    """
    way = np.empty(6)
    twist_between(start, goal, 1.0, way)
    longest = max(float(np.linalg.norm(way[:3])) / speed, float(np.linalg.norm(way[3:])) / rate)
    ticks = math.ceil(PEAK * longest / tick)
    for k in range(1, ticks + 1):
        yield _stepped(start, way, blend(k / ticks))


def run_up(pose: Array, twist: Array, tick: float, duration: float) -> Iterator[Array]:
    """Poses (7,) from rest to ``pose`` with ``twist`` (6,), accelerating over ``duration`` [s]; the
    first is the pose at rest.
    """
    ticks = max(math.ceil(duration / tick), 1)
    for k in range(ticks + 1):
        yield _stepped(pose, twist, ticks * tick * (blend_integral(k / ticks) - 0.5))


def run_down(pose: Array, twist: Array, tick: float, duration: float) -> Iterator[Array]:
    """Poses (7,) from ``pose`` with ``twist`` (6,) to rest, over ``duration`` [s]."""
    ticks = max(math.ceil(duration / tick), 1)
    for k in range(1, ticks + 1):
        yield _stepped(pose, twist, ticks * tick * (k / ticks - blend_integral(k / ticks)))


def _stepped(pose: Array, twist: Array, time: float) -> Array:
    out = np.empty(7)
    pose_step(np.ascontiguousarray(pose), np.ascontiguousarray(twist), time, out)
    return out
