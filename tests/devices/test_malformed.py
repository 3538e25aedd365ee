"""Datagrams that are none of the protocol's: nothing that the loop or the device goes by changes."""

from __future__ import annotations

import os
import socket
import struct
import zlib
from collections.abc import Callable

import numpy as np

from hiltestbed.devices.interface import Client, Event, Link, PlatformServer
from hiltestbed.devices.rsi import RsiClient
from hiltestbed.devices.rtde_controller import RtdePlatformServer
from hiltestbed.devices.shm import attach
from hiltestbed.devices.table import platform_client, platform_server, sensor_client
from tests.devices.independent import rtde_peer
from tests.devices.running import START, free_ports, going, until

COUNT = 300
TURNED_AWAY = [Event.MALFORMED, Event.SENDER, Event.REPEATED, Event.REORDERED, Event.STATUS]


def _state(link: Link) -> list:
    """All that goes on from a link to whoever uses it."""
    if isinstance(link, Client):
        sample = link.sample
        clock = repr(sample.device_time)
        return [sample.values.tolist(), sample.sequence, clock, sample.status, sample.arrival]
    assert isinstance(link, PlatformServer)
    return [link.command.tolist(), link.commanded, link.stopped]


def _rubbish(rng: np.random.Generator, longest: int = 200) -> bytes:
    return rng.bytes(int(rng.integers(0, longest)))


def _throw(
    link: Link, sender: socket.socket, towards: tuple[str, int], make: Callable[[int], bytes]
) -> None:
    """Send them all, and see that each is rejected and nothing has changed."""
    state, before = _state(link), link.counts.copy()
    for k in range(COUNT):
        sender.sendto(make(k), towards)
        if k % 50 == 49:
            until(lambda k=k: link.poll() or (link.counts - before)[TURNED_AWAY].sum() > k)
    assert _state(link) == state
    happened = link.counts - before
    assert happened[Event.MALFORMED] >= 0.9 * COUNT
    assert happened[Event.RECEIVED] == happened[Event.LOST] == 0


def _udp_socket(port: int = 0) -> socket.socket:
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.bind(("127.0.0.1", port))
    return opened


def test_rdt_client() -> None:
    rng = np.random.default_rng(1)
    device = _udp_socket()
    port = device.getsockname()[1]
    client = sensor_client(f"rdt://127.0.0.1:{port}?counts_per_force=1&counts_per_torque=1")
    device.setblocking(False)
    answered: list[tuple[str, int]] = []

    def stream() -> None:
        try:
            answered.append(device.recvfrom(100)[1])
        except BlockingIOError:
            return
        device.sendto(struct.pack(">3I6i", 1, 7, 0, 1, 2, 3, 4, 5, 6), answered[-1])

    with going(stream):
        client.open()

    def bad(k: int) -> bytes:
        """Of 36 bytes, too: a number that cannot follow the last one is not believed."""
        return rng.bytes(36 if k % 3 == 0 else 36 * int(rng.integers(0, 4)) + 1 + k % 35)

    _throw(client, device, answered[-1], bad)
    client.close()
    device.close()


GOOD = '<Rob Type="KUKA"><RIst X="{x}" Y="0" Z="0" A="0" B="0" C="0"/><IPOC>{ipoc}</IPOC></Rob>'


def _good(x: str = "1", ipoc: object = 9_000_008) -> str:
    return GOOD.format(x=x, ipoc=ipoc)


WRONG_TELEGRAMS = [
    "<Rob>",
    GOOD.replace("Rob", "Bob"),
    _good("nan"),
    _good(""),
    _good(ipoc="-9000008"),
    _good(ipoc="9" * 400),
    _good(ipoc="٩٠٠٠٠٠٨"),
    _good(ipoc=9_000_009),  # not a whole number of cycles
    _good(ipoc=90_000_000_000),  # hours ahead
    _good().replace(' C="0"', ""),
    _good() + _good(),
    _good() + " " * 5000,
    '<!DOCTYPE Rob [<!ENTITY a "1">]>' + _good("&a;"),
    '<!DOCTYPE Rob SYSTEM "file:///etc/passwd">' + _good(),
    '<?xml version="1.0" encoding="no-such"?>' + _good(),
    "<?go away?>" + _good(),
]


def _telegram(rng: np.random.Generator, k: int) -> bytes:
    if k < len(WRONG_TELEGRAMS):
        return WRONG_TELEGRAMS[k].encode()
    if k % 3 == 0:
        return _rubbish(rng, 1000)
    good = _good("12.5").encode()
    if k % 3 == 1:
        return good[: int(rng.integers(1, len(good)))]
    return rng.permutation(np.frombuffer(good, np.uint8)).tobytes()


def test_rsi_client() -> None:
    (port,) = free_ports(1)
    client = platform_client(f"rsi://127.0.0.1:{port}")
    assert isinstance(client, RsiClient)
    rng = np.random.default_rng(3)
    with _udp_socket() as robot, _udp_socket() as stranger:
        good = _good("10.0", 9_000_000).encode()
        with going(lambda: robot.sendto(good, ("127.0.0.1", port))):
            client.open()
        client.poll()
        start = client.start.copy()
        _throw(client, robot, ("127.0.0.1", port), lambda k: _telegram(rng, k))
        np.testing.assert_array_equal(client.start, start)
        stranger.sendto(_good(ipoc=9_000_004).encode(), ("127.0.0.1", port))
        until(lambda: client.poll() or client.counts[Event.SENDER] == 1)
        assert client.state.sequence == 9_000_000
    client.close()


def test_udp_client() -> None:
    """The default layout: each bit that flips is told by the CRC."""
    ours, theirs = free_ports(2)
    rng = np.random.default_rng(5)
    client = platform_client(f"udp://127.0.0.1:{theirs}?listen={ours}&connect=5")
    body = struct.pack("<IdI7d", 5, 0.25, 0, *START)
    good = body + zlib.crc32(body).to_bytes(4, "little")
    with _udp_socket(theirs) as device:
        with going(lambda: device.sendto(good, ("127.0.0.1", ours))):
            client.open()
        client.poll()

        def bad(k: int) -> bytes:
            data = bytearray(good)
            place = int(rng.integers(0, 8 * len(data)))
            data[place // 8] ^= 1 << place % 8
            return bytes(data) if k % 2 else _rubbish(rng)

        _throw(client, device, ("127.0.0.1", ours), bad)
    client.close()


def test_rtde_client() -> None:
    """Packages with the right frame and the wrong inside; then bytes that are no package at all,
    which end the connection.
    """
    rng = np.random.default_rng(7)
    values = {"actual_TCP_pose": [0.1] * 6, "safety_status_bits": [1], "robot_status_bits": [3]}
    inside = {"thrown": 0}

    class Controller(rtde_peer.IndependentController):
        def _exchange(self, connection: socket.socket, outputs: list[str], inputs: int) -> None:
            rtde_peer.send(connection, "U", struct.pack("!B7d2I", 1, 1000.0, *[0.1] * 6, 1, 3))
            until(lambda: inside["thrown"] == 1)
            for k in range(COUNT):
                size = 65 + int(rng.integers(1, 40)) * (1 if k % 2 else -1)
                nan = struct.pack("!B7d2I", 1, *[float("nan")] * 7, 1, 3)
                wrong_recipe = struct.pack("!B7d2I", 9, *[2000.0] * 7, 1, 3)
                rtde_peer.send(connection, "U", [rng.bytes(max(size, 0)), nan, wrong_recipe][k % 3])
            until(lambda: inside["thrown"] == 2)
            connection.sendall(b"\x00\x01\xff" + rng.bytes(500))
            until(lambda: inside["thrown"] == 3)

    controller = Controller(values)
    client = platform_client(f"rtde://127.0.0.1:{controller.port}?connect=5")
    client.open()
    state = _state(client)
    inside["thrown"] = 1
    until(lambda: client.poll() or client.counts[Event.MALFORMED] == COUNT)
    inside["thrown"] = 2
    until(lambda: client.poll() or client.counts[Event.GONE] == 1)
    inside["thrown"] = 3
    assert _state(client) == state
    client.close()
    controller.close()


def test_rtde_server() -> None:
    rng = np.random.default_rng(8)
    with platform_server("rtde://127.0.0.1:0") as server:
        assert isinstance(server, RtdePlatformServer)
        server.publish(START, 0.0)
        state = _state(server)
        for k in range(COUNT):
            data = rng.bytes(int(rng.integers(3, 60)))
            head = struct.pack("!HB", 3 + len(data), ord("UIO"[k % 3]))
            with socket.create_connection(server.address, 2.0) as stranger:
                stranger.sendall(data if k % 2 else head + data)
            server.poll()
        until(lambda: server.poll() or not server._clients)
        assert _state(server) == state
        assert server.counts[Event.RECEIVED] == 0


def test_shm_client() -> None:
    rng = np.random.default_rng(9)
    name = f"hiltestbed-test-{os.getpid()}-malformed"
    with platform_server(f"shm://{name}") as server:
        server.publish(START, 0.5)
        with platform_client(f"shm://{name}") as client:
            intruder = attach(f"{name}.state")
            state = _state(client)
            for _ in range(COUNT):
                intruder._words[1:] = rng.integers(0, 2**63, 5, dtype=np.uint64)
                intruder._numbers[:] = np.frombuffer(rng.bytes(64))
                assert not client.poll()
            assert _state(client) == state
            intruder.close()
