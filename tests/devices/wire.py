"""A wire between a device and a client that loses, delays, swaps and cuts what goes over it, one
cycle at a time.

Nothing here waits for a clock: the test sends, moves the datagrams over the wire, and reads. A
fault says what becomes of the datagrams of a cycle, and may keep some for the next.
"""

from __future__ import annotations

import socket
from collections.abc import Callable

from hiltestbed.devices.interface import Link
from tests.devices.running import until

Fault = Callable[[list[bytes]], list[bytes]]
Address = tuple[str, int]


def pass_on(datagrams: list[bytes]) -> list[bytes]:
    return datagrams


class Wire:
    """``near`` faces the client, ``far`` the device; an end that is not known is learned from what
    it sends.
    """

    def __init__(self, device: Address | None = None, client: Address | None = None) -> None:
        self.near, self.far = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        for end in (self.near, self.far):
            end.bind(("127.0.0.1", 0))
            end.setblocking(False)
        self.device, self.client = device, client

    def to_client(self, fault: Fault = pass_on) -> int:
        """Move what the device has sent; how many datagrams the client has been sent."""
        datagrams, sender = _all(self.far)
        self.device = sender or self.device
        sent = fault(datagrams)
        for data in sent:
            assert self.client is not None
            self.near.sendto(data, self.client)
        return len(sent)

    def to_device(self, fault: Fault = pass_on) -> int:
        """Move what the client has sent."""
        datagrams, sender = _all(self.near)
        self.client = sender or self.client
        sent = fault(datagrams)
        for data in sent:
            assert self.device is not None
            self.far.sendto(data, self.device)
        return len(sent)

    def both(self) -> None:
        self.to_device()
        self.to_client()

    def close(self) -> None:
        self.near.close()
        self.far.close()


def _all(end: socket.socket) -> tuple[list[bytes], Address | None]:
    found, sender = [], None
    while True:
        try:
            data, sender = end.recvfrom(65536)
        except OSError:
            return found, sender
        found.append(data)


def take_in(link: Link, datagrams: int) -> bool:
    """Poll until ``datagrams`` have been taken in; whether there was something new among them."""
    before, new = int(link.counts.sum()), link.poll()

    def all_taken() -> bool:
        nonlocal new
        if int(link.counts.sum()) - before < datagrams:
            new = link.poll() or new
            return False
        return True

    until(all_taken)
    return new


class OneCycleLate:
    """Keeps the datagrams of the cycles in ``cycles`` for the next."""

    ordered = staticmethod(lambda kept, new: [*kept, *new])

    def __init__(self, cycles: set[int]) -> None:
        self.cycles, self.cycle, self.kept = cycles, -1, []

    def __call__(self, datagrams: list[bytes]) -> list[bytes]:
        self.cycle += 1
        if self.cycle in self.cycles:
            self.kept += datagrams
            return []
        sent, self.kept = self.ordered(self.kept, datagrams), []
        return sent


class Swapped(OneCycleLate):
    """The same, but what was kept comes after that of the next cycle."""

    ordered = staticmethod(lambda kept, new: [*new, *kept])


class Changed:
    """Does ``change`` to each datagram of the cycles in ``cycles``; None loses it."""

    def __init__(self, cycles: set[int], change: Callable[[bytes], list[bytes]]) -> None:
        self.cycles, self.change, self.cycle = cycles, change, -1

    def __call__(self, datagrams: list[bytes]) -> list[bytes]:
        self.cycle += 1
        if self.cycle not in self.cycles:
            return datagrams
        return [new for data in datagrams for new in self.change(data)]
