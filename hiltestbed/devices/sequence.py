"""Numbers of records: evaluation of a device's numbers (new, lost, repeated, reordered or
implausible), and the numbered poses that plain records over UDP and shared memory send per cycle.

The one rule of all protocols: a record is news only if its number is ahead of the newest before it.
"""

from __future__ import annotations

import time
from abc import abstractmethod

from numpy.typing import NDArray

from hiltestbed.devices.interface import Array, Event, PlatformClient, PlatformServer
from hiltestbed.devices.url import PacedSettings

STOP = 1  # value of the stop field of a command that requests a stop


def ahead_of(number: float, other: float, bits: int) -> float:
    """How far ``number`` is ahead of ``other``, negative: behind, on a counter of ``bits`` that
    wraps (serial number arithmetic, RFC 1982), or for 0 bits on one that does not.
    """
    half = 1 << bits >> 1
    return (number - other + half) % (2 * half) - half if half else number - other


class Advancing:
    """A counter that has to advance with each record, by whatever amount: a device's own sample
    number, or its time.
    """

    def __init__(self, counts: NDArray, bits: int) -> None:
        """``bits`` of the counter, which wraps; 0: it does not."""
        self._counts, self._bits = counts, bits
        self._newest: float | None = None

    def restart(self) -> None:
        """Accept any number next."""
        self._newest = None

    def judge(self, number: float) -> bool:
        """Whether ``number`` is ahead of all before; anything else is counted."""
        ahead = 1 if self._newest is None else ahead_of(number, self._newest, self._bits)
        if ahead <= 0:
            self._counts[Event.REORDERED if ahead else Event.REPEATED] += 1
            return False
        self._newest = number
        return True


class Sequence:
    """Follows a wrapping counter; ``newest`` number, unwrapped, -1 before the first."""

    def __init__(
        self, counts: NDArray, bits: int = 32, step: int = 1, longest_gap: int = 10_000
    ) -> None:
        """``longest_gap``: number of records that may be missing at once. A larger step ahead is
        implausible (malformed), unless the next record continues from it: then the reader has
        paused (RFC 3550, appendix A.1). A step back is never news, however large.
        """
        self._counts = counts
        self._bits = bits
        self._step = step
        self._longest = longest_gap * step
        self.newest = -1
        self._wrapped = 0
        self._resumed = -1  # the number that would continue from the last implausible one

    def restart(self) -> None:
        """Accept any number next: the device restarts its counter."""
        self.newest = self._resumed = -1

    def judge(self, number: int) -> bool:
        """Whether ``number`` is newer than all before; anything else is counted."""
        if not 0 <= number < 1 << self._bits:
            self._counts[Event.MALFORMED] += 1
            return False
        if self.newest < 0:
            self.newest = self._wrapped = number
            return True
        ahead = int(ahead_of(number, self._wrapped, self._bits))
        resumed = number == self._resumed
        if ahead == 0:
            self._counts[Event.REPEATED] += 1
        elif -self._longest <= ahead < 0:
            self._counts[Event.REORDERED] += 1
        elif ahead < 0 or ahead % self._step:
            self._counts[Event.MALFORMED] += 1
        elif ahead <= self._longest or resumed:
            # of a reader that has paused, the previous record did arrive, but was rejected
            missing = ahead // self._step - 1 - (resumed and ahead > self._longest)
            self._counts[Event.LOST] += missing
            self.newest += ahead
            self._wrapped = number
            return True
        else:
            self._counts[Event.MALFORMED] += 1
            self._resumed = (number + self._step) % (1 << self._bits)
        return False


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
    def _report(self, pose: Array, number: int, device_time: float) -> None:
        """Send the pose reached."""

    def _commanded(self, pose: Array, stop: int) -> bool:
        """Process a command; returns whether it is followed."""
        if stop:
            self.stopped = "the client asked for a stop"
        return self.stopped is None and self._obey(pose)

    def publish(self, pose: Array, device_time: float) -> None:
        self._start(pose)
        self._number += 1
        self.poll()
        self._report(pose, self._number, device_time)
