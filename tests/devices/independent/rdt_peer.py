"""A sensor of ATI's Raw Data Transfer, written from the manual (document 9620-05-NET
FT, section 10) and sharing nothing.

Big-endian throughout. Request: uint16 0x1234, uint16 command, uint32 count. Record: uint32
rdt_sequence, ft_sequence, status, int32 Fx Fy Fz Tx Ty Tz; value = counts / counts per unit.
"""

from __future__ import annotations

import socket
import threading
import time


def _u32(value: int) -> bytes:
    return value.to_bytes(4, "big")


class IndependentRdtSensor:
    """Streams ``wrench(k)`` in counts, k counting the records of a request, from a thread of its
    own.
    """

    def __init__(
        self, counts, period: float = 0.002, first_sample: int = 7000, per_sample: int = 7
    ) -> None:
        self.counts, self.period, self.sample, self.per_sample = (
            counts,
            period,
            first_sample,
            per_sample,
        )
        self.status = 0
        self.requests: list[bytes] = []
        self.ignore = 0  # requests to leave unanswered, as if they had been lost
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.001)
        self.port = self.socket.getsockname()[1]
        self._client, self._number, self._records = None, 0, 1
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        due = time.monotonic()
        while not self._stop.is_set():
            try:
                data, sender = self.socket.recvfrom(100)
                self._obey(data, sender)
            except OSError:
                pass
            if time.monotonic() >= due:
                due = time.monotonic() + self.period
                self._send()

    def _obey(self, data: bytes, sender) -> None:
        self.requests.append(data)
        assert len(data) == 8
        assert data[:2] == b"\x12\x34"
        command = int.from_bytes(data[2:4], "big")
        if command in (2, 3):
            if self.ignore:
                self.ignore -= 1
                return
            self._client, self._number, self._records = sender, 0, 1 if command == 2 else 5
        elif command == 0:
            self._client = None

    def _send(self) -> None:
        if self._client is None:
            return
        datagram = b""
        for _ in range(self._records):
            self._number += 1
            self.sample += self.per_sample
            datagram += _u32(self._number) + _u32(self.sample) + _u32(self.status)
            datagram += b"".join(
                int(c).to_bytes(4, "big", signed=True) for c in self.counts(self._number)
            )
        self.socket.sendto(datagram, self._client)

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.socket.close()
