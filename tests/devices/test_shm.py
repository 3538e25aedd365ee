"""Shared memory: whole messages or none, between two processes."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from hiltestbed.devices.interface import DeviceError, Event
from hiltestbed.devices.shm import attach, make
from hiltestbed.devices.table import platform_server, sensor_client, sensor_server
from hiltestbed.errors import InputError

WRITER = """
import select
import sys
import numpy as np
from hiltestbed.devices.table import sensor_server
with sensor_server("shm://" + sys.argv[1]) as server:
    print("ready", flush=True)
    k = 0
    while k % 1000 or not select.select([sys.stdin], [], [], 0.0)[0]:  # until the reader has seen enough and closes
        k += 1
        server.publish(np.full(6, float(k)), 1e-3 * k)
"""


def _name(what: str) -> str:
    return f"hiltestbed-test-{os.getpid()}-{what}"


def test_a_reader_gets_whole_messages_from_another_process() -> None:
    """The writer writes as fast as it can: each message that is read has six equal numbers, and its
    own time and number.
    """
    name = _name("torn")
    writer = subprocess.Popen(
        [sys.executable, "-c", WRITER, name], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    try:
        assert writer.stdout.readline() == b"ready\n"
        with sensor_client(f"shm://{name}?connect=10") as client:
            seen = 0
            while seen < 1000:
                assert client.wait(60.0)
                reading = client.reading
                np.testing.assert_array_equal(reading.wrench, float(reading.sequence))
                assert reading.device_time == pytest.approx(1e-3 * reading.sequence)
                seen += 1
            assert client.counts[Event.REORDERED] == 0
    finally:
        writer.stdin.close()
        writer.wait(30)
        writer.stdout.close()
    assert writer.returncode == 0


def test_a_reader_that_has_paused_gets_the_newest_message() -> None:
    """However many were written meanwhile: a process may stand still for longer than a writer takes
    for 10,000 messages.
    """
    name = _name("paused")
    with sensor_server(f"shm://{name}") as server:
        server.publish(np.zeros(6), 0.0)
        with sensor_client(f"shm://{name}") as client:
            for k in range(2, 15_001):
                server.publish(np.full(6, float(k)), 1e-3 * k)
            assert client.poll()
            assert client.reading.sequence == 15_000
            assert client.counts[Event.LOST] == 15_000 - 2
            assert client.counts[Event.MALFORMED] == 0


def test_a_message_that_is_not_whole_is_not_taken() -> None:
    name = _name("half")
    box = make(name, "here")
    reader = attach(name)
    box.write(np.arange(6.0), 1, 0.1, 0)
    assert reader.read() is True
    box.write(np.arange(6.0) + 1, 2, 0.2, 0)
    box._numbers[3] += 1.0  # as if a store had not arrived yet
    assert reader.read() is None
    np.testing.assert_array_equal(reader.values[:6], np.arange(6.0))
    box._numbers[3] -= 1.0
    assert reader.read() is True
    box._words[1] |= 1  # the writer is at it
    box._words[2] = 3
    assert reader.read() is False
    box.write(np.arange(6.0) + 2, 3, 0.3, 0)
    assert reader.read() is True
    reader.close()
    box.close()


def test_names_that_are_taken_or_missing() -> None:
    name = _name("taken")
    box = make(f"{name}.state", "here")
    with pytest.raises(
        InputError,
        match=r"is there already; stop the other device, remove what one has left, or give "
        r"another name",
    ):
        platform_server(f"shm://{name}").open()
    box.close()
    assert attach(f"{name}.state") is None
    with pytest.raises(DeviceError, match=r"there is no shared memory .* start the device first"):
        sensor_client(f"shm://{name}?connect=0.02").open()
