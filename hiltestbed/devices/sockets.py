"""Sockets, and messages for those that cannot be opened. Each is bound to the given address only,
never to all interfaces.
"""

from __future__ import annotations

import errno
import select
import socket

from hiltestbed.devices.interface import DeviceError
from hiltestbed.errors import Fault, InputError

RECEIVE_BUFFER = 1 << 18  # [byte] some 0.5 s of records at the highest rate of the sensors

Address = tuple[str, int]


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
        raise InputError(Fault(where, None, None, "host", message)) from None
    return found[0][4][0], port  # type: ignore[return-value]


def bound_udp(address: Address, where: str) -> socket.socket:
    """A non-blocking UDP socket bound to ``address``. Raises InputError."""
    return _bound(socket.SOCK_DGRAM, address, where)


def listening_tcp(address: Address, where: str) -> socket.socket:
    """A non-blocking TCP socket that listens at ``address``. Raises InputError."""
    opened = _bound(socket.SOCK_STREAM, address, where)
    opened.listen(4)
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
        raise InputError(
            Fault(
                where,
                None,
                None,
                "",
                f"cannot be reached ({error.strerror}); check the address and the network",
            )
        ) from None
    return opened


def sending_udp(towards: Address, where: str) -> socket.socket:
    """A non-blocking UDP socket at an ephemeral port of the interface that leads to ``towards``."""
    probe = connected_udp(towards, where)
    own = probe.getsockname()[0]
    probe.close()
    return bound_udp((own, 0), where)


def connected_tcp(address: Address, where: str, timeout: float) -> socket.socket:
    """A TCP connection with TCP_NODELAY and a ``timeout`` [s]. Raises DeviceError."""
    try:
        opened = socket.create_connection(address, timeout)
    except OSError as error:
        reason = error.strerror or "no answer"
        raise DeviceError(
            f"{where}: no connection ({reason}); check that the device is on and that its "
            f"interface is enabled"
        ) from None
    opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return opened


def adopted(fileno: int) -> socket.socket:
    """The inherited socket with this file descriptor."""
    return socket.socket(fileno=fileno)


def readable(opened: socket.socket, timeout: float) -> bool:
    """Wait up to ``timeout`` [s] until something has arrived."""
    return bool(select.select([opened], [], [], max(timeout, 0.0))[0])


def _new(kind: int) -> socket.socket:
    opened = socket.socket(socket.AF_INET, kind)
    opened.setblocking(False)
    if kind == socket.SOCK_DGRAM:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
    return opened


_REASONS = {
    errno.EADDRINUSE: "is in use by another program; stop it or give another port",
    errno.EACCES: "may not be opened by this user; give a port from 1024 on",
    errno.EADDRNOTAVAIL: "is not an address of this machine; give one of its own, or 127.0.0.1",
}


def _bound(kind: int, address: Address, where: str) -> socket.socket:
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
        raise InputError(Fault(where, None, None, "", f"{name} {reason}")) from None
    return opened
