"""The packages of Universal Robots' Real-Time Data Exchange, protocol version 2, and a connection
that carries them.

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

HEADER = struct.Struct(">HB")
PROTOCOL_VERSION = 2
REQUEST_PROTOCOL_VERSION, GET_CONTROLLER_VERSION, TEXT_MESSAGE, DATA_PACKAGE = (
    ord("V"),
    ord("v"),
    ord("M"),
    ord("U"),
)
SETUP_OUTPUTS, SETUP_INPUTS, START, PAUSE = ord("O"), ord("I"), ord("S"), ord("P")
NOT_FOUND, IN_USE = "NOT_FOUND", "IN_USE"
TYPES = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}
LONGEST_NAMES = 2048  # [byte] of the list of fields of a recipe
AT_ONCE = 65536  # [byte] read from a connection at a time


class Broken(Exception):
    """The received data is not a package: the start of the next one is unknown, and the connection
    is unusable.
    """


def package(kind: int, payload: bytes = b"") -> bytes:
    return HEADER.pack(HEADER.size + len(payload), kind) + payload


def recipe(types: list[str]) -> struct.Struct:
    """The layout of a data package of fields of these types, its recipe's number first. Raises
    KeyError for an unknown type.
    """
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
        """The packages that have arrived completely. Raises Broken, and ConnectionError if the
        other side has closed.
        """
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
    """The text of a text message of protocol version 2: length and message, length and source,
    level.
    """
    length = payload[0] if payload else 0
    return payload[1 : 1 + length].decode("ascii", "replace")
