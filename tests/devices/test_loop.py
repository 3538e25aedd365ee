"""A bounce with its physical side behind each protocol is the bounce without one, to the resolution
of the records.

Cycle k: the device publishes the wrench and the pose at t_k; the loop takes both in, moves its mass
on by a tick and commands where it is to be at t_(k+1); the device takes that in and is there. No
clock is waited for.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

import numpy as np
import pytest

from hiltestbed.devices.interface import (
    Event,
    Link,
    PlatformClient,
    PlatformServer,
    SensorClient,
    SensorServer,
)
from hiltestbed.devices.rdt import RdtServer
from hiltestbed.devices.rtde_controller import RtdePlatformServer, RtdeSensorServer
from hiltestbed.devices.table import platform_client, platform_server, sensor_client, sensor_server
from tests.devices.running import START, free_ports, going, until

MASS, STIFFNESS, SPEED, PERIOD = 20.0, 5.0e4, 0.2, 0.004
CYCLES = 60  # half a period of contact is pi sqrt(m/k) = 63 ms: 16 cycles


class Rig:
    """A platform that is where it was told to be, and a spring along z from the start on."""

    def __init__(self) -> None:
        self.pose = START.copy()
        self.wrench = np.zeros(6)

    def move(self, command: np.ndarray) -> None:
        self.pose[:] = command
        depth = max(float(command[2] - START[2]) - 1e-3, 0.0)
        self.wrench[:] = [0.0, 0.0, STIFFNESS * depth, 0.01 * STIFFNESS * depth, 0.0, 0.0]


class Mass:
    def __init__(self) -> None:
        self.pose, self.speed = START.copy(), SPEED

    def move(self, wrench: np.ndarray) -> np.ndarray:
        self.speed -= float(wrench[2]) / MASS * PERIOD
        self.pose[2] += self.speed * PERIOD
        return self.pose


def _urls(sensor: str, platform: str) -> tuple[str, str, str, str]:
    """Of sensor client, sensor server, platform client, platform server; rdt and rtde servers find
    a port of their own.
    """
    a, b, c, d = free_ports(4)
    name = f"shm://hiltestbed-test-{os.getpid()}-loop"
    udp_sensor = f"udp://127.0.0.1:{a}?listen={b}&connect=5", f"udp://127.0.0.1:{a}?peer={b}"
    udp_platform = f"udp://127.0.0.1:{c}?listen={d}&connect=5", f"udp://127.0.0.1:{c}?peer={d}"
    both = {
        "rdt": (
            "rdt://127.0.0.1:{port}?counts_per_force=1e6&counts_per_torque=1e6",
            "rdt://127.0.0.1:0",
        ),
        "rtde": ("rtde://127.0.0.1:{port}?rate=250&connect=5", "rtde://127.0.0.1:0?rate=250"),
        "rsi": (f"rsi://127.0.0.1:{c}?connect=5", f"rsi://127.0.0.1:{c}"),
        "shm": (name, name),
    }
    return *(both | {"udp": udp_sensor})[sensor], *(both | {"udp": udp_platform})[platform]


def _port(server: Link) -> int:
    if isinstance(server, RdtServer):
        return server.address[1]
    return server.address[1] if isinstance(server, RtdeSensorServer | RtdePlatformServer) else 0


@contextmanager
def _connected(
    sensor: str, platform: str
) -> Iterator[tuple[SensorClient, SensorServer, PlatformClient, PlatformServer, Callable]]:
    a, b, c, d = _urls(sensor, platform)
    with ExitStack() as stack:
        felt, moved = stack.enter_context(sensor_server(b)), stack.enter_context(platform_server(d))
        tick = 0

        def publish(rig: Rig) -> None:
            nonlocal tick
            tick += 1
            felt.publish(rig.wrench, PERIOD * tick)
            moved.publish(rig.pose, PERIOD * tick)

        reads, moves = (
            sensor_client(a.format(port=_port(felt))),
            platform_client(c.format(port=_port(moved))),
        )
        still = Rig()
        with going(lambda: publish(still), 0.001):
            stack.enter_context(reads)
            stack.enter_context(moves)
        _empty(reads, moves, moved)
        for _ in range(2):
            publish(still)
            until(lambda: reads.wait(0.1) and moves.wait(0.1))
            moves.hold()
            until(moved.poll)
        yield reads, felt, moves, moved, publish


def _empty(*links: Link) -> None:
    """Take in what had piled up while the connections were opened."""
    for link in links:
        while link.wait(0.02):
            pass


PAIRS = [("rdt", "rsi"), ("rdt", "udp"), ("udp", "udp"), ("shm", "shm"), ("rtde", "rtde")]


@pytest.mark.parametrize(("sensor", "platform"), PAIRS)
def test_a_bounce_over_the_protocols_is_the_bounce_without_them(sensor: str, platform: str) -> None:
    rig, mass, direct_rig, direct_mass = Rig(), Mass(), Rig(), Mass()
    with _connected(sensor, platform) as (reads, _, moves, moved, publish):
        lost = reads.counts[Event.LOST] + moves.counts[Event.LOST]
        for _ in range(CYCLES):
            publish(rig)
            until(lambda: reads.wait(0.1))
            until(lambda: moves.wait(0.1))
            np.testing.assert_allclose(moves.state.pose, rig.pose, atol=1e-8)
            moves.command(mass.move(reads.reading.wrench))
            until(moved.poll)
            rig.move(moved.command)
            direct_rig.move(direct_mass.move(direct_rig.wrench))
            # a record is rounded to 1e-6 N and 1e-9 m (RSI), and the spring makes 5e-5 N of that
            np.testing.assert_allclose(mass.pose, direct_mass.pose, atol=1e-8)
        assert mass.speed == pytest.approx(direct_mass.speed, abs=1e-8)
        assert mass.speed < -0.9 * SPEED  # it has been at the spring and come back
        assert reads.counts[Event.LOST] + moves.counts[Event.LOST] == lost
