"""``rtde://``: Universal Robots by Real-Time Data Exchange over TCP.

Universal Robots, "Real-Time Data Exchange (RTDE) Guide" (fields, types, set-up, data packages); the
framing is in
:mod:`hiltestbed.devices.rtde_wire`. The controller sends the requested fields at up to 500 Hz (125
Hz on CB3). A pose is commanded through six input registers (double, from ``first_register`` on: x y
z rx ry rz, m and rad) and one integer register, number ``first_register``, which counts the
commands and is -1 for stop; a program on the robot follows them, for instance

    while (read_input_integer_register(24) >= 0):
      servoj(get_inverse_kin(p[read_input_float_register(24), ..., read_input_float_register(29)]),
      t=0.002, lookahead_time=0.03)
    end
    stopj(10)

with ``rtde_set_watchdog("input_int_register_24", 10, "STOP")`` before it. Registers 24 to 47 are
those for external clients. ``actual_TCP_force`` is in the axes of the base, at the tool centre
point, and compensated for the payload; ``ft_raw_wrench`` is the raw sensor.

The library ur_rtde is only a client, with its own threads, control script and timing: it cannot
emulate the device, nor be read without waiting. The part of the protocol needed here is small and
implemented here.
"""

from __future__ import annotations

import math
import socket
import struct
import time
from abc import abstractmethod
from collections.abc import Sequence as Values
from contextlib import suppress
from typing import NoReturn

import numpy as np

from hiltestbed.devices import poses, rtde_wire, sockets
from hiltestbed.devices.interface import (
    Array,
    Client,
    DeviceError,
    Event,
    PlatformClient,
    Protocol,
    SensorClient,
)
from hiltestbed.devices.rtde_controller import RtdePlatformServer, RtdeSensorServer
from hiltestbed.devices.rtde_wire import RtdeSettings
from hiltestbed.devices.sequence import Sequence

# safety_status_bits: normal or reduced mode; a stop, violation or fault of any kind
SAFETY_GOOD, SAFETY_STOPPED = 0b11, 0x7FC
PROGRAM_RUNNING = 0b10  # of robot_status_bits
NO_SAFE_MODE, NO_PROGRAM = 1 << 30, 1 << 31  # bits of the status word defined here
STOPPED = -1  # in the counter of commands


def status_of(safety: int, robot: int | None) -> int:
    """The status word: 0 for a robot in normal or reduced mode, with a running program if ``robot``
    status bits are given.
    """
    status = safety & SAFETY_STOPPED
    if not safety & SAFETY_GOOD:
        status |= NO_SAFE_MODE
    if robot is not None and not robot & PROGRAM_RUNNING:
        status |= NO_PROGRAM
    return status


class _RtdeClient(Client):
    """The set-up of a connection and its data packages, for either client."""

    settings: RtdeSettings
    _outputs: Values[str]  # received; the time stamp first
    _inputs: Values[str] = ()  # sent

    def __init__(self, settings: RtdeSettings) -> None:
        super().__init__(settings)
        self._stream: rtde_wire.Stream | None = None
        self._said = ""
        self._layout = self._input_layout = struct.Struct(">B")
        self._output_id = self._input_id = 0
        self._first_time = math.nan
        self._sequence = Sequence(self.counts, bits=62)

    def open(self) -> None:
        settings = self.settings
        address = sockets.resolve(settings.host, settings.port, self.where)
        connection = sockets.connected_tcp(address, self.where, settings.connect)
        self._stream = rtde_wire.Stream(connection)
        self._first_time = math.nan
        self._sequence.restart()
        version = struct.pack(">H", rtde_wire.PROTOCOL_VERSION)
        self._accepted(rtde_wire.REQUEST_PROTOCOL_VERSION, version, "protocol version 2")
        self._output_id, self._layout = self._recipe(
            rtde_wire.SETUP_OUTPUTS, struct.pack(">d", settings.rate), self._outputs
        )
        if self._inputs:
            self._input_id, self._input_layout = self._recipe(
                rtde_wire.SETUP_INPUTS, b"", self._inputs
            )
        self._accepted(rtde_wire.START, b"", "the start of the exchange")

    def close(self) -> None:
        if self._stream is not None:
            self._stream.connection.close()
            self._stream = None

    def fileno(self) -> int:
        return self._stream.connection.fileno() if self._stream is not None else -1

    def poll(self) -> bool:
        new = False
        if self._stream is None:
            return False
        try:
            for kind, payload in self._stream.receive():
                new = self._data(kind, payload) or new
        except rtde_wire.Broken:
            self.counts[Event.MALFORMED] += 1
            self._lose()
        except OSError:
            self._lose()
        return new

    def _write(self, values: Values[float | int]) -> None:
        """Send the inputs."""
        if self._stream is None:
            return
        payload = self._input_layout.pack(self._input_id, *values)
        try:
            self._stream.send(rtde_wire.DATA_PACKAGE, payload)
        except OSError:
            self._lose()

    def _lose(self) -> None:
        self.counts[Event.GONE] += 1
        self.close()

    def _data(self, kind: int, payload: bytes) -> bool:
        if kind == rtde_wire.TEXT_MESSAGE:
            self._said = rtde_wire.text_of(payload)
        if kind != rtde_wire.DATA_PACKAGE:
            return False
        fits = len(payload) == self._layout.size and payload[0] == self._output_id
        values = self._layout.unpack(payload)[1:] if fits else (math.nan,)
        if not all(map(math.isfinite, values)):
            self.counts[Event.MALFORMED] += 1
            return False
        if math.isnan(self._first_time):
            self._first_time = values[0]
        elapsed = (values[0] - self._first_time) * self.settings.rate
        if not 0.0 <= elapsed + 0.5 < math.inf:
            self.counts[Event.REORDERED] += 1
            return False
        if not self._sequence.judge(round(elapsed)):
            return False
        taken, status = self._understood(np.array(values[1:7]), *values[7:])
        return self.sample.take(taken, self.counts, self._sequence.newest, values[0], status)

    @abstractmethod
    def _understood(self, values: Array, safety: int, *robot: int) -> tuple[Array, int]:
        """What a package says in SI, from its vector (6,), and the status from its bits."""

    def _ask(self, kind: int, payload: bytes, what: str) -> bytes:
        stream = self._stream
        if stream is None:
            raise DeviceError(f"{self.where}: is not open")
        until = time.monotonic() + self.settings.connect
        try:
            stream.send(kind, payload)
            while (left := until - time.monotonic()) > 0.0:
                sockets.readable(stream.connection, left)
                for answered, answer in stream.receive():
                    if answered == kind:
                        return answer
                    if answered == rtde_wire.TEXT_MESSAGE:
                        self._said = rtde_wire.text_of(answer)
        except (OSError, rtde_wire.Broken) as error:
            reason = str(error) or "not RTDE"
            self._refuse(f"the connection broke at {what} ({reason}); check the address and port")
        self._refuse(
            f"no answer to {what} in {self.settings.connect:g} s; check that this is an RTDE "
            f"interface"
        )

    def _refuse(self, reason: str) -> NoReturn:
        self.close()
        raise DeviceError(f"{self.where}: {reason}") from None

    def _accepted(self, kind: int, payload: bytes, what: str) -> None:
        if self._ask(kind, payload, what)[:1] != b"\x01":
            said = f"the controller refuses {what} {self._said}".rstrip()
            self._refuse(f"{said}; check its software version")

    def _recipe(self, kind: int, head: bytes, names: Values[str]) -> tuple[int, struct.Struct]:
        answer = self._ask(kind, head + ",".join(names).encode(), "the set-up of its fields")
        types = answer[1:].decode("ascii", "replace").split(",")
        given = zip(names, types, strict=False)
        wrong = [f"{name}: {kind}" for name, kind in given if kind not in rtde_wire.TYPES]
        if wrong or len(types) != len(names):
            self._refuse(
                f"the controller does not give {', '.join(wrong) or names} "
                f"({rtde_wire.NOT_FOUND}: an older controller; {rtde_wire.IN_USE}: another client "
                f"has it, give another register)"
            )
        return answer[0], rtde_wire.recipe(types)


class RtdeSensorClient(_RtdeClient, SensorClient):
    """A sensor that reads the force reported by a robot's controller."""

    def __init__(self, settings: RtdeSettings) -> None:
        super().__init__(settings)
        self._outputs = ["timestamp", settings.wrench, "safety_status_bits"]

    def _understood(self, values: Array, safety: int, *robot: int) -> tuple[Array, int]:
        return values, status_of(safety, None)


class RtdePlatformClient(_RtdeClient, PlatformClient):
    """A robot that follows the pose in its input registers."""

    _outputs = ("timestamp", "actual_TCP_pose", "safety_status_bits", "robot_status_bits")

    def __init__(self, settings: RtdeSettings) -> None:
        super().__init__(settings)
        self._inputs = settings.registers
        self._frame: Array = np.zeros(6)  # in the registers
        self._sent = 0

    def open(self) -> None:
        super().open()
        if not self.wait(self.settings.connect):
            seen = f"; its status is {self.state.status:#x}" if self.state.status else ""
            self._refuse(
                f"no pose in {self.settings.connect:g} s{seen}; check the robot's mode, and start "
                f"its program"
            )
        self._sent = 0
        self.command(self.state.pose)

    def _understood(self, values: Array, safety: int, *robot: int) -> tuple[Array, int]:
        running = robot[0] if self.settings.need_program else None
        return poses.pose_from_rotation_vector(values), status_of(safety, running)

    def command(self, pose: Array) -> None:
        self._check(pose)
        self._frame[:] = poses.rotation_vector_from_pose(pose)
        self.hold()

    def hold(self) -> None:
        self._sent = (self._sent + 1) & 0x7FFFFFFF
        self._write([*self._frame.tolist(), self._sent])

    def stop(self) -> None:
        self._write([*self._frame.tolist(), STOPPED])

    def adopt(self, fileno: int) -> None:
        self._stream = rtde_wire.Stream(socket.socket(fileno=fileno))

    def keep(self, held: Array, stop: bool) -> None:
        """An input register keeps its value; where the exchange pauses, the controller's own
        watchdog of its registers stops the robot.
        """
        if stop and self._stream is not None:
            with suppress(OSError):
                self._stream.send(rtde_wire.PAUSE)


PROTOCOL = Protocol(
    scheme="rtde",
    summary="Universal Robots by Real-Time Data Exchange, TCP",
    settings=RtdeSettings,
    sensor_client=RtdeSensorClient,
    platform_client=RtdePlatformClient,
    sensor_server=RtdeSensorServer,
    platform_server=RtdePlatformServer,
)
