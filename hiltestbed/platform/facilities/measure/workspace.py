"""Reach of a facility from home, along and about each axis of A, and what limits it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hiltestbed.frames import Array, pose_step
from hiltestbed.platform.facilities.drives import Drives
from hiltestbed.platform.facilities.facility import UPRIGHT, Facility
from hiltestbed.platform.facilities.kinematics import AXES
from hiltestbed.platform.facilities.stand import Stand

STRIDE = (0.02, math.radians(1.0))  # [m], [rad] between two poses that are checked
FURTHEST = (3.0, math.radians(180.0))
HALVINGS = 6  # of the last stride: to 0.3 mm and 0.02 deg


@dataclass(frozen=True)
class Reach:
    """Reach from home along one axis.

    Attributes:
        axis: x, y, z, rx, ry, rz. low, high: [m, rad]. stops: what limits it below and above; empty
            at the end of the search range.
    """

    axis: str
    low: float
    high: float
    stops: tuple[str, str]


def workspace(facility: Facility) -> tuple[Reach, ...]:
    """The reach of A from home, axis by axis: up to travel, a singularity or the reach."""
    drives = Stand(facility).drives
    out = []
    for k, axis in enumerate(AXES):
        ends = [_walk(drives, k, sign) for sign in (-1.0, 1.0)]
        out.append(Reach(axis, -ends[0][0], ends[1][0], (ends[0][1], ends[1][1])))
    return tuple(out)


def _walk(drives: Drives, k: int, sign: float) -> tuple[float, str]:
    """Distance that A can move from home in one direction, and what limits it."""
    stride, most = STRIDE[k // 3], FURTHEST[k // 3]
    reached, far, q, why = 0.0, stride, drives.kinematics.home.copy(), ""
    while far <= most and not why:
        why, q_next = _look(drives, k, sign * far, q)
        if not why:
            reached, q, far = far, q_next, far + stride
    if not why:
        return reached, ""
    for _ in range(HALVINGS):
        middle = 0.5 * (reached + far)
        found, q_next = _look(drives, k, sign * middle, q)
        if found:
            far, why = middle, found
        else:
            reached, q = middle, q_next
    return reached, why


def _look(drives: Drives, k: int, shift: float, q: Array) -> tuple[str, Array]:
    """Why A cannot be at ``shift`` on axis ``k`` (empty: it can), and the joints, from ``q``."""
    step, pose = np.zeros(6), np.empty((1, 7))
    step[k] = shift
    pose_step(UPRIGHT, step, 1.0, pose[0])
    drives.allocate(pose, np.zeros((1, 6)), np.zeros((1, 6)), 0.0)
    kinematics = drives.kinematics
    solved, left = kinematics.solve(drives.poses[0], drives.held[0], q)
    if not left < 1e-7:
        return "out of reach", q
    past = kinematics.past_travel(solved)
    if past:
        return past[0], q
    lost = kinematics.lost_motion(solved)
    return (f"singular: {lost}", q) if lost else ("", solved)
