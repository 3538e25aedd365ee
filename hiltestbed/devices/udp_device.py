"""The device's side of plain records over UDP, for an emulated sensor or platform."""

from __future__ import annotations

import socket

from hiltestbed.devices import sockets
from hiltestbed.devices.interface import Array, Event, SensorServer
from hiltestbed.devices.numbered import NumberedServer
from hiltestbed.devices.udp_receiver import Receiver, UdpSettings, end_of, record_of


class UdpSensorServer(SensorServer):
    """An emulated sensor that sends a record each time a wrench is published."""

    def __init__(self, settings: UdpSettings) -> None:
        super().__init__(settings.where)
        self.settings = settings
        self.period = 1.0 / settings.rate
        self._record = record_of(settings, "sensor")
        self._peer = end_of(settings, "peer", "the controller's end")
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
        """A sensor receives nothing."""
        return False

    def publish(self, wrench: Array, device_time: float, status: int = 0) -> None:
        if self._socket is None:
            return
        self._number += 1
        try:
            self._socket.sendto(
                self._record.pack(wrench, self._number, device_time, status), self._peer
            )
        except OSError:
            self.counts[Event.GONE] += 1


class UdpPlatformServer(NumberedServer):
    """An emulated platform."""

    def __init__(self, settings: UdpSettings) -> None:
        super().__init__(settings)
        self.settings = settings
        self._receiver = Receiver(record_of(settings, "command"), self.counts, self._take)
        self._state = record_of(settings, "state")
        self._peer = end_of(settings, "peer", "the controller's end")

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
        return self._commanded(self._receiver.record.values, self._receiver.record.flag)

    def _report(self, pose: Array, number: int, device_time: float, status: int) -> None:
        self._receiver.send(self._state.pack(pose, number, device_time, status), self._peer)
