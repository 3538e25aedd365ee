"""``udp://``: plain records over UDP, as sent by Simulink, LabVIEW or Speedgoat, for example.

Their layout is described in YAML: :mod:`hiltestbed.devices.layout`.

The URL's address is the device's: it receives commands there and sends its records from there.
``listen`` is the address on this machine where the records arrive; an emulated device has ``peer``
instead, the controller's address.
"""

from __future__ import annotations

from contextlib import suppress

from hiltestbed.devices import sockets
from hiltestbed.devices.interface import Array, Clock, DeviceError, Event, Protocol, SensorClient
from hiltestbed.devices.numbered import NumberedClient, NumberedKeeper
from hiltestbed.devices.udp_device import UdpPlatformServer, UdpSensorServer
from hiltestbed.devices.udp_receiver import Receiver, UdpSettings, end_of, record_of


class UdpSensorClient(SensorClient):
    """A sensor that sends records."""

    def __init__(self, settings: UdpSettings) -> None:
        super().__init__(settings.where)
        self.settings = settings
        self.period = 1.0 / settings.rate
        self.clock = Clock(settings.clock)
        self._receiver = Receiver(record_of(settings, "sensor"), self.counts, self._take)

    def open(self) -> None:
        _open(self, self._receiver)

    def close(self) -> None:
        self._receiver.close()

    def fileno(self) -> int:
        return self._receiver.fileno()

    def poll(self) -> bool:
        return self._receiver.poll()

    def _take(self) -> bool:
        return self._receiver.note(self.reading)


class UdpPlatformClient(NumberedClient):
    """A platform that receives one pose per datagram and sends the pose reached."""

    def __init__(self, settings: UdpSettings) -> None:
        super().__init__(settings)
        self.settings = settings
        self._receiver = Receiver(record_of(settings, "state"), self.counts, self._take)
        self._command = record_of(settings, "command")
        self._towards: sockets.Address = (settings.host, settings.port)

    def open(self) -> None:
        self._towards = sockets.resolve(self.settings.host, self.settings.port, self.where)
        _open(self, self._receiver)
        self._begin()

    def close(self) -> None:
        self._receiver.close()

    def fileno(self) -> int:
        return self._receiver.fileno()

    def poll(self) -> bool:
        return self._receiver.poll()

    def _take(self) -> bool:
        return self._receiver.note(self.state)

    def _post(self, pose: Array, number: int, now: float, stop: int) -> None:
        self._receiver.send(self._command.pack(pose, number, now, stop), self._towards)


def _open(client: UdpSensorClient | UdpPlatformClient, receiver: Receiver) -> None:
    settings = client.settings
    own = end_of(settings, "listen", "the end of this machine where the device's records arrive")
    receiver.open(
        own,
        sockets.resolve(settings.host, settings.port, settings.where),
        settings.any_port,
        settings.where,
    )
    if not client.wait(settings.connect):
        counts = client.counts
        client.close()
        raise DeviceError(
            f"{settings.where}: no good record in {settings.connect:g} s "
            f"({counts[Event.MALFORMED]} malformed, {counts[Event.SENDER]} from "
            f"other senders, {counts[Event.STATUS]} with an error status); check the address that "
            f"the device sends to, and the layout"
        )


class UdpKeeper(NumberedKeeper):
    """Sends from a duplicate of the loop's socket."""

    def __init__(self, settings: UdpSettings, fileno: int) -> None:
        super().__init__(settings, fileno)
        self._command = record_of(settings, "command")
        self._towards = sockets.resolve(settings.host, settings.port, settings.where)
        self._socket = sockets.adopted(fileno)

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
