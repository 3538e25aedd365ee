"""Sockets, links over datagrams, and messages for what cannot be opened. Each socket is bound to
the given address only, never to all interfaces.
"""

from __future__ import annotations

import errno
import select
import socket

from hiltestbed.devices.interface import LONGEST_DRAIN, DeviceError, Event, Link
from hiltestbed.devices.url import refused

RECEIVE_BUFFER = 1 << 18  # [byte] some 0.5 s of records at the highest rate of the sensors

Address = tuple[str, int]

_REASONS = {
    errno.EADDRINUSE: "is in use by another program; stop it or give another port",
    errno.EACCES: "may not be opened by this user; give a port from 1024 on",
    errno.EADDRNOTAVAIL: "is not an address of this machine; give one of its own, or 127.0.0.1",
}


class Datagrams(Link):
    """A link over UDP: its socket, once it is open, and each datagram to :meth:`_take`."""

    _largest: int  # [byte] of a datagram; longer ones arrive cut off after one more
    _socket: socket.socket | None = None

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def fileno(self) -> int:
        return self._socket.fileno() if self._socket is not None else -1

    def poll(self) -> bool:
        new = False
        for _ in range(LONGEST_DRAIN):
            if self._socket is None:
                break
            try:
                data, sender = self._socket.recvfrom(self._largest + 1)
            except BlockingIOError:
                break
            # the other side's port is closed: each of our datagrams comes back once
            except OSError:
                self.counts[Event.GONE] += 1
                break
            new = self._take(data, sender) or new
        return new

    def _take(self, data: bytes, sender: Address) -> bool:
        """Process a datagram; True for a new good record."""
        raise NotImplementedError

    def _send_to(self, data: bytes | bytearray, towards: Address) -> None:
        """Send a datagram if the link is open."""
        if self._socket is not None:
            try:
                self._socket.sendto(data, towards)
            except OSError:
                self.counts[Event.GONE] += 1


def resolve(host: str, port: int, where: str) -> Address:
    """The numeric IPv4 address of ``host``. Raises InputError."""
    try:
        found = socket.getaddrinfo(host, port, socket.AF_INET)
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or error
        message = (
            f"is not an address (got {host!r}: {reason}); give an IPv4 address or a "
            f"name that this machine can look up"
        )
        raise refused(where, message, "host") from None
    return found[0][4][0], port  # type: ignore[return-value]


def bound(
    address: Address, where: str, kind: socket.SocketKind = socket.SOCK_DGRAM
) -> socket.socket:
    """A non-blocking socket bound to ``address``. Raises InputError."""
    opened = _new(kind)
    if kind == socket.SOCK_STREAM:
        # reuse a port whose last connection has just ended
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        opened.bind(address)
    except OSError as error:
        opened.close()
        reason = _REASONS.get(error.errno or 0, f"cannot be opened ({error.strerror})")
        name = f"{'TCP' if kind == socket.SOCK_STREAM else 'UDP'} {address[0]}:{address[1]}"
        raise refused(where, f"{name} {reason}") from None
    return opened


def connected_udp(address: Address, where: str) -> socket.socket:
    """A non-blocking UDP socket connected to ``address``: the kernel drops datagrams of other
    senders. Raises InputError.
    """
    opened = _new(socket.SOCK_DGRAM)
    try:
        opened.connect(address)
    except OSError as error:
        opened.close()
        message = f"cannot be reached ({error.strerror}); check the address and the network"
        raise refused(where, message) from None
    return opened


def connected_tcp(address: Address, where: str, timeout: float) -> socket.socket:
    """A TCP connection with TCP_NODELAY and a ``timeout`` [s]. Raises DeviceError."""
    try:
        opened = socket.create_connection(address, timeout)
    except OSError as error:
        raise DeviceError(
            f"{where}: no connection ({error.strerror or 'no answer'}); check that the device is "
            f"on and that its interface is enabled"
        ) from None
    opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return opened


def readable(opened: socket.socket, timeout: float) -> bool:
    """Wait up to ``timeout`` [s] until something has arrived."""
    return bool(select.select([opened], [], [], max(timeout, 0.0))[0])


def _new(kind: socket.SocketKind) -> socket.socket:
    opened = socket.socket(socket.AF_INET, kind)
    opened.setblocking(False)
    if kind == socket.SOCK_DGRAM:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
    return opened
