"""The watchdog: a loop that falls silent, hangs or dies leaves its platform held or stopped."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from hiltestbed.devices.interface import Event, PlatformClient
from hiltestbed.devices.table import platform_client, platform_server
from hiltestbed.devices.watchdog import Watchdog
from hiltestbed.errors import InputError
from tests.devices.running import START, going, until, urls
from tests.slow import slow

PATIENCE = 20.0  # [s] for a process to start
TARGET = START + np.array([0.01, 0.0, -0.02, 0.0, 0.0, 0.0, 0.0])


class Device:
    """An emulated platform that goes on by itself."""

    def __init__(self, scheme: str) -> None:
        self.url, device_url = urls(scheme)
        self.server, self.tick = platform_server(device_url), 0

    def step(self) -> None:
        self.tick += 1
        self.server.publish(START, 0.004 * self.tick)
        self.server.wait(0.003)

    def passes(self, ticks: int) -> None:
        before = self.tick
        until(lambda: self.tick > before + ticks)


@contextmanager
def _connected(scheme: str) -> Iterator[tuple[Device, PlatformClient]]:
    device = Device(scheme)
    with device.server, going(device.step, 0.001), platform_client(device.url) as client:
        yield device, client


@pytest.mark.parametrize("scheme", ["rsi", slow("shm")])
def test_a_loop_that_falls_silent_leaves_the_platform_held(scheme: str) -> None:
    with _connected(scheme) as (device, client):
        watchdog = Watchdog(device.url, client, timeout=0.1, action="hold", lasting=1.0)
        assert watchdog.ready(PATIENCE)
        assert not watchdog.tripped

        def at_target() -> bool:
            client.wait(0.1)
            client.command(TARGET)
            watchdog.beat()
            return bool(abs(device.server.command[0] - TARGET[0]) < 1e-6)

        until(at_target)
        assert not watchdog.tripped
        before = device.server.counts[Event.RECEIVED]
        until(lambda: watchdog.tripped)  # no beat any more
        until(lambda: device.server.counts[Event.RECEIVED] > before + 10)
        np.testing.assert_allclose(device.server.command, TARGET, atol=1e-6)
        watchdog.close()
    assert not watchdog.alive


def test_a_loop_that_falls_silent_stops_the_platform() -> None:
    with _connected("udp") as (device, client):
        watchdog = Watchdog(device.url, client, timeout=0.05, action="stop", lasting=0.2)
        assert watchdog.ready(PATIENCE)
        watchdog.beat()
        until(lambda: device.server.stopped)
        watchdog.close()


def test_before_the_first_beat_and_after_it_is_disarmed_it_does_nothing() -> None:
    with _connected("udp") as (device, client):
        watchdog = Watchdog(device.url, client, timeout=0.02, action="stop")
        assert watchdog.ready(PATIENCE)
        device.passes(50)
        assert not watchdog.tripped
        watchdog.beat()
        watchdog.disarm()
        device.passes(50)
        assert not watchdog.tripped
        assert watchdog.alive
        watchdog.close()
        assert device.server.stopped is None


LOOP = """
import os, signal, sys
from hiltestbed.devices.table import platform_client
from hiltestbed.devices.watchdog import Watchdog
client = platform_client(sys.argv[1])
client.open()
watchdog = Watchdog(sys.argv[1], client, timeout=0.2, action="stop", lasting=0.5)
assert watchdog.ready(20.0)
for _ in range(50):
    client.wait(1.0)
    client.hold()
    watchdog.beat()
signal.signal(signal.SIGINT, lambda *_: None)
os.killpg(0, signal.SIGINT)
os.kill(os.getpid(), 9)
"""


def test_a_loop_that_is_killed_stops_the_platform() -> None:
    """Where Ctrl-C in its terminal went to all of its processes before, too."""
    device = Device("udp")
    with device.server, going(device.step, 0.001):
        order = [sys.executable, "-c", LOOP, device.url]
        loop = subprocess.run(order, stderr=subprocess.DEVNULL, check=False, start_new_session=True)
        assert loop.returncode == -9
        until(lambda: device.server.stopped)


def test_what_cannot_be_set_is_said() -> None:
    url, device_url = urls("udp")
    client = platform_client(url)
    with pytest.raises(
        InputError,
        match=r"got timeout 0 s, action 'hold', lasting 2 s\); allowed are 0.005 to 10 s, hold or "
        r"stop",
    ):
        Watchdog(url, client, timeout=0.0)
    with platform_server(device_url):
        watchdog = Watchdog("udp://127.0.0.1:1?layout=/no/such/file.yaml", client, timeout=1.0)
        assert not watchdog.ready(PATIENCE)
        watchdog.close()


@pytest.mark.parametrize("part", ["watchdog", "recorder"])
def test_a_process_whose_loop_was_killed_while_it_started_ends_without_a_word(
    part: str, tmp_path: Path
) -> None:
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    of = {
        "watchdog": ["udp://127.0.0.1:49152", "hold", "0.1", "1", "0.1", str(udp.fileno())],
        "recorder": [str(tmp_path / "rows")],
    }
    reading, writing = os.pipe()
    os.close(reading)
    with subprocess.Popen(
        [sys.executable, "-m", f"hiltestbed.devices.{part}", *of[part]], pass_fds=(udp.fileno(),),
        stdin=subprocess.DEVNULL, stdout=writing, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        said = process.communicate(timeout=60)[1]
    os.close(writing)
    udp.close()
    assert (process.returncode, said) == (1, "")
