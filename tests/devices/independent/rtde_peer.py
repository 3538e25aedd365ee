"""A controller of Universal Robots' RTDE, written from its guide and sharing nothing.

A package: uint16 size with its header, uint8 type, payload; big-endian. Types: V protocol version,
O outputs, I inputs, S start, P pause, U data, M text.
"""

from __future__ import annotations

import socket
import struct
import threading
import time


def _exactly(connection: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        piece = connection.recv(count - len(data))
        if not piece:
            raise ConnectionError
        data += piece
    return data


def receive(connection: socket.socket) -> tuple[str, bytes]:
    size, kind = struct.unpack("!HB", _exactly(connection, 3))
    return chr(kind), _exactly(connection, size - 3)


def send(connection: socket.socket, kind: str, payload: bytes = b"") -> None:
    connection.sendall(struct.pack("!HB", 3 + len(payload), ord(kind)) + payload)


class IndependentController:
    """Accepts one client and answers as a controller does; then sends ``state()``: (timestamp,
    pose, safety bits, robot bits).
    """

    KNOWN = {
        "timestamp": "DOUBLE",
        "actual_TCP_pose": "VECTOR6D",
        "actual_TCP_force": "VECTOR6D",
        "safety_status_bits": "UINT32",
        "robot_status_bits": "UINT32",
    }

    def __init__(self, values: dict, period: float = 0.008, in_use: bool = False) -> None:
        self.values, self.period, self.in_use = values, period, in_use
        self.received: list[tuple] = []
        self.paused = False
        self.timestamp = 1000.0
        self._listening = socket.create_server(("127.0.0.1", 0))
        self._listening.settimeout(5.0)
        self.port = self._listening.getsockname()[1]
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            connection, _ = self._listening.accept()
        except OSError:
            return
        connection.settimeout(5.0)
        outputs: list[str] = []
        inputs = 0
        try:
            while True:
                kind, payload = receive(connection)
                if kind == "V":
                    send(connection, "M", b"\x05hello\x02UR\x03")
                    send(connection, "V", bytes([payload == b"\x00\x02"]))
                elif kind == "O":
                    outputs = payload[8:].decode().split(",")
                    send(
                        connection,
                        "O",
                        b"\x01"
                        + ",".join(self.KNOWN.get(name, "NOT_FOUND") for name in outputs).encode(),
                    )
                elif kind == "I":
                    names = payload.decode().split(",")
                    inputs = len(names)
                    types = [
                        "IN_USE" if self.in_use else "INT32" if "int" in name else "DOUBLE"
                        for name in names
                    ]
                    send(connection, "I", b"\x03" + ",".join(types).encode())
                elif kind == "S":
                    send(connection, "S", b"\x01")
                    break
            self._exchange(connection, outputs, inputs)
        except OSError:
            pass
        finally:
            connection.close()

    def _exchange(self, connection: socket.socket, outputs: list[str], inputs: int) -> None:
        connection.settimeout(self.period)
        pending = b""
        while not self._stop.is_set():
            self.timestamp += self.period
            values = self.values | {"timestamp": [self.timestamp]}
            payload = b"\x01"
            for name in outputs:
                payload += struct.pack(
                    "!" + ("I" if "bits" in name else "d") * len(values[name]), *values[name]
                )
            send(connection, "U", payload)
            until = time.monotonic() + self.period
            while time.monotonic() < until:
                try:
                    piece = connection.recv(4096)
                except TimeoutError:
                    continue
                if not piece:
                    raise ConnectionError
                pending += piece
                while len(pending) >= 3 and len(pending) >= (
                    size := int.from_bytes(pending[:2], "big")
                ):
                    package, pending = pending[:size], pending[size:]
                    if package[2:3] == b"P":
                        self.paused = True
                    elif package[2:3] == b"U":
                        assert package[3] == 3
                        self.received.append(
                            struct.unpack("!" + "d" * (inputs - 1) + "i", package[4:])
                        )

    def close(self) -> None:
        self._stop.set()
        self._listening.close()
        self._thread.join()
