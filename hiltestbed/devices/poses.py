"""Poses in the conventions of robot manufacturers.

KUKA: X Y Z [mm] and A B C [deg], rotations about z, the new y, and the new x: R = Rz(A) Ry(B) Rx(C)
(KUKA System Software operating and programming instructions, "coordinate systems"). Universal
Robots: x y z [m] and the rotation vector rx ry rz [rad] (URScript manual, "pose").
"""

from __future__ import annotations

import math

import numpy as np

from hiltestbed.devices.interface import Array
from hiltestbed.frames import (
    attitude_deg_from_quat,
    quat_exp,
    quat_from_attitude_deg,
    rotation_vector,
)

# [rad] longest rotation vector: two turns; controllers give at most one
LONGEST_TURN = 4.0 * math.pi


def pose_from_kuka(frame: Array) -> Array:
    """Pose (7,) of X Y Z A B C (6,) [mm, deg]."""
    x, y, z, a, b, c = map(float, frame)
    return np.array([1e-3 * x, 1e-3 * y, 1e-3 * z, *quat_from_attitude_deg([c, b, a])])


def kuka_from_pose(pose: Array) -> Array:
    """X Y Z A B C (6,) [mm, deg] of a pose (7,); at B = +-90 deg C is 0 and A is the whole
    rotation.
    """
    position = [float(value) / 1e-3 for value in pose[:3]]
    return np.array([*position, *attitude_deg_from_quat(pose[3:7])[::-1]])


def pose_from_rotation_vector(frame: Array) -> Array:
    """Pose (7,) of x y z rx ry rz (6,) [m, rad]; NaN for a rotation of more than two turns, which
    is no rotation of a tool.
    """
    pose = np.full(7, np.nan)
    pose[:3] = frame[:3]
    if not math.hypot(*frame[3:6].tolist()) <= LONGEST_TURN:
        return pose
    quat_exp(np.ascontiguousarray(frame[3:6], dtype=float), pose[3:7])
    return pose


def rotation_vector_from_pose(pose: Array) -> Array:
    """x y z rx ry rz (6,) [m, rad] of a pose (7,), with a rotation of at most pi."""
    frame = np.empty(6)
    frame[:3] = pose[:3]
    rotation_vector(pose[3:7], frame[3:6])
    return frame


def compile_now() -> None:
    """Compile what is used here, so that the first cycle need not."""
    pose = pose_from_kuka(kuka_from_pose(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])))
    pose_from_rotation_vector(rotation_vector_from_pose(pose))
