"""The controller's side of Real-Time Data Exchange, for an emulated robot.

It answers the set-up requests of any client, and has the fields that a contact experiment needs:
others are NOT_FOUND. Framing and sources: :mod:`hiltestbed.devices.rtde_wire`.
"""

from __future__ import annotations

import math
import select
import socket
import struct
import time
from dataclasses import dataclass, field

import numpy as np

from hiltestbed.devices import poses, rtde_wire, sockets
from hiltestbed.devices.interface import Array, Event, Link, PlatformServer, SensorServer
from hiltestbed.devices.rtde_wire import RtdeSettings

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


class _Controller(Link):
    """Listens, sets up clients, sends them ``fields`` and receives ``registers``, by name."""

    settings: RtdeSettings

    def __init__(self, settings: RtdeSettings) -> None:
        super().__init__(settings)
        vectors = [name for name, kind in OUTPUTS.items() if kind == "VECTOR6D"]
        self.fields: dict[str, list[float]] = {name: [0.0] * 6 for name in vectors}
        self.fields |= {name: [value] for name, value in RUNNING.items()}
        self.registers: dict[str, float | int] = {}
        self.address: sockets.Address = (settings.host, settings.port)
        self._clients: list[_Client] = []
        self._socket: socket.socket | None = None

    def open(self) -> None:
        address = sockets.resolve(self.settings.host, self.settings.port, self.where)
        self._socket = sockets.bound(address, self.where, socket.SOCK_STREAM)
        self._socket.listen(4)
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
        self._accept(self._socket)
        new = False
        for client in self._clients[:]:
            try:
                for kind, payload in client.stream.receive():
                    new = self._serve(client, kind, payload) or new
            except (OSError, rtde_wire.Broken) as error:
                broken = isinstance(error, rtde_wire.Broken)
                self.counts[Event.MALFORMED if broken else Event.GONE] += 1
                self._drop(client)
        return new

    def wait(self, timeout: float, expected: float = math.inf) -> bool:
        until = time.monotonic() + timeout
        while not self.poll():
            left = until - time.monotonic()
            heard = [self._socket, *(client.stream.connection for client in self._clients)]
            if left <= 0.0 or self._socket is None or not select.select(heard, [], [], left)[0]:
                return False
        return True

    def _send(self, device_time: float) -> None:
        """Send the fields to each client that has started, at the rate that it requested."""
        self.fields["timestamp"] = [device_time]
        self.poll()
        for client in self._clients[:]:
            early = device_time < client.due - 0.25 / client.frequency
            if early or not client.started or client.layout is None:
                continue
            client.due = max(client.due, device_time) + 1.0 / client.frequency
            values = [value for name in client.outputs for value in self.fields[name]]
            try:
                client.stream.send(rtde_wire.DATA_PACKAGE, client.layout.pack(1, *values))
            except OSError:  # closed, or a client that does not read
                self.counts[Event.GONE] += 1
                self._drop(client)

    def _accept(self, listening: socket.socket) -> None:
        try:
            connection, _ = listening.accept()
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
            client.outputs, client.frequency = names, frequency
            client.layout = rtde_wire.recipe(types)
        return bytes([found]) + ",".join(types).encode()

    def _set_inputs(self, client: _Client, payload: bytes) -> bytes:
        names = _names(payload)
        recipes = (recipe for other in self._clients for recipe in other.inputs.values())
        taken = {name for claimed, _ in recipes for name in claimed}
        types = [
            rtde_wire.IN_USE if name in taken else INPUTS.get(name, rtde_wire.NOT_FOUND)
            for name in names
        ]
        if any(kind not in rtde_wire.TYPES for kind in types):
            return bytes([0]) + ",".join(types).encode()
        number = len(client.inputs) + 1
        if number > 255:
            raise rtde_wire.Broken
        client.inputs[number] = names, rtde_wire.recipe(types)
        return bytes([number]) + ",".join(types).encode()

    def _inputs(self, client: _Client, payload: bytes) -> bool:
        known, values = client.inputs.get(payload[0] if payload else 0), (math.nan,)
        if client.started and known is not None and len(payload) == known[1].size:
            values = known[1].unpack(payload)[1:]
        if known is None or not all(map(math.isfinite, values)):
            self.counts[Event.MALFORMED] += 1
            return False
        self.counts[Event.RECEIVED] += 1
        self.registers |= dict(zip(known[0], values, strict=True))
        return True


def _names(payload: bytes) -> list[str]:
    if len(payload) > rtde_wire.LONGEST_NAMES:
        raise rtde_wire.Broken
    return payload.decode("ascii", "replace").split(",")


class RtdeSensorServer(_Controller, SensorServer):
    """An emulated controller that reports a force."""

    def publish(self, wrench: Array, device_time: float) -> None:
        self.fields["actual_TCP_force"] = self.fields["ft_raw_wrench"] = wrench.tolist()
        self._send(device_time)


class RtdePlatformServer(_Controller, PlatformServer):
    """An emulated robot whose program follows the registers."""

    def poll(self) -> bool:
        names = self.settings.registers
        if not super().poll() or any(name not in self.registers for name in names):
            return False
        *frame, counter = (self.registers[name] for name in names)
        if counter < 0:
            self.stopped = "the client asked for a stop"
        if self.stopped is not None:
            return False
        return self._obey(poses.pose_from_rotation_vector(np.array(frame)))

    def publish(self, pose: Array, device_time: float) -> None:
        self._start(pose)
        for name, value in (("actual_TCP_pose", pose), ("target_TCP_pose", self.command)):
            self.fields[name] = poses.rotation_vector_from_pose(value).tolist()
        self._send(device_time)
