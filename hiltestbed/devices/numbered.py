"""Common parts of the protocols that send one numbered pose per cycle: plain records over UDP, and
shared memory.
"""

from __future__ import annotations

import time
from abc import abstractmethod

from hiltestbed.devices.interface import Array, PlatformClient, PlatformServer
from hiltestbed.devices.url import PacedSettings

STOP = 1  # value of the stop field of a command that requests a stop


class NumberedClient(PlatformClient):
    """Sends one pose per cycle, numbered from 1 after :meth:`open`; a hold repeats the last pose, a
    stop is the last pose with a flag, which a layout without one does not have.
    """

    def __init__(self, settings: PacedSettings) -> None:
        super().__init__(settings)
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
        self.hold(STOP)

    def keep(self, held: Array, stop: bool) -> None:
        self._pose[:], self._sent = held[:7], max(self._sent, int(held[7]))
        self.hold(STOP * stop)


class NumberedServer(PlatformServer):
    """Accepts such poses until the stop flag arrives, and numbers the poses that it reports."""

    _number = 0

    @abstractmethod
    def _report(self, pose: Array, number: int, device_time: float, status: int) -> None:
        """Send the pose reached."""

    def _commanded(self, pose: Array, stop: int) -> bool:
        """Process a command; returns whether it is followed."""
        if stop:
            self.stopped = "the client asked for a stop"
        return self.stopped is None and self._obey(pose)

    def publish(self, pose: Array, device_time: float, status: int = 0) -> None:
        self._start(pose)
        self._number += 1
        self.poll()
        self._report(pose, self._number, device_time, status)
