"""Settings, addresses and the receiver that both sides of plain records over UDP share."""

from __future__ import annotations

import socket
from collections.abc import Callable
from typing import ClassVar, Literal

from pydantic import Field

from hiltestbed.config.validation import Positive
from hiltestbed.devices import sockets
from hiltestbed.devices.interface import LONGEST_DRAIN, Event, Sample
from hiltestbed.devices.layout import LARGEST, Layout, Record, default_layout, read_layout
from hiltestbed.devices.sequence import Advancing, Sequence
from hiltestbed.devices.url import LOOPBACK, DeviceSettings
from hiltestbed.errors import Fault, InputError

RecordKind = Literal["sensor", "state", "command"]


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


def record_of(settings: UdpSettings, kind: RecordKind) -> Record:
    """The record of ``kind``. Raises InputError if the layout has none."""
    layout: Layout = (
        read_layout(settings.layout) if settings.layout is not None else default_layout()
    )
    if not getattr(layout, kind):
        message = f"the layout {settings.layout} has no {kind} record; describe it there"
        raise InputError(Fault(settings.where, None, None, "layout", message))
    record = Record(layout, kind)
    if record.size > LARGEST:
        message = (
            f"the {kind} record has {record.size} bytes; at most {LARGEST} go into one datagram"
        )
        raise InputError(Fault(settings.where, None, None, "layout", message))
    return record


def end_of(settings: UdpSettings, key: Literal["listen", "peer"], what: str) -> sockets.Address:
    """The address in ``listen`` or ``peer``. Raises InputError."""
    given = getattr(settings, key)
    if given is None:
        raise InputError(
            Fault(settings.where, None, None, key, f"is missing; give {what} as {key}=address:port")
        )
    host, _, port = str(given).rpartition(":")
    if not port.isdecimal() or not 0 <= int(port) <= 65535:
        raise InputError(
            Fault(
                settings.where,
                None,
                None,
                key,
                f"is not address:port (got {given!r}); allowed are ports 0 to 65535",
            )
        )
    return sockets.resolve(host or LOOPBACK, int(port), settings.where)


class Receiver:
    """Receives records from one sender; calls ``take`` for each good new one, while ``record``
    holds its values.
    """

    def __init__(self, record: Record, counts, take: Callable[[], bool]) -> None:
        self.record, self.counts, self.take = record, counts, take
        self.sequence = Sequence(counts, bits=record.sequence_bits or 32)
        self.socket: socket.socket | None = None
        self.sender: sockets.Address | None = None
        self.any_port = False
        self._clock = Advancing(counts, record.clock_bits)
        self._buffer = bytearray(LARGEST + 1)
        self._view = memoryview(self._buffer)

    def open(
        self, own: sockets.Address, sender: sockets.Address, any_port: bool, where: str
    ) -> None:
        self.sender, self.any_port = sender, any_port
        self.sequence.restart()
        self._clock.restart()
        self.socket = sockets.bound_udp(own, where)

    def close(self) -> None:
        if self.socket is not None:
            self.socket.close()
            self.socket = None

    def fileno(self) -> int:
        return self.socket.fileno() if self.socket is not None else -1

    def poll(self) -> bool:
        """Process what has arrived; True if a new record was accepted."""
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
        return self._is_news() and self.take()

    def _is_news(self) -> bool:
        """By the sequence number; in a layout without one, by the time."""
        record = self.record
        if record.sequence_bits:
            return self.sequence.judge(record.sequence)
        return record.clock is None or self._clock.judge(record.clock)

    def send(self, data: bytes, towards: sockets.Address) -> None:
        if self.socket is None:
            return
        try:
            self.socket.sendto(data, towards)
        except OSError:
            self.counts[Event.GONE] += 1

    def note(self, sample: Sample) -> bool:
        """Take the record into ``sample``."""
        record = self.record
        number = self.sequence.newest if record.sequence_bits else record.sequence
        return sample.take(record.values, self.counts, number, record.time, record.flag)
