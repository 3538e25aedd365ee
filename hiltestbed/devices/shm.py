"""``shm://name``: shared memory between two processes of one machine, without the network stack.

A device writes a mailbox (:mod:`hiltestbed.devices.mailbox`) with its wrench or pose; a platform
reads a second one with the command. The device creates and removes them.
"""

from __future__ import annotations

import math
import time
from typing import Literal

from pydantic import Field

from hiltestbed.config.validation import Positive
from hiltestbed.devices.interface import (
    Array,
    Clock,
    DeviceError,
    Event,
    PlatformClient,
    PlatformServer,
    Protocol,
    Sample,
    SensorClient,
    SensorServer,
)
from hiltestbed.devices.mailbox import Mailbox, attach, make
from hiltestbed.devices.numbered import NumberedClient, NumberedKeeper, NumberedServer
from hiltestbed.devices.sequence import Sequence
from hiltestbed.devices.url import DeviceSettings
from hiltestbed.errors import InputError

NAP = 20e-6  # [s] between two polls while waiting
Part = Literal["wrench", "state", "command"]


class ShmSettings(DeviceSettings):
    """Options of ``shm://``; the host part of the URL is the name."""

    kind: Literal["shm"] = "shm"
    host: str = Field(
        default="hiltestbed",
        pattern=r"^[a-z0-9][a-z0-9_.-]{0,99}$",
        description="name of the shared memory",
    )
    rate: Positive = Field(default=1000.0, description="rate of the messages [Hz]")
    clock: Literal["device", "host"] = Field(
        default="device", description="what paces the cycle: the device's messages, or the loop"
    )
    connect: Positive = Field(default=2.0, description="time to wait for the device [s]")


def mailbox_name(settings: ShmSettings, part: Part) -> str:
    return f"{settings.host}.{part}"


def _made(settings: ShmSettings, part: Part) -> Mailbox:
    return make(mailbox_name(settings, part), settings.where)


def _awaited(settings: ShmSettings, part: Part) -> Mailbox:
    until = time.monotonic() + settings.connect
    name = mailbox_name(settings, part)
    while (box := attach(name)) is None:
        if time.monotonic() > until:
            raise DeviceError(
                f"{settings.where}: there is no shared memory {name} after {settings.connect:g} "
                f"s; start the device first"
            )
        time.sleep(0.01)
    return box


class _Inbox:
    """Reads one mailbox and counts events."""

    def __init__(self, counts) -> None:
        self.box: Mailbox | None = None
        self.counts = counts
        # no limit: a mailbox keeps only the newest message
        self.sequence = Sequence(counts, bits=63, longest_gap=1 << 61)

    def open(self, box: Mailbox) -> None:
        self.box = box
        box.number = 0
        self.sequence.restart()

    def close(self) -> None:
        if self.box is not None:
            self.box.close()
            self.box = None

    def poll(self) -> bool:
        if self.box is None:
            return False
        found = self.box.read()
        if found is None:
            self.counts[Event.MALFORMED] += 1
        return bool(found) and self.sequence.judge(self.box.number)

    def take(self, sample: Sample) -> bool:
        """Poll, and take a new message into ``sample``."""
        box = self.box
        if box is None or not self.poll():
            return False
        values = box.values[: len(sample.values)]
        return sample.take(values, self.counts, box.number, box.time, box.flag)


def _wait(link: SensorClient | PlatformClient | PlatformServer, timeout: float) -> bool:
    """Poll until there is a message: shared memory has no wake-up."""
    until = time.monotonic() + timeout
    while not link.poll():
        if time.monotonic() >= until:
            return False
        time.sleep(NAP)
    return True


class ShmSensorClient(SensorClient):
    """Reads the wrench that another process writes."""

    def __init__(self, settings: ShmSettings) -> None:
        super().__init__(settings.where)
        self.settings = settings
        self.period = 1.0 / settings.rate
        self.clock = Clock(settings.clock)
        self._inbox = _Inbox(self.counts)

    def open(self) -> None:
        self._inbox.open(_awaited(self.settings, "wrench"))
        _first(self, self.settings)

    def close(self) -> None:
        self._inbox.close()

    def poll(self) -> bool:
        return self._inbox.take(self.reading)

    def wait(self, timeout: float, expected: float = math.inf) -> bool:
        return _wait(self, timeout)


class ShmPlatformClient(NumberedClient):
    """Writes the commanded pose for another process and reads the pose reached."""

    def __init__(self, settings: ShmSettings) -> None:
        super().__init__(settings)
        self.settings = settings
        self._inbox = _Inbox(self.counts)
        self._outbox: Mailbox | None = None

    def open(self) -> None:
        self._inbox.open(_awaited(self.settings, "state"))
        self._outbox = _awaited(self.settings, "command")
        _first(self, self.settings)
        self._begin()

    def close(self) -> None:
        self._inbox.close()
        if self._outbox is not None:
            self._outbox.close()
            self._outbox = None

    def poll(self) -> bool:
        return self._inbox.take(self.state)

    def wait(self, timeout: float, expected: float = math.inf) -> bool:
        return _wait(self, timeout)

    def _post(self, pose: Array, number: int, now: float, stop: int) -> None:
        if self._outbox is not None:
            self._outbox.write(pose, number, now, stop)


def _first(client: ShmSensorClient | ShmPlatformClient, settings: ShmSettings) -> None:
    if not client.wait(settings.connect):
        client.close()
        raise DeviceError(
            f"{settings.where}: the device is there, but has sent nothing in {settings.connect:g} "
            f"s; start its run"
        )


class ShmSensorServer(SensorServer):
    """Writes a wrench for another process."""

    def __init__(self, settings: ShmSettings) -> None:
        super().__init__(settings.where)
        self.settings = settings
        self.period = 1.0 / settings.rate
        self._outbox: Mailbox | None = None
        self._number = 0

    def open(self) -> None:
        self._outbox = _made(self.settings, "wrench")

    def close(self) -> None:
        if self._outbox is not None:
            self._outbox.close()
            self._outbox = None

    def poll(self) -> bool:
        """A sensor receives nothing."""
        return False

    def publish(self, wrench: Array, device_time: float, status: int = 0) -> None:
        self._number += 1
        if self._outbox is not None:
            self._outbox.write(wrench, self._number, device_time, status)


class ShmPlatformServer(NumberedServer):
    """A platform for a loop in another process."""

    def __init__(self, settings: ShmSettings) -> None:
        super().__init__(settings)
        self.settings = settings
        self._inbox = _Inbox(self.counts)
        self._outbox: Mailbox | None = None

    def open(self) -> None:
        self._outbox = _made(self.settings, "state")
        try:
            self._inbox.open(_made(self.settings, "command"))
        except InputError:
            self.close()
            raise

    def close(self) -> None:
        self._inbox.close()
        if self._outbox is not None:
            self._outbox.close()
            self._outbox = None

    def poll(self) -> bool:
        box = self._inbox.box
        return box is not None and self._inbox.poll() and self._commanded(box.values, box.flag)

    def wait(self, timeout: float, expected: float = math.inf) -> bool:
        return _wait(self, timeout)

    def _report(self, pose: Array, number: int, device_time: float, status: int) -> None:
        if self._outbox is not None:
            self._outbox.write(pose, number, device_time, status)


class ShmKeeper(NumberedKeeper):
    """Writes into the command mailbox."""

    def __init__(self, settings: ShmSettings, fileno: int) -> None:
        super().__init__(settings, fileno)
        self._outbox = attach(mailbox_name(settings, "command"))

    def _post(self, pose: Array, number: int, now: float, stop: int) -> None:
        if self._outbox is not None:
            self._outbox.write(pose, number, now, stop)


PROTOCOL = Protocol(
    scheme="shm",
    summary="shared memory between two processes of one machine",
    settings=ShmSettings,
    sensor_client=ShmSensorClient,
    platform_client=ShmPlatformClient,
    sensor_server=ShmSensorServer,
    platform_server=ShmPlatformServer,
    keeper=ShmKeeper,
)
