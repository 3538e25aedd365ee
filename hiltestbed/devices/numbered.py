"""Common parts of the protocols that send one numbered pose per cycle: plain records over UDP, and
shared memory.
"""

from __future__ import annotations

import math
import time
from abc import abstractmethod
from typing import Literal, Protocol

from hiltestbed.devices.interface import Array, Clock, Keeper, PlatformClient, PlatformServer
from hiltestbed.devices.url import DeviceSettings

STOP = 1  # value of the stop field of a command that requests a stop


class Paced(Protocol):
    """Settings of such a protocol."""

    where: str
    rate: float
    clock: Literal["device", "host"]


class NumberedClient(PlatformClient):
    """Sends one pose per cycle, numbered from 1 after :meth:`open`; a hold repeats the last pose, a
    stop is the last pose with a flag.
    """

    def __init__(self, settings: Paced) -> None:
        super().__init__(settings.where)
        self.clock = Clock(settings.clock)
        self.period = 1.0 / settings.rate
        self._pose: Array = self.state.pose.copy()
        self._sent = 0

    @abstractmethod
    def _post(self, pose: Array, number: int, now: float, stop: int) -> None:
        """Send a command; ``now`` [s] by the monotonic clock."""

    def _begin(self) -> None:
        """Command the pose that the platform reports."""
        self._sent = 0
        self._pose[:] = self.state.pose
        self.hold()

    def command(self, pose: Array) -> None:
        self._check(pose)
        self._pose[:] = pose
        self.hold()

    def hold(self, stop: int = 0) -> None:
        self._sent += 1
        self.held[:7], self.held[7] = self._pose, self._sent
        self._post(self._pose, self._sent, time.monotonic_ns() * 1e-9, stop)

    def stop(self) -> None:
        """Send the stop flag; a layout without one holds."""
        self.hold(STOP)


class NumberedServer(PlatformServer):
    """Accepts such poses until the stop flag arrives, and numbers the poses that it reports."""

    def __init__(self, settings: Paced) -> None:
        super().__init__(settings.where)
        self.period = 1.0 / settings.rate
        self._number = 0

    @abstractmethod
    def _report(self, pose: Array, number: int, device_time: float, status: int) -> None:
        """Send the pose reached."""

    def _commanded(self, pose: Array, stop: int) -> bool:
        """Process a command; returns whether it is followed."""
        if stop:
            self.stopped = "the client asked for a stop"
        return self.stopped is None and self._obey(pose)

    def publish(self, pose: Array, device_time: float, status: int = 0) -> None:
        if self._number == 0:
            self.command[:] = pose
        self._number += 1
        self.poll()
        self._report(pose, self._number, device_time, status)


class NumberedKeeper(Keeper):
    """Repeats the last pose, or sends it with the stop flag; the numbering continues from the last
    command.
    """

    def __init__(self, settings: DeviceSettings, fileno: int) -> None:
        super().__init__(settings, fileno)
        self._sent = 0

    @abstractmethod
    def _post(self, pose: Array, number: int, now: float, stop: int) -> None:
        """Send a command; ``now`` [s] by the monotonic clock."""

    def hold(self, held: Array, stop: int = 0) -> None:
        self._sent += 1
        if math.isfinite(float(held.sum())):
            self._post(held[:7], int(held[7]) + self._sent, time.monotonic_ns() * 1e-9, stop)

    def stop(self, held: Array) -> None:
        self.hold(held, STOP)
