"""``udp://``: plain records over UDP, as Simulink, LabVIEW, Speedgoat and the like send them.

Their layout is described in YAML: :mod:`hiltestbed.devices.layout`.

The URL's address is the device's: it takes commands there and sends its records from there. ``listen`` is this machine's end, where the
records arrive; an emulated device has ``peer`` instead, the controller's end.
"""

from __future__ import annotations

import math
import socket
import time
from collections.abc import Callable
from typing import ClassVar, Literal

from pydantic import Field

from hiltestbed.devices import sockets
from hiltestbed.devices.interface import (
    LONGEST_DRAIN,
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
from hiltestbed.devices.layout import LARGEST, Layout, Record, default_layout, read_layout
from hiltestbed.devices.sequence import Sequence
from hiltestbed.devices.url import LOOPBACK, DeviceSettings
from hiltestbed.errors import Fault, InputError
from hiltestbed.validation import Positive

STOP = 1  # in the stop field of a command
RecordKind = Literal["sensor", "state", "command"]


class UdpSettings(DeviceSettings):
    """Options of ``udp://``."""

    default_port: ClassVar[int] = 5005

    kind: Literal["udp"] = "udp"
    layout: str | None = Field(default=None, description="YAML file that describes the records; the default layout where it is not given")
    listen: str | int | None = Field(default=None, description="address:port (or port) of this machine where the device's records arrive")
    peer: str | int | None = Field(default=None, description="address:port (or port) of the controller that an emulated device sends to")
    rate: Positive = Field(default=1000.0, description="records a second [Hz]")
    clock: Literal["device", "host"] = Field(default="device", description="who paces the cycle: the device's records, or the loop")
    any_port: bool = Field(default=False, description="whether the device may send from another port than the URL's")
    connect: Positive = Field(default=2.0, description="[s] to wait for the first record")


def _layout(settings: UdpSettings, kind: RecordKind) -> Record:
    """The record of ``kind``. Raises InputError where the layout has none."""
    layout: Layout = read_layout(settings.layout) if settings.layout is not None else default_layout()
    if not getattr(layout, kind):
        message = f"the layout {settings.layout} has no {kind} record; describe it there"
        raise InputError(Fault(settings.where, None, None, "layout", message))
    record = Record(layout, kind)
    if record.size > LARGEST:
        message = f"the {kind} record has {record.size} bytes; at most {LARGEST} go into one datagram"
        raise InputError(Fault(settings.where, None, None, "layout", message))
    return record


def _end(settings: UdpSettings, key: Literal["listen", "peer"], what: str) -> sockets.Address:
    """The address in ``listen`` or ``peer``. Raises InputError."""
    given = getattr(settings, key)
    if given is None:
        raise InputError(Fault(settings.where, None, None, key, f"is missing; give {what} as {key}=address:port"))
    host, _, port = str(given).rpartition(":")
    if not port.isdecimal() or not 0 <= int(port) <= 65535:
        raise InputError(Fault(settings.where, None, None, key, f"is not address:port (got {given!r}); allowed are ports 0 to 65535"))
    return sockets.resolve(host or LOOPBACK, int(port), settings.where)


class _Receiver:
    """Records from one sender; each that is good and newer than all before is handed to ``take`` while it is in ``record``."""

    def __init__(self, record: Record, counts, take: Callable[[], bool]) -> None:
        self.record, self.counts, self.take = record, counts, take
        self.sequence = Sequence(counts, bits=record.sequence_bits or 32)
        self.socket: socket.socket | None = None
        self.sender: sockets.Address | None = None
        self.any_port = False
        self._buffer = bytearray(LARGEST + 1)
        self._view = memoryview(self._buffer)

    def open(self, own: sockets.Address, sender: sockets.Address, any_port: bool, where: str) -> None:
        self.sender, self.any_port = sender, any_port
        self.sequence.restart()
        self.socket = sockets.bound_udp(own, where)

    def close(self) -> None:
        if self.socket is not None:
            self.socket.close()
            self.socket = None

    def fileno(self) -> int:
        return self.socket.fileno() if self.socket is not None else -1

    def poll(self) -> bool:
        """Whether a newer record has come that was taken."""
        new = False
        for _ in range(LONGEST_DRAIN if self.socket is not None else 0):
            try:
                size, sender = self.socket.recvfrom_into(self._buffer)  # type: ignore[union-attr]
            except BlockingIOError:
                break
            except OSError:
                self.counts[Event.GONE] += 1
                continue
            new = self._take(size, sender) or new
        return new

    def _take(self, size: int, sender: sockets.Address) -> bool:
        allowed = self.sender or sender
        if sender[0] != allowed[0] or (sender[1] != allowed[1] and not self.any_port):
            self.counts[Event.SENDER] += 1
            return False
        if not self.record.unpack(self._view[:size]):
            self.counts[Event.MALFORMED] += 1
            return False
        return (not self.record.sequence_bits or self.sequence.judge(self.record.sequence)) and self.take()

    def send(self, data: bytes, towards: sockets.Address) -> None:
        if self.socket is None:
            return
        try:
            self.socket.sendto(data, towards)
        except OSError:
            self.counts[Event.GONE] += 1

    def note(self, sample: Sample) -> bool:
        """Take the record's number, time and status over into ``sample``; False, and counted, where the status is an error."""
        sample.status = self.record.flag
        if self.record.flag:
            self.counts[Event.STATUS] += 1
            return False
        self.counts[Event.RECEIVED] += 1
        sample.sequence = self.sequence.newest if self.record.sequence_bits else self.record.sequence
        sample.device_time = self.record.time
        sample.arrival = time.monotonic_ns()
        return True


class UdpSensorClient(SensorClient):
    """A sensor that sends records."""

    def __init__(self, settings: UdpSettings) -> None:
        super().__init__(settings.where)
        self.settings = settings
        self.period = 1.0 / settings.rate
        self._receiver = _Receiver(_layout(settings, "sensor"), self.counts, self._take)

    def open(self) -> None:
        _open(self, self._receiver)

    def close(self) -> None:
        self._receiver.close()

    def fileno(self) -> int:
        return self._receiver.fileno()

    def poll(self) -> bool:
        return self._receiver.poll()

    def _take(self) -> bool:
        if not self._receiver.note(self.reading):
            return False
        self.reading.wrench[:] = self._receiver.record.values
        return True


class UdpPlatformClient(PlatformClient):
    """A platform that takes a pose a datagram and sends where it is."""

    def __init__(self, settings: UdpSettings) -> None:
        super().__init__(settings.where)
        self.settings = settings
        self.clock = Clock(settings.clock)
        self.period = 1.0 / settings.rate
        self._receiver = _Receiver(_layout(settings, "state"), self.counts, self._take)
        self._command = _layout(settings, "command")
        self._towards: sockets.Address = (settings.host, settings.port)
        self._pose: Array = self.state.pose.copy()
        self._sent = 0

    def open(self) -> None:
        self._towards = sockets.resolve(self.settings.host, self.settings.port, self.where)
        self._sent = 0
        _open(self, self._receiver)
        self._pose[:] = self.state.pose
        self.hold()

    def close(self) -> None:
        self._receiver.close()

    def fileno(self) -> int:
        return self._receiver.fileno()

    def poll(self) -> bool:
        return self._receiver.poll()

    def _take(self) -> bool:
        if not self._receiver.note(self.state):
            return False
        self.state.pose[:] = self._receiver.record.values
        return True

    def command(self, pose: Array) -> None:
        self._check(pose)
        self._pose[:] = pose
        self.hold()

    def hold(self) -> None:
        self._send(0)

    def stop(self) -> None:
        """Send the stop flag; without one in the layout, hold."""
        self._send(STOP)

    def _send(self, stop: int) -> None:
        self._sent += 1
        self.held[:7], self.held[7] = self._pose, self._sent
        data = self._command.pack(self._pose, self._sent, time.monotonic_ns() * 1e-9, stop)
        self._receiver.send(data, self._towards)


def _open(client: UdpSensorClient | UdpPlatformClient, receiver: _Receiver) -> None:
    settings = client.settings
    own = _end(settings, "listen", "the end of this machine where the device's records arrive")
    receiver.open(own, sockets.resolve(settings.host, settings.port, settings.where), settings.any_port, settings.where)
    if not client.wait(settings.connect):
        counts = client.counts
        client.close()
        raise DeviceError(
            f"{settings.where}: no good record in {settings.connect:g} s ({counts[Event.MALFORMED]} malformed, {counts[Event.SENDER]} from "
            f"other senders, {counts[Event.STATUS]} with an error status); check the address that the device sends to, and the layout"
        )


class UdpSensorServer(SensorServer):
    """An emulated sensor that sends a record each time a wrench is published."""

    def __init__(self, settings: UdpSettings) -> None:
        super().__init__(settings.where)
        self.settings = settings
        self.period = 1.0 / settings.rate
        self._record = _layout(settings, "sensor")
        self._peer = _end(settings, "peer", "the controller's end")
        self._number = 0
        self._socket: socket.socket | None = None

    def open(self) -> None:
        own = sockets.resolve(self.settings.host, self.settings.port, self.where)
        self._socket = sockets.bound_udp(own, self.where)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def poll(self) -> bool:
        """A sensor is told nothing."""
        return False

    def publish(self, wrench: Array, device_time: float, status: int = 0) -> None:
        if self._socket is None:
            return
        self._number += 1
        try:
            self._socket.sendto(self._record.pack(wrench, self._number, device_time, status), self._peer)
        except OSError:
            self.counts[Event.GONE] += 1


class UdpPlatformServer(PlatformServer):
    """An emulated platform."""

    def __init__(self, settings: UdpSettings) -> None:
        super().__init__(settings.where)
        self.settings = settings
        self.period = 1.0 / settings.rate
        self._receiver = _Receiver(_layout(settings, "command"), self.counts, self._take)
        self._state = _layout(settings, "state")
        self._peer = _end(settings, "peer", "the controller's end")
        self._number = 0

    def open(self) -> None:
        own = sockets.resolve(self.settings.host, self.settings.port, self.where)
        self._receiver.open(own, self._peer, self.settings.any_port, self.where)

    def close(self) -> None:
        self._receiver.close()

    def fileno(self) -> int:
        return self._receiver.fileno()

    def poll(self) -> bool:
        return self._receiver.poll()

    def _take(self) -> bool:
        if self._receiver.record.flag:
            self.stopped = "the client asked for a stop"
        if self.stopped is not None:
            return False
        self.counts[Event.RECEIVED] += 1
        self.command[:] = self._receiver.record.values
        self.commanded = True
        return True

    def publish(self, pose: Array, device_time: float, status: int = 0) -> None:
        if self._number == 0:
            self.command[:] = pose
        self._number += 1
        self.poll()
        self._receiver.send(self._state.pack(pose, self._number, device_time, status), self._peer)


class UdpKeeper(Keeper):
    """Goes on sending the last pose, or the stop flag, from the socket that the loop has left."""

    def __init__(self, settings: UdpSettings, fileno: int) -> None:
        super().__init__(settings, fileno)
        self._command = _layout(settings, "command")
        self._towards = sockets.resolve(settings.host, settings.port, settings.where)
        self._socket = sockets.adopted(fileno)
        self._sent = 0

    def hold(self, held: Array) -> None:
        self._send(held, 0)

    def stop(self, held: Array) -> None:
        self._send(held, STOP)

    def _send(self, held: Array, stop: int) -> None:
        self._sent += 1
        if not math.isfinite(float(held.sum())):
            return
        data = self._command.pack(held[:7], int(held[7]) + self._sent, time.monotonic_ns() * 1e-9, stop)
        try:
            self._socket.sendto(data, self._towards)
        except OSError:
            return


PROTOCOL = Protocol(
    scheme="udp",
    summary="plain records of a layout of the user's, UDP",
    settings=UdpSettings,
    sensor_client=UdpSensorClient,
    platform_client=UdpPlatformClient,
    sensor_server=UdpSensorServer,
    platform_server=UdpPlatformServer,
    keeper=UdpKeeper,
)
