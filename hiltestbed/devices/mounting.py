"""Mounting of sensor and platform: conversions between the devices' own frames and the rig's."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hiltestbed.devices.section import Devices
from hiltestbed.frames import (
    Array,
    pose_between,
    pose_compose,
    quat_from_attitude_deg,
    wrench_moved,
)

_IDENTITY = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def placed(position: Sequence[float], attitude_deg: Sequence[float]) -> Array:
    """Pose (7,) of a position [m] and an attitude [deg]."""
    return np.concatenate([position, quat_from_attitude_deg(attitude_deg)])


def inverted(pose: Array) -> Array:
    """The pose (7,) of P in A, from that of A in P."""
    out = np.empty(7)
    pose_between(pose, np.array(_IDENTITY), out)
    return out


class Mounting:
    """Conversions for one sensor and one platform; all arrays are one-dimensional, results are
    written to ``out``.
    """

    def __init__(self, devices: Devices) -> None:
        sensor, platform = devices.sensor, devices.platform
        self._pose_PS = placed(sensor.position, sensor.attitude_deg)
        self._pose_SP = inverted(self._pose_PS)
        self._sign = float(sensor.sign)
        self._pose_PB = placed(platform.base.position, platform.base.attitude_deg)
        self._pose_BP = inverted(self._pose_PB)
        self._pose_TA = placed(platform.tool.position, platform.tool.attitude_deg)
        self._pose_AT = inverted(self._pose_TA)
        self._wrench, self._pose = np.empty(6), np.empty(7)
        self.wrench_in_P(np.zeros(6), np.empty(6))  # compile now, not in the first cycle
        self.command_of(np.array(_IDENTITY), np.empty(7))
        self.pose_in_P(np.array(_IDENTITY), np.empty(7))

    def wrench_in_P(self, reading: Array, out: Array) -> None:
        """Convert the sensor's reading (6,) to the wrench of A on P, in P at P's origin."""
        wrench_moved(self._pose_PS, reading, out)
        out *= self._sign

    def wrench_shown(self, wrench_P: Array, out: Array) -> None:
        """The inverse of :meth:`wrench_in_P`: the sensor's reading (6,) of ``wrench_P``."""
        wrench_moved(self._pose_SP, wrench_P, out)
        out *= self._sign

    def pose_in_P(self, pose_BT: Array, out: Array) -> None:
        """The pose of A in P (7,) when the platform reports ``pose_BT``."""
        pose_compose(self._pose_PB, pose_BT, self._pose)
        pose_compose(self._pose, self._pose_TA, out)

    def command_of(self, pose_PA: Array, out: Array) -> None:
        """The inverse of :meth:`pose_in_P`: the pose (7,) to command for A at ``pose_PA``."""
        pose_compose(self._pose_BP, pose_PA, self._pose)
        pose_compose(self._pose, self._pose_AT, out)
