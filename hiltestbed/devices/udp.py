"""``udp://``: plain records over UDP, as sent by Simulink, LabVIEW or Speedgoat, for example.

Their layout is described in YAML: :mod:`hiltestbed.devices.layout`.

The URL's address is the device's: it receives commands there and sends its records from there.
``listen`` is the address on this machine where the records arrive; an emulated device has ``peer``
instead, the controller's address.
"""

from __future__ import annotations

import socket
from abc import abstractmethod
from typing import ClassVar, Literal

from hiltestbed.devices import sockets
from hiltestbed.devices.interface import (
    Array,
    Client,
    DeviceError,
    Event,
    Protocol,
    SensorClient,
    SensorServer,
)
from hiltestbed.devices.layout import LARGEST, RecordKind, WireRecord, default_layout, read_layout
from hiltestbed.devices.sequence import Advancing, NumberedClient, NumberedServer, Sequence
from hiltestbed.devices.url import LOOPBACK, PacedSettings, refused


class UdpSettings(PacedSettings):
    """Options of ``udp://``."""

    default_port: ClassVar[int] = 5005

    layout: str | None = None  # YAML file that describes the records; None: the default layout
    # address:port (or port) of this machine where the device's records arrive
    listen: str | int | None = None
    # address:port (or port) of the controller that an emulated device sends to
    peer: str | int | None = None
    any_port: bool = False  # the device may send from another port than the URL's

    def record(self, kind: RecordKind) -> WireRecord:
        """The record of ``kind``. Raises InputError if the layout has none."""
        layout = read_layout(self.layout) if self.layout is not None else default_layout()
        if not getattr(layout, kind):
            message = f"the layout {self.layout} has no {kind} record; describe it there"
            raise refused(self.where, message, "layout")
        record = WireRecord(layout, kind)
        if record.size > LARGEST:
            message = (
                f"the {kind} record has {record.size} bytes; at most {LARGEST} go into one datagram"
            )
            raise refused(self.where, message, "layout")
        return record

    def device(self) -> sockets.Address:
        """The address of the device. Raises InputError."""
        return sockets.resolve(self.host, self.port, self.where)

    def end(self, key: Literal["listen", "peer"]) -> sockets.Address:
        """The address in ``listen`` or ``peer``. Raises InputError."""
        given = getattr(self, key)
        if given is None:
            here = "the end of this machine where the device's records arrive"
            what = here if key == "listen" else "the controller's end"
            raise refused(self.where, f"is missing; give {what} as {key}=address:port", key)
        host, _, port = str(given).rpartition(":")
        if not port.isdecimal() or not 0 <= int(port) <= 65535:
            message = f"is not address:port (got {given!r}); allowed are ports 0 to 65535"
            raise refused(self.where, message, key)
        return sockets.resolve(host or LOOPBACK, int(port), self.where)


class _Receiver(sockets.Datagrams):
    """Receives records of one ``kind`` from one sender."""

    kind: ClassVar[RecordKind]
    settings: UdpSettings
    _largest = LARGEST

    def __init__(self, settings: UdpSettings) -> None:
        super().__init__(settings)
        self._record = record = settings.record(self.kind)
        self._sender: sockets.Address = (settings.host, settings.port)
        self._sequence = Sequence(self.counts, bits=record.sequence_bits or 32)
        self._time = Advancing(self.counts, record.clock_bits)

    def _listen(self, own: sockets.Address, sender: sockets.Address) -> None:
        self._sender = sender
        self._sequence.restart()
        self._time.restart()
        self._socket = sockets.bound(own, self.where)

    def _take(self, data: bytes, sender: sockets.Address) -> bool:
        host, port = self._sender
        if sender[0] != host or (sender[1] != port and not self.settings.any_port):
            self.counts[Event.SENDER] += 1
            return False
        record = self._record
        if not record.unpack(data):
            self.counts[Event.MALFORMED] += 1
            return False
        # new by the sequence number; in a layout without one, by the time
        if record.sequence_bits:
            new = self._sequence.judge(record.sequence)
        else:
            new = record.clock is None or self._time.judge(record.clock)
        return new and self._accept()

    @abstractmethod
    def _accept(self) -> bool:
        """Take in the record that has been unpacked."""


class _UdpClient(_Receiver, Client):
    def open(self) -> None:
        settings, counts = self.settings, self.counts
        self._listen(settings.end("listen"), settings.device())
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

    kind = "sensor"


class UdpPlatformClient(_UdpClient, NumberedClient):
    """A platform that receives one pose per datagram and sends the pose reached."""

    kind = "state"

    def __init__(self, settings: UdpSettings) -> None:
        super().__init__(settings)
        self._command = settings.record("command")

    def open(self) -> None:
        super().open()
        self._begin()

    def adopt(self, fileno: int) -> None:
        self._sender, self._socket = self.settings.device(), socket.socket(fileno=fileno)

    def _post(self, pose: Array, number: int, now: float, stop: int) -> None:
        self._send_to(self._command.pack(pose, number, now, stop), self._sender)


class UdpSensorServer(sockets.Datagrams, SensorServer):
    """An emulated sensor that sends a record each time a wrench is published."""

    settings: UdpSettings

    def __init__(self, settings: UdpSettings) -> None:
        super().__init__(settings)
        self._record, self._peer = (
            settings.record("sensor"),
            settings.end("peer"),
        )
        self._number = 0

    def open(self) -> None:
        self._socket = sockets.bound(self.settings.device(), self.where)

    def poll(self) -> bool:
        """A sensor receives nothing."""
        return False

    def publish(self, wrench: Array, device_time: float) -> None:
        self._number += 1
        self._send_to(self._record.pack(wrench, self._number, device_time), self._peer)


class UdpPlatformServer(_Receiver, NumberedServer):
    """An emulated platform."""

    kind = "command"

    def __init__(self, settings: UdpSettings) -> None:
        super().__init__(settings)
        self._state, self._peer = (
            settings.record("state"),
            settings.end("peer"),
        )

    def open(self) -> None:
        self._listen(self.settings.device(), self._peer)

    def _accept(self) -> bool:
        return self._commanded(self._record.values, self._record.flag)

    def _report(self, pose: Array, number: int, device_time: float) -> None:
        self._send_to(self._state.pack(pose, number, device_time), self._peer)


PROTOCOL = Protocol(
    scheme="udp",
    summary="plain records of a layout of the user's, UDP",
    settings=UdpSettings,
    sensor_client=UdpSensorClient,
    platform_client=UdpPlatformClient,
    sensor_server=UdpSensorServer,
    platform_server=UdpPlatformServer,
)
