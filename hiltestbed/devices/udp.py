"""``udp://``: plain records over UDP, as sent by Simulink, LabVIEW or Speedgoat, for example.

Their layout is described in YAML: :mod:`hiltestbed.devices.layout`.

The URL's address is the device's: it receives commands there and sends its records from there.
``listen`` is the address on this machine where the records arrive; an emulated device has ``peer``
instead, the controller's address.
"""

from __future__ import annotations

import socket
from contextlib import suppress
from typing import ClassVar, Literal

from pydantic import Field

from hiltestbed.config.validation import Positive
from hiltestbed.devices import sockets
from hiltestbed.devices.interface import (
    Array,
    Client,
    Clock,
    DeviceError,
    Event,
    Protocol,
    SensorClient,
    SensorServer,
)
from hiltestbed.devices.layout import LARGEST, RecordKind, WireRecord, default_layout, read_layout
from hiltestbed.devices.numbered import NumberedClient, NumberedKeeper, NumberedServer
from hiltestbed.devices.sequence import Advancing, Sequence
from hiltestbed.devices.url import LOOPBACK, DeviceSettings, refused


class UdpSettings(DeviceSettings):
    """Options of ``udp://``."""

    default_port: ClassVar[int] = 5005

    kind: Literal["udp"] = "udp"
    layout: str | None = Field(
        default=None,
        description="YAML file that describes the records; omitted: the default layout",
    )
    listen: str | int | None = Field(
        default=None,
        description="address:port (or port) of this machine where the device's records arrive",
    )
    peer: str | int | None = Field(
        default=None,
        description="address:port (or port) of the controller that an emulated device sends to",
    )
    rate: Positive = Field(default=1000.0, description="rate of the records [Hz]")
    clock: Literal["device", "host"] = Field(
        default="device", description="what paces the cycle: the device's records, or the loop"
    )
    any_port: bool = Field(
        default=False, description="whether the device may send from another port than the URL's"
    )
    connect: Positive = Field(default=2.0, description="time to wait for the first record [s]")


def record_of(settings: UdpSettings, kind: RecordKind) -> WireRecord:
    """The record of ``kind``. Raises InputError if the layout has none."""
    layout = read_layout(settings.layout) if settings.layout is not None else default_layout()
    if not getattr(layout, kind):
        message = f"the layout {settings.layout} has no {kind} record; describe it there"
        raise refused(settings.where, message, "layout")
    record = WireRecord(layout, kind)
    if record.size > LARGEST:
        message = (
            f"the {kind} record has {record.size} bytes; at most {LARGEST} go into one datagram"
        )
        raise refused(settings.where, message, "layout")
    return record


def end_of(settings: UdpSettings, key: Literal["listen", "peer"], what: str) -> sockets.Address:
    """The address in ``listen`` or ``peer``. Raises InputError."""
    given = getattr(settings, key)
    if given is None:
        raise refused(settings.where, f"is missing; give {what} as {key}=address:port", key)
    host, _, port = str(given).rpartition(":")
    if not port.isdecimal() or not 0 <= int(port) <= 65535:
        message = f"is not address:port (got {given!r}); allowed are ports 0 to 65535"
        raise refused(settings.where, message, key)
    return sockets.resolve(host or LOOPBACK, int(port), settings.where)


def controller_of(settings: UdpSettings) -> sockets.Address:
    """The address that an emulated device sends to. Raises InputError."""
    return end_of(settings, "peer", "the controller's end")


class Receiver(sockets.Datagrams):
    """A link that receives records of one layout from one sender."""

    _largest = LARGEST
    settings: UdpSettings

    def _expect(self, record: WireRecord) -> None:
        self._record = record
        self._sender: sockets.Address = (self.settings.host, self.settings.port)
        self._sequence = Sequence(self.counts, bits=record.sequence_bits or 32)
        self._clock = Advancing(self.counts, record.clock_bits)

    def _listen(self, own: sockets.Address, sender: sockets.Address) -> None:
        self._sender = sender
        self._sequence.restart()
        self._clock.restart()
        self._socket = sockets.bound_udp(own, self.where)

    def _take(self, data: bytes, sender: sockets.Address) -> bool:
        host, port = self._sender
        if sender[0] != host or (sender[1] != port and not self.settings.any_port):
            self.counts[Event.SENDER] += 1
            return False
        if not self._record.unpack(data):
            self.counts[Event.MALFORMED] += 1
            return False
        return self._is_news() and self._accept()

    def _is_news(self) -> bool:
        """By the sequence number; in a layout without one, by the time."""
        record = self._record
        if record.sequence_bits:
            return self._sequence.judge(record.sequence)
        return record.clock is None or self._clock.judge(record.clock)

    def _accept(self) -> bool:
        """Take in the record that has been unpacked."""
        raise NotImplementedError


class _UdpClient(Receiver, Client):
    def open(self) -> None:
        settings, counts = self.settings, self.counts
        own = end_of(
            settings, "listen", "the end of this machine where the device's records arrive"
        )
        self._listen(own, sockets.resolve(settings.host, settings.port, self.where))
        if not self.wait(settings.connect):
            self.close()
            raise DeviceError(
                f"{self.where}: no good record in {settings.connect:g} s "
                f"({counts[Event.MALFORMED]} malformed, {counts[Event.SENDER]} from "
                f"other senders, {counts[Event.STATUS]} with an error status); check the address "
                f"that the device sends to, and the layout"
            )

    def _accept(self) -> bool:
        record = self._record
        number = self._sequence.newest if record.sequence_bits else record.sequence
        return self.sample.take(record.values, self.counts, number, record.time, record.flag)


class UdpSensorClient(_UdpClient, SensorClient):
    """A sensor that sends records."""

    def __init__(self, settings: UdpSettings) -> None:
        super().__init__(settings.where)
        self.settings = settings
        self.period = 1.0 / settings.rate
        self.clock = Clock(settings.clock)
        self._expect(record_of(settings, "sensor"))


class UdpPlatformClient(_UdpClient, NumberedClient):
    """A platform that receives one pose per datagram and sends the pose reached."""

    def __init__(self, settings: UdpSettings) -> None:
        super().__init__(settings)
        self.settings = settings
        self._expect(record_of(settings, "state"))
        self._command = record_of(settings, "command")

    def open(self) -> None:
        super().open()
        self._begin()

    def _post(self, pose: Array, number: int, now: float, stop: int) -> None:
        self._send_to(self._command.pack(pose, number, now, stop), self._sender)


class UdpSensorServer(sockets.Datagrams, SensorServer):
    """An emulated sensor that sends a record each time a wrench is published."""

    def __init__(self, settings: UdpSettings) -> None:
        super().__init__(settings.where)
        self.settings = settings
        self.period = 1.0 / settings.rate
        self._record = record_of(settings, "sensor")
        self._peer = controller_of(settings)
        self._number = 0

    def open(self) -> None:
        own = sockets.resolve(self.settings.host, self.settings.port, self.where)
        self._socket = sockets.bound_udp(own, self.where)

    def poll(self) -> bool:
        """A sensor receives nothing."""
        return False

    def publish(self, wrench: Array, device_time: float, status: int = 0) -> None:
        self._number += 1
        self._send_to(self._record.pack(wrench, self._number, device_time, status), self._peer)


class UdpPlatformServer(Receiver, NumberedServer):
    """An emulated platform."""

    def __init__(self, settings: UdpSettings) -> None:
        super().__init__(settings)
        self.settings = settings
        self._expect(record_of(settings, "command"))
        self._state = record_of(settings, "state")
        self._peer = controller_of(settings)

    def open(self) -> None:
        own = sockets.resolve(self.settings.host, self.settings.port, self.where)
        self._listen(own, self._peer)

    def _accept(self) -> bool:
        return self._commanded(self._record.values, self._record.flag)

    def _report(self, pose: Array, number: int, device_time: float, status: int) -> None:
        self._send_to(self._state.pack(pose, number, device_time, status), self._peer)


class UdpKeeper(NumberedKeeper):
    """Sends from a duplicate of the loop's socket."""

    def __init__(self, settings: UdpSettings, fileno: int) -> None:
        super().__init__(settings, fileno)
        self._command = record_of(settings, "command")
        self._towards = sockets.resolve(settings.host, settings.port, settings.where)
        self._socket = socket.socket(fileno=fileno)

    def _post(self, pose: Array, number: int, now: float, stop: int) -> None:
        with suppress(OSError):
            self._socket.sendto(self._command.pack(pose, number, now, stop), self._towards)


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
