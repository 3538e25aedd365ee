"""The interface of a device: sensor and platform, client and server side.

A *client* is the loop's side of the connection to a real device, a *server* the device's side of
the same protocol, for an emulated one. All values are SI: wrench (6,) [N, N m] in the sensor's own
frame at its own origin, pose (7,) [m, quaternion x y z w] in the platform's own base frame. The
caller knows the poses of these frames in the rig.

A client processes what has arrived with :meth:`Link.poll` or :meth:`Link.wait` and keeps the newest
good sample. A record that is malformed, from an unexpected sender, repeated or older than the
newest does not change the sample; it is counted by :class:`Event`, as are gaps in the numbers.
"""

from __future__ import annotations

import math
import select
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from hiltestbed.devices.url import DeviceSettings, PacedSettings
from hiltestbed.errors import HiltestbedError

Array = NDArray[np.float64]

# [s] of busy waiting around an instant; an ordinary kernel oversleeps by about as much
SPIN = 150e-6
LONGEST_DRAIN = 256  # datagrams processed per poll: a flood must not stall the loop
# [N], [N m] and [m] beyond which no value is physical, whatever the scenario: some hundred times
# the range of the largest force sensors, and more than any hall
LARGEST_LOAD, FARTHEST = 1.0e7, 1.0e3
# tolerance of a quaternion's length: 32-bit numbers deviate by 1e-7, wrong bytes by more
UNIT_LENGTH = 1e-2


class DeviceError(HiltestbedError):
    """A device does not answer or refuses a request; the message says which, and what to check."""


class Event(IntEnum):
    """Communication events; the index into ``counts``."""

    RECEIVED = 0  # good records accepted
    LATE = 1  # cycles without a new record, and answers that missed their cycle
    LOST = 2  # missing sequence numbers; a record that arrives later is also counted as reordered
    REPEATED = 3  # the newest record again, or a device whose own sample counter does not advance
    REORDERED = 4  # older than the newest
    STALE = 5  # cycles in which the newest sample was older than allowed
    MALFORMED = 6  # not a record of this protocol, or one with values that are not physical
    STATUS = 7  # the device reports an error
    SENDER = 8  # from an address other than the device's
    GONE = 9  # the connection was refused or closed


class Sample:
    """The newest good record of a device, updated in place."""

    def __init__(self, values: Array, largest: Array) -> None:
        self.values, self.largest = values, largest  # in SI; largest physical magnitude of each
        self.implausible: str | None = None  # the last values that were refused, for messages
        self.sequence = -1  # the device's own number of the record; -1 before the first
        self.device_time = math.nan  # [s] by the device's clock; NaN if the protocol has none
        self.status = 0  # of the device; 0: no error
        self.arrival = 0  # [ns] by the monotonic clock

    def take(
        self,
        values: Array,
        counts: NDArray[np.int64],
        sequence: int,
        device_time: float,
        status: int = 0,
    ) -> bool:
        """Take in a new record; False, and only counted: an error status, or not physical."""
        self.status = status
        if status:
            counts[Event.STATUS] += 1
            return False
        within = np.abs(values) <= self.largest  # false for NaN as well
        if not within.all():
            counts[Event.MALFORMED] += 1
            i = int(np.argmin(within))
            self.implausible = (
                f"value {i + 1} of {len(values)} is {values[i]:.4g}, which is not physical here "
                f"(largest magnitude {self.largest[i]:.4g}, SI)"
            )
            return False
        counts[Event.RECEIVED] += 1
        self.values[:] = values
        self.sequence, self.device_time = sequence, device_time
        self.arrival = time.monotonic_ns()
        return True

    def age(self) -> float:
        """Time since it was received [s]; infinite before the first."""
        return (time.monotonic_ns() - self.arrival) * 1e-9 if self.sequence >= 0 else math.inf


class Reading(Sample):
    """A sample of a force sensor: ``wrench`` (6,) [N, N m] in the sensor's frame."""

    def __init__(self) -> None:
        self.wrench: Array = np.zeros(6)
        super().__init__(self.wrench, np.full(6, LARGEST_LOAD))


class PoseState(Sample):
    """A sample of a platform: the pose (7,) that it has reached, in its base frame."""

    def __init__(self) -> None:
        self.pose: Array = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
        super().__init__(self.pose, np.repeat([FARTHEST, 1.0 + UNIT_LENGTH], [3, 4]))


class Link(ABC):
    """One end of a connection; a context manager that opens and closes it.

    Attributes:
        where: the device as the user specified it, for messages.
        counts: (10,) number of each :class:`Event` since :meth:`open`.
        period: time between two records or cycles [s]; NaN until it is known.
        step: increment of the sequence number from one record to the next.
    """

    step = 1

    def __init__(self, settings: DeviceSettings) -> None:
        self.settings = settings
        self.where, self.period = settings.where, settings.period
        self.counts: NDArray[np.int64] = np.zeros(len(Event), dtype=np.int64)

    @abstractmethod
    def open(self) -> None:
        """Connect. Raises InputError for the address, DeviceError if the device does not answer."""

    @abstractmethod
    def close(self) -> None:
        """Disconnect; may be called twice."""

    @abstractmethod
    def poll(self) -> bool:
        """Process what has arrived, without waiting. True if there was a new good record."""

    def wait(self, timeout: float, expected: float = math.inf) -> bool:
        """As :meth:`poll`, but wait up to ``timeout`` [s] for a new record.

        Around the time at which one is ``expected`` ([s] from now) the wait is busy, since a
        sleeping thread wakes up late.
        """
        begin = time.monotonic()
        until = begin + timeout
        busy_from, busy_to = begin + expected - SPIN, begin + expected + SPIN
        while not self.poll():
            now = time.monotonic()
            if now >= until or self.fileno() < 0:
                return False
            if not busy_from <= now < busy_to:
                end = min(until, busy_from) if now < busy_from else until
                select.select([self.fileno()], [], [], end - now)
        return True

    def fileno(self) -> int:
        """The file descriptor to wait on, which the watchdog duplicates; -1 if there is none."""
        return -1

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Client(Link):
    """The loop's side of a device.

    Attributes:
        sample: the newest good record.
        clock: who paces the cycle, the device, which expects an answer within its period, or the
            loop; that of the platform precedes that of the sensor.
    """

    sample: Sample

    def __init__(self, settings: DeviceSettings) -> None:
        super().__init__(settings)
        paced = isinstance(settings, PacedSettings)
        self.clock: Literal["device", "host"] = settings.clock if paced else "device"


class SensorClient(Client):
    """The loop's side of a force sensor; ``reading`` is its newest good record."""

    def __init__(self, settings: DeviceSettings) -> None:
        super().__init__(settings)
        self.sample = self.reading = Reading()


class PlatformClient(Client):
    """The loop's side of a motion platform; ``state`` is the newest pose that it reports.

    :meth:`open` commands nothing but the pose that the platform reports.

    Attributes:
        held: (8,) the last command, in the form that :meth:`keep` repeats.
    """

    def __init__(self, settings: DeviceSettings) -> None:
        super().__init__(settings)
        self.sample = self.state = PoseState()
        self.held: Array = np.zeros(8)

    @abstractmethod
    def command(self, pose: Array) -> None:
        """Send the pose (7,) for the end of the cycle; hold, raise DeviceError if not finite."""

    @abstractmethod
    def hold(self) -> None:
        """Repeat the last command; before the first one, the pose found at :meth:`open`."""

    def stop(self) -> None:
        """Make the device stop by itself if the protocol supports it; otherwise hold."""
        self.hold()

    def adopt(self, fileno: int) -> None:
        """In the watchdog's process, instead of :meth:`open`: use the duplicated ``fileno`` of the
        loop's connection. Raises DeviceError if the protocol cannot.
        """
        raise DeviceError(f"{self.where}: this protocol cannot be held by another process")

    def keep(self, held: Array, stop: bool) -> None:
        """After :meth:`adopt`, once per period: hold ``held`` (8,) of the loop's client, or stop;
        nothing if silence does that.
        """

    def _check(self, pose: Array) -> None:
        if not np.isfinite(pose).all():
            self.hold()
            raise DeviceError(
                f"{self.where}: a pose that is not finite was commanded ({pose}); the platform "
                f"holds its last pose"
            )


class SensorServer(Link):
    """The device's side of a force sensor."""

    @abstractmethod
    def publish(self, wrench: Array, device_time: float) -> None:
        """Send the wrench (6,) of this instant with the device's time [s]."""


class PlatformServer(Link):
    """The device's side of a motion platform.

    Attributes:
        command: (7,) the pose last commanded in time; the start pose before the first.
        commanded: whether there has been a command since the first pose was published.
        stopped: why the platform has stopped by itself; None while it runs.
    """

    def __init__(self, settings: DeviceSettings) -> None:
        super().__init__(settings)
        self._commands = PoseState()
        self.command: Array = self._commands.pose
        self.commanded = self._started = False
        self.stopped: str | None = None

    def _start(self, pose: Array) -> None:
        """The pose (7,) that is published first is held until there is a command."""
        if not self._started:
            self.command[:] = pose
            self._started = True

    def _obey(self, pose: Array) -> bool:
        """Follow a commanded pose (7,); one that is not physical is counted and not followed."""
        taken = self._commands.take(pose, self.counts, 0, math.nan)
        self.commanded = self.commanded or taken
        return taken

    @abstractmethod
    def publish(self, pose: Array, device_time: float) -> None:
        """Begin a cycle: send the pose (7,) reached now and the device's time [s]."""


@dataclass(frozen=True)
class Protocol:
    """An entry of the table of protocols; None for a role that the protocol does not have."""

    scheme: str
    summary: str
    settings: type[DeviceSettings]
    sensor_client: type[SensorClient] | None = None
    platform_client: type[PlatformClient] | None = None
    sensor_server: type[SensorServer] | None = None
    platform_server: type[PlatformServer] | None = None
