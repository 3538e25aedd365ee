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
import struct
import time
from collections.abc import Callable
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from hiltestbed.config.validation import Positive
from hiltestbed.devices import poses, rtde_wire, sockets
from hiltestbed.devices.interface import (
    Array,
    Clock,
    DeviceError,
    Event,
    Keeper,
    PlatformClient,
    Protocol,
    Sample,
    SensorClient,
)
from hiltestbed.devices.rtde_controller import RtdePlatformServer, RtdeSensorServer
from hiltestbed.devices.sequence import Sequence
from hiltestbed.devices.url import DeviceSettings

# safety_status_bits: normal or reduced mode; a stop, violation or fault of any kind
SAFETY_GOOD, SAFETY_STOPPED = 0b11, 0x7FC
PROGRAM_RUNNING = 0b10  # of robot_status_bits
NO_SAFE_MODE, NO_PROGRAM = 1 << 30, 1 << 31  # bits of the status word defined here
STOPPED = -1  # in the counter of commands


class RtdeSettings(DeviceSettings):
    """Options of ``rtde://``."""

    default_port: ClassVar[int] = 30004

    kind: Literal["rtde"] = "rtde"
    rate: Positive = Field(default=500.0, le=500, description="rate of the data packages [Hz]")
    wrench: Literal["actual_TCP_force", "ft_raw_wrench"] = Field(
        default="actual_TCP_force", description="field that a sensor reads"
    )
    first_register: int = Field(
        default=24, ge=0, le=42, description="first input register of the commanded pose"
    )
    need_program: bool = Field(
        default=True, description="whether a robot without a running program is an error"
    )
    connect: Positive = Field(
        default=2.0, description="time to wait for each answer while connecting [s]"
    )


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


class _Session:
    """The set-up of a connection and its data packages, for either client."""

    def __init__(
        self,
        settings: RtdeSettings,
        counts,
        outputs: list[str],
        inputs: list[str],
        take: Callable[[tuple], bool],
    ) -> None:
        """``take`` is called with the values of each good new data package, without the recipe's
        number.
        """
        self.settings, self.counts, self.take = settings, counts, take
        self.outputs, self.inputs = outputs, inputs
        self.stream: rtde_wire.Stream | None = None
        self.said = ""
        self._layout = struct.Struct(">B")
        self._input_layout = struct.Struct(">B")
        self._output_id = self._input_id = 0
        self._first_time = math.nan
        self._sequence = Sequence(counts, bits=62)

    def open(self) -> None:
        settings = self.settings
        address = sockets.resolve(settings.host, settings.port, settings.where)
        self.stream = rtde_wire.Stream(
            sockets.connected_tcp(address, settings.where, settings.connect)
        )
        self._first_time = math.nan
        self._sequence.restart()
        self._accepted(
            rtde_wire.REQUEST_PROTOCOL_VERSION,
            struct.pack(">H", rtde_wire.PROTOCOL_VERSION),
            "protocol version 2",
        )
        names = ",".join(self.outputs).encode()
        self._output_id, self._layout = self._recipe(
            rtde_wire.SETUP_OUTPUTS, struct.pack(">d", settings.rate) + names, self.outputs
        )
        if self.inputs:
            self._input_id, self._input_layout = self._recipe(
                rtde_wire.SETUP_INPUTS, ",".join(self.inputs).encode(), self.inputs
            )
        self._accepted(rtde_wire.START, b"", "the start of the exchange")

    def close(self) -> None:
        if self.stream is not None:
            self.stream.connection.close()
            self.stream = None

    def fileno(self) -> int:
        return self.stream.connection.fileno() if self.stream is not None else -1

    def poll(self) -> bool:
        """Process what has arrived; True if a new data package was accepted."""
        new = False
        if self.stream is None:
            return False
        try:
            for kind, payload in self.stream.receive():
                new = self._data(kind, payload) or new
        except rtde_wire.Broken:
            self.counts[Event.MALFORMED] += 1
            self._lose()
        except OSError:
            self._lose()
        return new

    def send(self, values: list[float | int]) -> None:
        if self.stream is None:
            return
        try:
            self.stream.send(
                rtde_wire.DATA_PACKAGE, self._input_layout.pack(self._input_id, *values)
            )
        except OSError:
            self._lose()

    def _lose(self) -> None:
        self.counts[Event.GONE] += 1
        self.close()

    def _data(self, kind: int, payload: bytes) -> bool:
        if kind == rtde_wire.TEXT_MESSAGE:
            self.said = rtde_wire.text_of(payload)
            return False
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
        elapsed = round(elapsed) if math.isfinite(elapsed) else -1
        if elapsed < 0:
            self.counts[Event.REORDERED] += 1
            return False
        return self._sequence.judge(elapsed) and self.take(values)

    def note(self, sample: Sample, values: Array, device_time: float, status: int) -> bool:
        """Take a package into ``sample``."""
        return sample.take(values, self.counts, self._sequence.newest, device_time, status)

    def _ask(self, kind: int, payload: bytes, what: str) -> bytes:
        where, stream = self.settings.where, self.stream
        if stream is None:
            raise DeviceError(f"{where}: is not open")
        until = time.monotonic() + self.settings.connect
        try:
            stream.send(kind, payload)
            while (left := until - time.monotonic()) > 0.0:
                sockets.readable(stream.connection, left)
                for answered, answer in stream.receive():
                    if answered == kind:
                        return answer
                    if answered == rtde_wire.TEXT_MESSAGE:
                        self.said = rtde_wire.text_of(answer)
        except (OSError, rtde_wire.Broken) as error:
            self.close()
            raise DeviceError(
                f"{where}: the connection broke at {what} ({error or 'not RTDE'}); check the "
                f"address and port"
            ) from None
        self.close()
        raise DeviceError(
            f"{where}: no answer to {what} in {self.settings.connect:g} s; check that this is an "
            f"RTDE interface"
        )

    def _accepted(self, kind: int, payload: bytes, what: str) -> None:
        if self._ask(kind, payload, what)[:1] != b"\x01":
            self.close()
            raise DeviceError(
                f"{self.settings.where}: the controller refuses {what} {self.said}".rstrip()
                + "; check its software version"
            )

    def _recipe(self, kind: int, payload: bytes, names: list[str]) -> tuple[int, struct.Struct]:
        answer = self._ask(kind, payload, "the set-up of its fields")
        types = answer[1:].decode("ascii", "replace").split(",")
        wrong = [
            f"{name}: {kind}"
            for name, kind in zip(names, types, strict=False)
            if kind not in rtde_wire.TYPES
        ]
        if wrong or len(types) != len(names):
            self.close()
            hint = (
                f"{rtde_wire.NOT_FOUND}: an older controller; {rtde_wire.IN_USE}: "
                f"another client has it, give another register"
            )
            raise DeviceError(
                f"{self.settings.where}: the controller does not give {', '.join(wrong) or names} "
                f"({hint})"
            )
        return answer[0], rtde_wire.recipe(types)


class RtdeSensorClient(SensorClient):
    """A sensor that reads the force reported by a robot's controller."""

    def __init__(self, settings: RtdeSettings) -> None:
        super().__init__(settings.where)
        self.period = 1.0 / settings.rate
        self._session = _Session(
            settings,
            self.counts,
            ["timestamp", settings.wrench, "safety_status_bits"],
            [],
            self._take,
        )

    def open(self) -> None:
        self._session.open()

    def close(self) -> None:
        self._session.close()

    def fileno(self) -> int:
        return self._session.fileno()

    def poll(self) -> bool:
        return self._session.poll()

    def _take(self, values: tuple) -> bool:
        wrench = np.array(values[1:7])
        return self._session.note(self.reading, wrench, values[0], status_of(values[7], None))


def register_names(first: int) -> list[str]:
    """The input registers of a commanded pose: six doubles and the counter."""
    return [f"input_double_register_{first + i}" for i in range(6)] + [
        f"input_int_register_{first}"
    ]


class RtdePlatformClient(PlatformClient):
    """A robot that follows the pose in its input registers."""

    def __init__(self, settings: RtdeSettings) -> None:
        super().__init__(settings.where)
        self.settings = settings
        self.clock = Clock.DEVICE
        self.period = 1.0 / settings.rate
        outputs = ["timestamp", "actual_TCP_pose", "safety_status_bits", "robot_status_bits"]
        self._session = _Session(
            settings, self.counts, outputs, register_names(settings.first_register), self._take
        )
        self._registers: list[float | int] = [0.0] * 6 + [0]
        self._sent = 0
        # compile now, not in the first cycle
        poses.pose_from_rotation_vector(poses.rotation_vector_from_pose(self.state.pose))

    def open(self) -> None:
        self._session.open()
        if not self.wait(self.settings.connect):
            seen = f"; its status is {self.state.status:#x}" if self.state.status else ""
            self.close()
            raise DeviceError(
                f"{self.where}: no pose in {self.settings.connect:g} s{seen}; check the robot's "
                f"mode, and start its program"
            )
        self._sent = 0
        self._registers[:6] = poses.rotation_vector_from_pose(self.state.pose).tolist()
        self.hold()

    def close(self) -> None:
        self._session.close()

    def fileno(self) -> int:
        return self._session.fileno()

    def poll(self) -> bool:
        return self._session.poll()

    def _take(self, values: tuple) -> bool:
        robot = values[8] if self.settings.need_program else None
        pose = poses.pose_from_rotation_vector(np.array(values[1:7]))
        return self._session.note(self.state, pose, values[0], status_of(values[7], robot))

    def command(self, pose: Array) -> None:
        self._check(pose)
        self._registers[:6] = poses.rotation_vector_from_pose(pose).tolist()
        self.hold()

    def hold(self) -> None:
        self._sent = (self._sent + 1) & 0x7FFFFFFF
        self._registers[6] = self._sent
        self.held[:7] = self._registers
        self._session.send(self._registers)

    def stop(self) -> None:
        self._registers[6] = STOPPED
        self._session.send(self._registers)


class RtdeKeeper(Keeper):
    """Pauses the exchange on the loop's connection: the controller's own watchdog of its registers
    then stops the robot.

    To hold, nothing is needed: the registers keep their last values.
    """

    def __init__(self, settings: RtdeSettings, fileno: int) -> None:
        super().__init__(settings, fileno)
        self._stream = rtde_wire.Stream(sockets.adopted(fileno))

    def hold(self, held: Array) -> None:
        """Send nothing: an input register keeps its value."""

    def stop(self, held: Array) -> None:
        try:
            self._stream.send(rtde_wire.PAUSE)
        except OSError:
            return


PROTOCOL = Protocol(
    scheme="rtde",
    summary="Universal Robots by Real-Time Data Exchange, TCP",
    settings=RtdeSettings,
    sensor_client=RtdeSensorClient,
    platform_client=RtdePlatformClient,
    sensor_server=RtdeSensorServer,
    platform_server=RtdePlatformServer,
    keeper=RtdeKeeper,
)
