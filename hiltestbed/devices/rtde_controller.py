"""The controller's side of Real-Time Data Exchange, for an emulated robot.

It answers the set-up requests of :mod:`hiltestbed.devices.rtde` and other clients, and has the
fields that a contact experiment needs:
others are NOT_FOUND. Framing and sources: :mod:`hiltestbed.devices.rtde_wire`.
"""

from __future__ import annotations

import math
import select
import socket
import struct
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from hiltestbed.devices import poses, rtde_wire, sockets
from hiltestbed.devices.interface import Array, Event, PlatformServer, SensorServer

if TYPE_CHECKING:
    from hiltestbed.devices.rtde import RtdeSettings

OUTPUTS = {
    "timestamp": "DOUBLE",
    "actual_TCP_pose": "VECTOR6D",
    "target_TCP_pose": "VECTOR6D",
    "actual_TCP_force": "VECTOR6D",
    "ft_raw_wrench": "VECTOR6D",
    "safety_status_bits": "UINT32",
    "robot_status_bits": "UINT32",
    "runtime_state": "UINT32",
}
INPUTS = {f"input_double_register_{i}": "DOUBLE" for i in range(48)} | {
    f"input_int_register_{i}": "INT32" for i in range(48)
}
# major, minor, bugfix, build reported by the emulated controller
VERSION = struct.pack(">IIII", 5, 15, 0, 0)
MOST_CLIENTS = 8
# normal mode, power on and program running, playing
RUNNING = {"safety_status_bits": 0b1, "robot_status_bits": 0b11, "runtime_state": 2}


@dataclass
class _Client:
    stream: rtde_wire.Stream
    outputs: list[str] = field(default_factory=list)
    layout: struct.Struct | None = None
    frequency: float = math.inf
    due: float = -math.inf
    inputs: dict[int, tuple[list[str], struct.Struct]] = field(default_factory=dict)
    started: bool = False


class Controller:
    """Listens, sets up clients, sends them outputs and receives their inputs.

    Attributes:
        fields: the outputs by name.
        registers: the received inputs, by name.
    """

    def __init__(self, settings: RtdeSettings, counts) -> None:
        self.settings, self.counts = settings, counts
        self.fields: dict[str, list[float]] = {
            name: [0.0] * 6 for name, kind in OUTPUTS.items() if kind == "VECTOR6D"
        }
        self.fields |= {name: [value] for name, value in RUNNING.items()}
        self.registers: dict[str, float | int] = {}
        self.address: sockets.Address = (settings.host, settings.port)
        self._clients: list[_Client] = []
        self._claimed: dict[str, _Client] = {}
        self._socket: socket.socket | None = None

    def open(self) -> None:
        address = sockets.resolve(self.settings.host, self.settings.port, self.settings.where)
        self._socket = sockets.listening_tcp(address, self.settings.where)
        self.address = self._socket.getsockname()

    def close(self) -> None:
        for client in self._clients[:]:
            self._drop(client)
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def poll(self) -> bool:
        """Serve all clients; True if new inputs have arrived."""
        if self._socket is None:
            return False
        self._accept()
        new = False
        for client in self._clients[:]:
            try:
                for kind, payload in client.stream.receive():
                    new = self._serve(client, kind, payload) or new
            except (OSError, rtde_wire.Broken) as error:
                self.counts[
                    Event.MALFORMED if isinstance(error, rtde_wire.Broken) else Event.GONE
                ] += 1
                self._drop(client)
        return new

    def arrived(self, timeout: float) -> bool:
        """Wait until a client sends something, for at most ``timeout`` [s]."""
        heard = [client.stream.connection for client in self._clients]
        return self._socket is not None and bool(
            select.select([self._socket, *heard], [], [], timeout)[0]
        )

    def publish(self, device_time: float) -> None:
        """Send the fields to each client that has started, at the rate that it requested."""
        self.fields["timestamp"] = [device_time]
        for client in self._clients[:]:
            if (
                not client.started
                or client.layout is None
                or device_time < client.due - 0.25 / client.frequency
            ):
                continue
            client.due = max(client.due, device_time) + 1.0 / client.frequency
            values = [value for name in client.outputs for value in self.fields[name]]
            try:
                client.stream.send(rtde_wire.DATA_PACKAGE, client.layout.pack(1, *values))
            except OSError:  # closed, or a client that does not read
                self.counts[Event.GONE] += 1
                self._drop(client)

    def _accept(self) -> None:
        try:
            connection, _ = self._socket.accept()  # type: ignore[union-attr]
        except OSError:
            return
        if len(self._clients) >= MOST_CLIENTS:
            connection.close()
            return
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._clients.append(_Client(rtde_wire.Stream(connection)))

    def _drop(self, client: _Client) -> None:
        client.stream.connection.close()
        self._clients.remove(client)
        self._claimed = {
            name: owner for name, owner in self._claimed.items() if owner is not client
        }

    def _serve(self, client: _Client, kind: int, payload: bytes) -> bool:
        if kind == rtde_wire.DATA_PACKAGE:
            return self._inputs(client, payload)
        if kind == rtde_wire.TEXT_MESSAGE:
            return False
        client.stream.send(kind, self._answer(client, kind, payload))
        return False

    def _answer(self, client: _Client, kind: int, payload: bytes) -> bytes:
        if kind == rtde_wire.REQUEST_PROTOCOL_VERSION:
            return bytes([payload == struct.pack(">H", rtde_wire.PROTOCOL_VERSION)])
        if kind == rtde_wire.GET_CONTROLLER_VERSION:
            return VERSION
        if kind == rtde_wire.START:
            client.started = client.layout is not None
            return bytes([client.started])
        if kind == rtde_wire.PAUSE:
            client.started = False
            return b"\x01"
        if kind == rtde_wire.SETUP_OUTPUTS and len(payload) > 8:
            return self._set_outputs(client, payload)
        if kind == rtde_wire.SETUP_INPUTS:
            return self._set_inputs(client, payload)
        raise rtde_wire.Broken

    def _set_outputs(self, client: _Client, payload: bytes) -> bytes:
        (frequency,) = struct.unpack_from(">d", payload)
        names = _names(payload[8:])
        types = [OUTPUTS.get(name, rtde_wire.NOT_FOUND) for name in names]
        found = rtde_wire.NOT_FOUND not in types and 0.0 < frequency <= 500.0
        if found:
            client.outputs, client.layout, client.frequency = (
                names,
                rtde_wire.recipe(types),
                frequency,
            )
        return bytes([found]) + ",".join(types).encode()

    def _set_inputs(self, client: _Client, payload: bytes) -> bytes:
        names = _names(payload)
        types = [
            rtde_wire.IN_USE if name in self._claimed else INPUTS.get(name, rtde_wire.NOT_FOUND)
            for name in names
        ]
        if any(kind not in rtde_wire.TYPES for kind in types):
            return bytes([0]) + ",".join(types).encode()
        number = len(client.inputs) + 1
        if number > 255:
            raise rtde_wire.Broken
        client.inputs[number] = names, rtde_wire.recipe(types)
        self._claimed |= dict.fromkeys(names, client)
        return bytes([number]) + ",".join(types).encode()

    def _inputs(self, client: _Client, payload: bytes) -> bool:
        known = client.inputs.get(payload[0] if payload else 0)
        if not client.started or known is None or len(payload) != known[1].size:
            self.counts[Event.MALFORMED] += 1
            return False
        values = known[1].unpack(payload)[1:]
        if not all(map(math.isfinite, values)):
            self.counts[Event.MALFORMED] += 1
            return False
        self.counts[Event.RECEIVED] += 1
        self.registers |= dict(zip(known[0], values, strict=True))
        return True


def _names(payload: bytes) -> list[str]:
    if len(payload) > rtde_wire.LONGEST_NAMES:
        raise rtde_wire.Broken
    return payload.decode("ascii", "replace").split(",")


class RtdeSensorServer(SensorServer):
    """An emulated controller that reports a force."""

    def __init__(self, settings: RtdeSettings) -> None:
        super().__init__(settings.where)
        self.period = 1.0 / settings.rate
        self.controller = Controller(settings, self.counts)

    def open(self) -> None:
        self.controller.open()

    def close(self) -> None:
        self.controller.close()

    def poll(self) -> bool:
        return self.controller.poll()

    def publish(self, wrench: Array, device_time: float, status: int = 0) -> None:
        fields = self.controller.fields
        fields["actual_TCP_force"] = fields["ft_raw_wrench"] = wrench.tolist()
        fields["safety_status_bits"] = [status or RUNNING["safety_status_bits"]]
        self.controller.poll()
        self.controller.publish(device_time)


class RtdePlatformServer(PlatformServer):
    """An emulated robot whose program follows the registers."""

    def __init__(self, settings: RtdeSettings) -> None:
        super().__init__(settings.where)
        self.period = 1.0 / settings.rate
        self.controller = Controller(settings, self.counts)
        self._names = [f"input_double_register_{settings.first_register + i}" for i in range(6)]
        self._counter = f"input_int_register_{settings.first_register}"
        self._started = False
        # compile now, not in the first cycle
        poses.pose_from_rotation_vector(poses.rotation_vector_from_pose(self.command))

    def open(self) -> None:
        self.controller.open()

    def close(self) -> None:
        self.controller.close()

    def poll(self) -> bool:
        registers = self.controller.registers
        if not self.controller.poll() or any(
            name not in registers for name in (*self._names, self._counter)
        ):
            return False
        if registers[self._counter] < 0:
            self.stopped = "the client asked for a stop"
            return False
        if self.stopped is None:
            frame = np.array([registers[name] for name in self._names])
            return self._obey(poses.pose_from_rotation_vector(frame))
        return False

    def wait(self, timeout: float, expected: float = math.inf) -> bool:
        until = time.monotonic() + timeout
        while not self.poll():
            left = until - time.monotonic()
            if left <= 0.0 or not self.controller.arrived(left):
                return False
        return True

    def publish(self, pose: Array, device_time: float, status: int = 0) -> None:
        fields = self.controller.fields
        if not self._started:
            self.command[:] = pose
            self._started = True
        fields["actual_TCP_pose"] = poses.rotation_vector_from_pose(pose).tolist()
        fields["target_TCP_pose"] = poses.rotation_vector_from_pose(self.command).tolist()
        fields["safety_status_bits"] = [status or RUNNING["safety_status_bits"]]
        self.poll()
        self.controller.publish(device_time)
