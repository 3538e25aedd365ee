"""The packages of Universal Robots' Real-Time Data Exchange, protocol version 2, a connection that
carries them, and the settings of both of its sides.

Universal Robots, "Real-Time Data Exchange (RTDE) Guide", sections "Protocol" and "Data types": a
package is its size (two bytes, this header included), its type (one byte, an ASCII letter) and a
payload, big-endian. Each request is answered by a package of the same type. A data package begins
with the number of its recipe; output recipes have a number and a selectable rate only in protocol
version 2.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from typing import ClassVar, Literal

from pydantic import Field

from hiltestbed.config.validation import Positive
from hiltestbed.devices.url import DeviceSettings

HEADER = struct.Struct(">HB")
PROTOCOL_VERSION = 2
REQUEST_PROTOCOL_VERSION, GET_CONTROLLER_VERSION, TEXT_MESSAGE, DATA_PACKAGE = b"VvMU"
SETUP_OUTPUTS, SETUP_INPUTS, START, PAUSE = b"OISP"
NOT_FOUND, IN_USE = "NOT_FOUND", "IN_USE"
TYPES = {"UINT32": "I", "INT32": "i", "DOUBLE": "d", "VECTOR6D": "6d"}  # of the fields used here
LONGEST_NAMES = 2048  # [byte] of the list of fields of a recipe
AT_ONCE = 65536  # [byte] read from a connection at a time


class RtdeSettings(DeviceSettings):
    """Options of ``rtde://``."""

    default_port: ClassVar[int] = 30004

    rate: Positive = Field(default=500.0, le=500)  # [Hz] of the data packages
    # field that a sensor reads
    wrench: Literal["actual_TCP_force", "ft_raw_wrench"] = "actual_TCP_force"
    first_register: int = Field(default=24, ge=0, le=42)  # of those of the commanded pose
    need_program: bool = True  # a robot without a running program is an error
    connect: Positive = 2.0  # [s] to wait for each answer while connecting

    @property
    def period(self) -> float:
        return 1.0 / self.rate

    @property
    def registers(self) -> list[str]:
        """The input registers of a commanded pose: six doubles and the counter."""
        first = self.first_register
        doubles = [f"input_double_register_{first + i}" for i in range(6)]
        return [*doubles, f"input_int_register_{first}"]


class Broken(Exception):
    """The received data is not a package: where the next one starts is unknown."""


def package(kind: int, payload: bytes = b"") -> bytes:
    return HEADER.pack(HEADER.size + len(payload), kind) + payload


def recipe(types: list[str]) -> struct.Struct:
    """The layout of a data package: its recipe's number, and fields of these ``TYPES``."""
    return struct.Struct(">B" + "".join(TYPES[name] for name in types))


class Stream:
    """Reads packages from the bytes of a connection, and sends them."""

    def __init__(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        self.connection = connection
        self._buffer = bytearray()

    def send(self, kind: int, payload: bytes = b"") -> None:
        """Send a package. Raises OSError; BlockingIOError if the other side does not read."""
        self.connection.sendall(package(kind, payload))

    def receive(self) -> Iterator[tuple[int, bytes]]:
        """The packages that have arrived completely. Raises Broken; ConnectionError if closed."""
        try:
            data = self.connection.recv(AT_ONCE)
        except BlockingIOError:
            data = None
        if data == b"":
            raise ConnectionResetError("closed by the other side")
        self._buffer += data or b""
        while len(self._buffer) >= HEADER.size:
            size, kind = HEADER.unpack_from(self._buffer)
            if size < HEADER.size or chr(kind) not in "VvMUOISPR":
                raise Broken
            if len(self._buffer) < size:
                break
            payload = bytes(self._buffer[HEADER.size : size])
            del self._buffer[:size]
            yield kind, payload


def text_of(payload: bytes) -> str:
    """The text of a text message: length and message, length and source, level."""
    length = payload[0] if payload else 0
    return payload[1 : 1 + length].decode("ascii", "replace")
