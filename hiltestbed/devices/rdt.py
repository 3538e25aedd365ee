"""``rdt://``: the force sensors of ATI, Net F/T and Axia, by Raw Data Transfer over UDP.

ATI Industrial Automation, "Network Force/Torque Sensor System (Net F/T) Installation and Operation
Manual", document 9620-05-NET FT, section 10 "UDP Interface Using RDT" and section 9
"netftapi2.xml"; "F/T Sensor, Ethernet Axia", document 9620-05-C-Ethernet Axia, section 12. All
numbers are big-endian. A request has 8 bytes: 0x1234, a command, a count of records (0: unlimited).
A record has 36: the number of the record (from 1 for each request), the number of the sensor's own
sample, a status word, three forces and three torques in counts. Counts per unit, the units and the
rates are on the device's page netftapi2.xml. A device serves one client, the one that sent the last
request; a request may be lost and is repeated until the first record arrives. In buffered streaming
a datagram contains several records, and the client uses the last.
"""

from __future__ import annotations

import struct
from dataclasses import replace
from http.client import HTTP_PORT
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, Field
from pydantic_core import PydanticCustomError

from hiltestbed.config.validation import Positive
from hiltestbed.devices import rdt_page, sockets
from hiltestbed.devices.interface import (
    Array,
    DeviceError,
    Event,
    Protocol,
    SensorClient,
    SensorServer,
)
from hiltestbed.devices.sequence import Advancing, Sequence
from hiltestbed.devices.url import DeviceSettings, Port, refused
from hiltestbed.measured.units import UNITS

REQUEST = struct.Struct(">HHI")
RECORD = struct.Struct(">III6i")
HEADER = 0x1234
STOP, SINGLE, REALTIME, BUFFERED = 0, 1, 2, 3  # 1 only on an Axia, where it equals 2
RESET_LATCH, BIAS = 0x41, 0x42
MOST_RECORDS = 40  # largest number of records in one datagram
COUNTS = 1.0e6  # per unit, of an emulated sensor
# requests before giving up, and the wait [s] for the first record after each
TRIES, PATIENCE = 10, 0.1


def _unit(si: str) -> AfterValidator:
    """Refuses what is no unit of ``si``."""

    def known(unit: str) -> str:
        if rdt_page.factor(si, unit) is None:
            said = {"got": repr(unit), "known": ", ".join(UNITS[si])}
            raise PydanticCustomError("unit", "is no unit (got {got}); allowed: {known}", said)
        return unit

    return AfterValidator(known)


class RdtSettings(DeviceSettings):
    """Options of ``rdt://``. Options that are not given are read from the device's page; without a
    page they must be given.
    """

    default_port: ClassVar[int] = 49152

    counts_per_force: Positive | None = None  # for the unit of force, and of torque
    counts_per_torque: Positive | None = None
    force_unit: Annotated[str, _unit("N")] = "N"
    torque_unit: Annotated[str, _unit("N m")] = "N-m"
    rate: Positive | None = None  # [Hz] of the records
    internal_rate: Positive | None = None  # [Hz] at which the sensor's own counter runs
    mode: Literal["realtime", "buffered"] = "realtime"  # one record per datagram, or several
    # records per datagram of an emulated sensor in buffered mode
    buffer: int = Field(default=10, ge=1, le=MOST_RECORDS)
    http: Port | None = None  # port of the device's configuration page; None: 80
    # bits of the status word that are not errors, such as 0x80010000: a threshold
    ignore_status: int = Field(default=0, ge=0, le=0xFFFFFFFF)

    @property
    def device_tells_rate(self) -> bool:
        """Whether the configuration page is read, which gives the rate."""
        scales = self.counts_per_force, self.counts_per_torque
        return self.http is not None or None in scales


class RdtClient(sockets.Datagrams, SensorClient):
    """A sensor that streams; it sets the clock."""

    settings: RdtSettings
    _largest = RECORD.size * MOST_RECORDS

    def __init__(self, settings: RdtSettings) -> None:
        super().__init__(settings)
        self._scale, self._wrench = np.ones(6), np.zeros(6)
        self._internal_period = float("nan")
        self._sequence = Sequence(self.counts)
        self._samples = Advancing(self.counts, 32)  # the sensor's own counter

    def open(self) -> None:
        settings = self.settings
        address = sockets.resolve(settings.host, settings.port, self.where)
        page = page_of(settings, address[0])
        scale = page.force / page.counts_per_force, page.torque / page.counts_per_torque
        self._scale[:] = np.repeat(scale, 3)
        self.period, self._internal_period = 1.0 / page.rate, 1.0 / page.internal_rate
        self._socket = sockets.connected_udp(address, self.where)
        for _ in range(TRIES):
            self._sequence.restart()
            self._samples.restart()
            self.counts[:] = 0
            self._request(BUFFERED if settings.mode == "buffered" else REALTIME)
            if self.wait(PATIENCE):
                return
        self.close()
        raise DeviceError(
            f"{self.where}: no good record in {TRIES * PATIENCE:g} s after {TRIES} requests; check "
            "the address, that RDT is enabled on the device's communication page, its status "
            "word, and that no other client has taken the stream"
        )

    def close(self) -> None:
        if self._socket is not None:
            self._request(STOP)
        super().close()

    def _take(self, data: bytes, sender: sockets.Address) -> bool:
        number, rest = divmod(len(data), RECORD.size)
        if rest or not 1 <= number <= (MOST_RECORDS if self.settings.mode == "buffered" else 1):
            self.counts[Event.MALFORMED] += 1
            return False
        new = False
        for start in range(0, len(data), RECORD.size):
            new = self._record(data, start) or new
        return new

    def _record(self, data: bytes, start: int) -> bool:
        rdt, sample, status, *_ = RECORD.unpack_from(data, start)
        if not self._sequence.judge(rdt):
            return False
        status = status if status & ~self.settings.ignore_status else 0
        if not status and not self._samples.judge(sample):  # the sensor itself has no new sample
            return False
        np.multiply(np.frombuffer(data, ">i4", 6, start + 12), self._scale, out=self._wrench)
        number, time = self._sequence.newest, sample * self._internal_period
        return self.reading.take(self._wrench, self.counts, number, time, status)

    def _request(self, command: int) -> None:
        if self._socket is None:
            raise DeviceError(f"{self.where}: is not open")
        try:
            self._socket.send(REQUEST.pack(HEADER, command, 0))
        except OSError:
            self.counts[Event.GONE] += 1


class RdtServer(sockets.Datagrams, SensorServer):
    """An emulated sensor: sends a record for each wrench once a client has requested them."""

    settings: RdtSettings
    _largest = 63  # [byte] far above a request of 8

    def __init__(self, settings: RdtSettings) -> None:
        if settings.http is not None:
            message = "an emulated sensor has no configuration page; leave it out"
            raise refused(settings.where, message, "http")
        super().__init__(settings)
        page = rdt_page.Page(
            settings.counts_per_force or COUNTS,
            settings.counts_per_torque or COUNTS,
            settings.force_unit,
            settings.torque_unit,
        )
        self.address: sockets.Address = (settings.host, settings.port)
        scale = page.counts_per_force / page.force, page.counts_per_torque / page.torque
        self._scale = np.repeat(scale, 3)
        self._rate = settings.internal_rate or page.internal_rate
        self._load, self._bias = np.zeros(6), np.zeros(6)
        self._client: sockets.Address | None = None
        self._left = 0  # records still to send; -1: unlimited
        self._number, self._per_datagram = 0, 1
        self._pending = bytearray()

    def open(self) -> None:
        address = sockets.resolve(self.settings.host, self.settings.port, self.where)
        self._socket = sockets.bound(address, self.where)
        self.address = self._socket.getsockname()

    def _take(self, data: bytes, sender: sockets.Address) -> bool:
        header, command, count = REQUEST.unpack(data) if len(data) == REQUEST.size else (0, 0, 0)
        if header != HEADER or command not in (STOP, SINGLE, REALTIME, BUFFERED, RESET_LATCH, BIAS):
            self.counts[Event.MALFORMED] += 1
            return False
        self.counts[Event.RECEIVED] += 1
        if command == BIAS:
            self._bias[:] = self._load
        elif command == STOP:
            self._left = 0
        elif command != RESET_LATCH:  # no status is latched here
            self._client, self._left, self._number = sender, count or -1, 0
            self._per_datagram = self.settings.buffer if command == BUFFERED else 1
            self._pending.clear()
        return True

    def publish(self, wrench: Array, device_time: float) -> None:
        self.poll()
        self._load[:] = wrench
        if self._socket is None or self._client is None or self._left == 0:
            return
        self._number = (self._number + 1) & 0xFFFFFFFF
        sample = round(device_time * self._rate) & 0xFFFFFFFF
        counts = np.rint((self._load - self._bias) * self._scale)
        counts = np.clip(counts, -(2**31), 2**31 - 1).astype(int).tolist()
        self._pending += RECORD.pack(self._number, sample, 0, *counts)
        self._left -= self._left > 0
        if self._left == 0 or len(self._pending) >= self._per_datagram * RECORD.size:
            self._send_to(self._pending, self._client)
            self._pending.clear()


def page_of(settings: RdtSettings, host: str) -> rdt_page.Page:
    """What the URL gives, completed from the page of the device at ``host``. Raises DeviceError."""
    given = {"force": settings.counts_per_force, "torque": settings.counts_per_torque}
    by_hand = {name for name, scale in given.items() if scale is not None}
    whole = settings.http is None or (settings.rate and settings.internal_rate)
    if len(by_hand) == 2 and whole:
        page = rdt_page.Page(COUNTS, COUNTS, settings.force_unit, settings.torque_unit)
    else:
        port = settings.http or HTTP_PORT
        page = rdt_page.fetch(host, port, settings.where, by_hand)
    own = {f"{name}_unit": getattr(settings, f"{name}_unit") for name in by_hand}
    own |= {f"counts_per_{name}": given[name] for name in by_hand}
    return replace(
        page,
        **own,
        rate=settings.rate or page.rate,
        internal_rate=settings.internal_rate or page.internal_rate,
    )


PROTOCOL = Protocol(
    scheme="rdt",
    summary="ATI Net F/T and Axia force sensors, UDP",
    settings=RdtSettings,
    sensor_client=RdtClient,
    sensor_server=RdtServer,
)
