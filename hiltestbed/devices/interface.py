"""What a device is to the loop: a sensor that is read, a platform that is commanded, and the same two from the device's side.

A *client* is what the loop talks to a real device with; a *server* is the device's side of the same protocol, for an emulated one. All
values are SI: wrench (6,) [N, N m] in the sensor's own frame at its own origin, pose (7,) [m, quaternion x y z w] in the platform's own
base frame. How these frames lie in the rig is the caller's business.

A client takes in what has arrived with :meth:`Client.poll` or :meth:`Client.wait` and keeps the newest good sample. A datagram that is
malformed, from a stranger, repeated or older than the newest leaves the sample as it is and is counted in ``counts``, by
:class:`Event`; so is what the sequence numbers say is missing.
"""

from __future__ import annotations

import math
import select
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from hiltestbed.errors import HiltestbedError

if TYPE_CHECKING:
    from hiltestbed.devices.url import DeviceSettings

Array = NDArray[np.float64]

LONGEST_DRAIN = 256  # datagrams taken in at a time: a flood must not hold the loop up


class DeviceError(HiltestbedError):
    """A device does not answer, or refuses what it was asked; the message says which, and what to look at."""


class Event(IntEnum):
    """What can happen to a record; the index into ``counts``."""

    RECEIVED = 0  # good records taken in
    LATE = 1  # a cycle without a new record, or an answer that missed its cycle
    LOST = 2  # gaps in the sequence; one that turns up later is counted as reordered besides
    REPEATED = 3  # the newest once more, or a device whose own sample counter stands still
    REORDERED = 4  # older than the newest
    STALE = 5  # cycles that went on with a sample older than allowed
    MALFORMED = 6  # not a record of this protocol
    STATUS = 7  # the device reports an error
    SENDER = 8  # from another address than the device's
    GONE = 9  # the connection was refused or closed


class Clock(StrEnum):
    """Who paces the cycle: ``device`` sends at its own rate and expects the answer within the period; ``host`` is paced by the loop."""

    DEVICE = "device"
    HOST = "host"


class Sample:
    """The newest good record of a device, updated in place.

    Attributes:
        sequence: the device's own number of the record; -1 before the first.
        device_time: by the device's clock [s]; NaN where the protocol has none.
        status: the device's status, 0 when it is well.
        arrival: when it was taken in, monotonic clock [ns].
    """

    def __init__(self) -> None:
        self.sequence = -1
        self.device_time = math.nan
        self.status = 0
        self.arrival = 0

    def age(self) -> float:
        """Time since it was taken in [s]; infinite before the first."""
        return (time.monotonic_ns() - self.arrival) * 1e-9 if self.sequence >= 0 else math.inf


class Reading(Sample):
    """A sample of a force sensor: ``wrench`` (6,) [N, N m] in the sensor's frame."""

    def __init__(self) -> None:
        super().__init__()
        self.wrench: Array = np.zeros(6)


class PoseState(Sample):
    """A sample of a platform: the pose (7,) that it has reached, in its base frame."""

    def __init__(self) -> None:
        super().__init__()
        self.pose: Array = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


class Link(ABC):
    """One end of a connection, closed at the end of a ``with`` block.

    Attributes:
        where: the device as the user named it, for messages.
        counts: (10,) how often each :class:`Event` has happened since :meth:`open`.
        period: time between two records or cycles [s]; NaN until it is known.
    """

    def __init__(self, where: str) -> None:
        self.where = where
        self.counts: NDArray[np.int64] = np.zeros(len(Event), dtype=np.int64)
        self.period = math.nan

    @abstractmethod
    def open(self) -> None:
        """Connect. Raises InputError where the address cannot be used, DeviceError where the device does not answer."""

    @abstractmethod
    def close(self) -> None:
        """Disconnect; may be called twice."""

    @abstractmethod
    def poll(self) -> bool:
        """Take in what has arrived, without waiting. True when there was something new."""

    def wait(self, timeout: float) -> bool:
        """The same, waiting for at most ``timeout`` [s]."""
        until = time.monotonic() + timeout
        while not self.poll():
            left = until - time.monotonic()
            if left <= 0.0 or self.fileno() < 0:
                return False
            select.select([self.fileno()], [], [], left)
        return True

    def fileno(self) -> int:
        """The socket that is waited for, and that the watchdog takes over; -1 where there is none."""
        return -1

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class SensorClient(Link):
    """The loop's side of a force sensor; ``reading`` is its newest good record, and its records pace the cycle where nothing else does."""

    def __init__(self, where: str) -> None:
        super().__init__(where)
        self.reading = Reading()

    @property
    def sample(self) -> Sample:
        return self.reading

    def bias(self) -> None:
        """Have the device take its present load for zero, where the protocol can. Raises DeviceError where it cannot."""
        raise DeviceError(f"{self.where}: this protocol cannot tare the sensor; tare in the loop instead")


class PlatformClient(Link):
    """The loop's side of a motion platform; ``state`` is the newest pose that it says it has reached.

    Attributes:
        clock: who paces the cycle.
        held: (8,) what the keeper of the watchdog needs to hold the platform where it was last commanded; protocol's own layout.
    """

    def __init__(self, where: str) -> None:
        super().__init__(where)
        self.clock = Clock.HOST
        self.state = PoseState()
        self.held: Array = np.zeros(8)

    @property
    def sample(self) -> Sample:
        return self.state

    @abstractmethod
    def command(self, pose: Array) -> None:
        """Send the pose (7,) to be reached by the end of the cycle. Raises DeviceError for one that is not finite, and holds."""

    @abstractmethod
    def hold(self) -> None:
        """Stay where it was last commanded (before the first command: where it was found)."""

    def stop(self) -> None:
        """Have the device itself stop, where the protocol has a message for it; otherwise hold."""
        self.hold()

    def _check(self, pose: Array) -> None:
        if not np.isfinite(pose).all():
            self.hold()
            raise DeviceError(f"{self.where}: a pose that is not finite was commanded ({pose}); the platform holds its last pose")


class SensorServer(Link):
    """The device's side of a force sensor."""

    @abstractmethod
    def publish(self, wrench: Array, device_time: float, status: int = 0) -> None:
        """Send the wrench (6,) of this instant to whoever listens, with the device's time [s] and status (0: well)."""


class PlatformServer(Link):
    """The device's side of a motion platform.

    Attributes:
        command: (7,) the pose last commanded in time; the start pose before the first.
        commanded: whether there has been a command since the first pose was published.
        stopped: why the platform stopped by itself, as its protocol has it stop; None while it runs.
    """

    def __init__(self, where: str) -> None:
        super().__init__(where)
        self.command: Array = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
        self.commanded = False
        self.stopped: str | None = None

    @abstractmethod
    def publish(self, pose: Array, device_time: float, status: int = 0) -> None:
        """Open a cycle: send the pose (7,) reached at this instant, with the device's time [s] and status (0: well)."""


class Keeper(ABC):
    """What the watchdog holds or stops a platform with, from its own process, when the loop's has fallen silent."""

    def __init__(self, settings: DeviceSettings, fileno: int) -> None:
        self.settings = settings
        self.fileno = fileno

    @abstractmethod
    def hold(self, held: Array) -> None:
        """One message that keeps the platform where ``held`` (8,) of its client says; called once a period."""

    @abstractmethod
    def stop(self, held: Array) -> None:
        """One message that stops the platform, or the silence that does."""


@dataclass(frozen=True)
class Protocol:
    """A protocol as the table knows it; a part that it does not have is None."""

    scheme: str
    summary: str
    settings: type[DeviceSettings]
    sensor_client: type[SensorClient] | None = None
    platform_client: type[PlatformClient] | None = None
    sensor_server: type[SensorServer] | None = None
    platform_server: type[PlatformServer] | None = None
    keeper: type[Keeper] | None = None
