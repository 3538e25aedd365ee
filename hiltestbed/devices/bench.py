"""How steady a cycle is on this machine: latency, jitter and misses, alone and with a device that answers over the loopback address.

The device is an emulated platform in a process of its own, plain records over UDP: each cycle sends it a pose and waits for the one that it
sends back. A cycle is missed where its work ended after the next one was due, or where the answer did not come before that.
"""

from __future__ import annotations

import argparse
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hiltestbed.devices.clock import CycleClock
from hiltestbed.devices.interface import DeviceError, PlatformClient
from hiltestbed.devices.realtime import PRIORITY, ordinary, prepared
from hiltestbed.devices.table import platform_client, platform_server
from hiltestbed.devices.url import LOOPBACK
from hiltestbed.errors import InputError

PERCENTILES = (50.0, 90.0, 99.0, 99.9, 99.99)
BIN, BINS = 5e-6, 200  # [s] of the histogram: to 1 ms; what is longer falls into one more
PATIENCE = 20.0  # [s] for the device's process to begin


@dataclass(frozen=True)
class Times:
    """How long something took, over all cycles [s]: percentiles by name, the longest, and counts a bin (the last: all longer ones)."""

    percentiles: dict[str, float]
    worst: float
    bin_width: float
    histogram: list[int]


@dataclass(frozen=True)
class Steadiness:
    """One measurement.

    Attributes:
        device: whether a device was in the cycle.
        cycles, skipped, missed: begun; left out because those before took too long; whose work or whose answer was late.
        wake_up: from when a cycle was due to when it began. round_trip: from command to answer, None without a device.
        granted, refused: what the operating system gave of what was asked for.
    """

    rate: float
    device: bool
    cycles: int
    skipped: int
    missed: int
    wake_up: Times
    round_trip: Times | None
    granted: list[str]
    refused: dict[str, str]

    def record(self) -> dict[str, Any]:
        """As plain data for a file."""
        return asdict(self)


def measure(
    rate: float,
    seconds: float,
    *,
    device: bool = False,
    cpu: int | None = None,
    priority: int | None = PRIORITY,
    work: Callable[[], None] | None = None,
) -> Steadiness:
    """Run cycles at ``rate`` [Hz] for ``seconds``; ``work`` is called in each, the loop's own step for instance. Raises InputError."""
    if not 0.0 < seconds <= 86_400.0 or not 1.0 <= rate <= 20_000.0:
        raise InputError(f"the measurement cannot be made (got {rate:g} Hz for {seconds:g} s); allowed are 1 to 20000 Hz and up to a day")
    cycles = max(round(rate * seconds), 2)
    clock = CycleClock(rate, cycles)
    round_trips = np.zeros(cycles)
    echo = _Echo(rate) if device else None
    try:
        with prepared(cpu, priority) as given:
            missed = _run(clock, cycles, round_trips, echo.client if echo else None, work)
    finally:
        if echo is not None:
            echo.close()
    answered = round_trips[round_trips > 0.0]
    return Steadiness(
        rate=rate,
        device=device,
        cycles=clock.cycles,
        skipped=clock.skipped,
        missed=missed,
        wake_up=_times(clock.latency()),
        round_trip=_times(answered) if device else None,
        granted=given.granted,
        refused=given.refused,
    )


def _run(
    clock: CycleClock, cycles: int, round_trips: NDArray[np.float64], client: PlatformClient | None, work: Callable[[], None] | None
) -> int:
    """All cycles; how many were missed."""
    missed = 0
    pose = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    clock.start()
    for k in range(cycles):
        clock.wait()
        answered = True
        if client is not None:
            client.poll()
            sent = time.monotonic_ns()
            client.command(pose)
            answered = client.wait(clock.left())
            if answered:
                round_trips[k] = (time.monotonic_ns() - sent) * 1e-9
        if work is not None:
            work()
        clock.done()
        missed += not answered or clock.left() < 0.0
    return missed


def _times(values: NDArray[np.float64]) -> Times:
    if not len(values):
        return Times({f"{p:g}": float("inf") for p in PERCENTILES}, float("inf"), BIN, [0] * (BINS + 1))
    histogram = np.bincount(np.minimum((values / BIN).astype(int), BINS), minlength=BINS + 1)
    levels = np.percentile(values, PERCENTILES)
    named = {f"{p:g}": float(level) for p, level in zip(PERCENTILES, levels, strict=True)}
    return Times(named, float(values.max()), BIN, histogram.tolist())


class _Echo:
    """The device's process, and the client that talks to it."""

    def __init__(self, rate: float) -> None:
        here, there = _free_ports(2)
        url = f"udp://{LOOPBACK}:{there}"
        options = f"rate={rate:.6f}&clock=host&connect={PATIENCE:g}"
        command = [sys.executable, "-m", "hiltestbed.devices.bench", f"{url}?peer={LOOPBACK}:{here}", str(os.getpid())]
        self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL)
        self.client = platform_client(f"{url}?listen={LOOPBACK}:{here}&{options}")
        try:
            self.client.open()
        except DeviceError:
            self.close()
            raise

    def close(self) -> None:
        self.client.stop()
        self.client.close()
        try:
            self._process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def _free_ports(count: int) -> list[int]:
    """Ports of the loopback address that nobody uses just now."""
    held = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    try:
        for opened in held:
            opened.bind((LOOPBACK, 0))
        return [opened.getsockname()[1] for opened in held]
    finally:
        for opened in held:
            opened.close()


def main() -> int:
    """The device's process: sends back every pose, until it is stopped or its parent has gone."""
    parser = argparse.ArgumentParser()
    parser.add_argument("url")
    parser.add_argument("parent", type=int)
    arguments = parser.parse_args()
    ordinary()
    with platform_server(arguments.url) as server:
        server.publish(server.command, 0.0)
        while server.stopped is None and os.getppid() == arguments.parent:
            if server.wait(0.05) or not server.commanded:
                server.publish(server.command, time.monotonic_ns() * 1e-9)
    return 0


if __name__ == "__main__":
    sys.exit(main())
