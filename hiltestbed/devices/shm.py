"""``shm://name``: shared memory between two processes of one machine, without the network stack.

A device writes a mailbox (:mod:`hiltestbed.devices.mailbox`) with its wrench or pose; a platform reads a second one with the command. The
device creates and removes them.
"""

from __future__ import annotations

import math
import time
from typing import Literal

from pydantic import Field

from hiltestbed.devices.interface import (
    Array,
    Clock,
    DeviceError,
    Event,
    Keeper,
    PlatformClient,
    PlatformServer,
    Protocol,
    Sample,
    SensorClient,
    SensorServer,
)
from hiltestbed.devices.mailbox import Mailbox, attach, make
from hiltestbed.devices.sequence import Sequence
from hiltestbed.devices.url import DeviceSettings
from hiltestbed.errors import InputError
from hiltestbed.validation import Positive

NAP = 20e-6  # [s] between two polls while waiting
STOP = 1
Part = Literal["wrench", "state", "command"]


class ShmSettings(DeviceSettings):
    """Options of ``shm://``; the host is the name."""

    kind: Literal["shm"] = "shm"
    host: str = Field(default="hiltestbed", pattern=r"^[a-z0-9][a-z0-9_.-]{0,99}$", description="name of the shared memory")
    rate: Positive = Field(default=1000.0, description="messages a second [Hz]")
    clock: Literal["device", "host"] = Field(default="device", description="who paces the cycle: the device's messages, or the loop")
    connect: Positive = Field(default=2.0, description="[s] to wait for the device")


def mailbox_name(settings: ShmSettings, part: Part) -> str:
    return f"{settings.host}.{part}"


def _made(settings: ShmSettings, part: Part) -> Mailbox:
    return make(mailbox_name(settings, part), settings.where)


def _awaited(settings: ShmSettings, part: Part) -> Mailbox:
    until = time.monotonic() + settings.connect
    name = mailbox_name(settings, part)
    while (box := attach(name)) is None:
        if time.monotonic() > until:
            raise DeviceError(f"{settings.where}: there is no shared memory {name} after {settings.connect:g} s; start the device first")
        time.sleep(0.01)
    return box


class _Inbox:
    """Reads one mailbox and counts events."""

    def __init__(self, counts) -> None:
        self.box: Mailbox | None = None
        self.counts = counts
        self.sequence = Sequence(counts, bits=63)

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

    def note(self, sample: Sample) -> bool:
        if self.box is None:
            return False
        sample.status = self.box.flag
        if self.box.flag:
            self.counts[Event.STATUS] += 1
            return False
        self.counts[Event.RECEIVED] += 1
        sample.sequence, sample.device_time, sample.arrival = self.box.number, self.box.time, time.monotonic_ns()
        return True


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
        self._inbox = _Inbox(self.counts)

    def open(self) -> None:
        self._inbox.open(_awaited(self.settings, "wrench"))
        _first(self, self.settings)

    def close(self) -> None:
        self._inbox.close()

    def poll(self) -> bool:
        if not self._inbox.poll() or not self._inbox.note(self.reading):
            return False
        self.reading.wrench[:] = self._inbox.box.values[:6]  # type: ignore[union-attr]
        return True

    def wait(self, timeout: float, expected: float = math.inf) -> bool:
        return _wait(self, timeout)


class ShmPlatformClient(PlatformClient):
    """Writes the commanded pose for another process and reads the pose reached."""

    def __init__(self, settings: ShmSettings) -> None:
        super().__init__(settings.where)
        self.settings = settings
        self.clock = Clock(settings.clock)
        self.period = 1.0 / settings.rate
        self._inbox = _Inbox(self.counts)
        self._outbox: Mailbox | None = None
        self._pose: Array = self.state.pose.copy()
        self._sent = 0

    def open(self) -> None:
        self._inbox.open(_awaited(self.settings, "state"))
        self._outbox = _awaited(self.settings, "command")
        self._sent = 0
        _first(self, self.settings)
        self._pose[:] = self.state.pose
        self.hold()

    def close(self) -> None:
        self._inbox.close()
        if self._outbox is not None:
            self._outbox.close()
            self._outbox = None

    def poll(self) -> bool:
        if not self._inbox.poll() or not self._inbox.note(self.state):
            return False
        self.state.pose[:] = self._inbox.box.values  # type: ignore[union-attr]
        return True

    def wait(self, timeout: float, expected: float = math.inf) -> bool:
        return _wait(self, timeout)

    def command(self, pose: Array) -> None:
        self._check(pose)
        self._pose[:] = pose
        self.hold()

    def hold(self) -> None:
        self._send(0)

    def stop(self) -> None:
        self._send(STOP)

    def _send(self, stop: int) -> None:
        self._sent += 1
        self.held[:7], self.held[7] = self._pose, self._sent
        if self._outbox is not None:
            self._outbox.write(self._pose, self._sent, time.monotonic_ns() * 1e-9, stop)


def _first(client: ShmSensorClient | ShmPlatformClient, settings: ShmSettings) -> None:
    if not client.wait(settings.connect):
        client.close()
        raise DeviceError(f"{settings.where}: the device is there, but has sent nothing in {settings.connect:g} s; start its run")


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


class ShmPlatformServer(PlatformServer):
    """A platform in another process."""

    def __init__(self, settings: ShmSettings) -> None:
        super().__init__(settings.where)
        self.settings = settings
        self.period = 1.0 / settings.rate
        self._inbox = _Inbox(self.counts)
        self._outbox: Mailbox | None = None
        self._number = 0

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
        if not self._inbox.poll() or self._inbox.box is None:
            return False
        if self._inbox.box.flag:
            self.stopped = "the client asked for a stop"
        if self.stopped is not None:
            return False
        self.counts[Event.RECEIVED] += 1
        self.command[:] = self._inbox.box.values
        self.commanded = True
        return True

    def wait(self, timeout: float, expected: float = math.inf) -> bool:
        return _wait(self, timeout)

    def publish(self, pose: Array, device_time: float, status: int = 0) -> None:
        if self._number == 0:
            self.command[:] = pose
        self._number += 1
        self.poll()
        if self._outbox is not None:
            self._outbox.write(pose, self._number, device_time, status)


class ShmKeeper(Keeper):
    """Writes the last pose, or the stop flag, into the command mailbox."""

    def __init__(self, settings: ShmSettings, fileno: int) -> None:
        super().__init__(settings, fileno)
        self._outbox = attach(mailbox_name(settings, "command"))
        self._sent = 0

    def hold(self, held: Array) -> None:
        self._send(held, 0)

    def stop(self, held: Array) -> None:
        self._send(held, STOP)

    def _send(self, held: Array, stop: int) -> None:
        self._sent += 1
        if self._outbox is not None and math.isfinite(float(held.sum())):
            self._outbox.write(held[:7], int(held[7]) + self._sent, time.monotonic_ns() * 1e-9, stop)


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
