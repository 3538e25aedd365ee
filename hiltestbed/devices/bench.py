"""Latency, jitter and deadline misses of the cycle on this machine, with and without a device on
the loopback address.

The device is an emulated platform (plain records over UDP) in a separate process of the same
priority, since a real device does not depend on this machine's load: each cycle sends a pose and
waits for its echo. A cycle misses its deadline if its work ends after the next one is due, or if
the echo has not arrived by then.
"""

from __future__ import annotations

import select
import socket
import sys
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hiltestbed.devices.interface import DeviceError, PlatformClient
from hiltestbed.devices.pace import CycleClock
from hiltestbed.devices.realtime import PATIENCE, PRIORITY, Companion, ordinary, prepared
from hiltestbed.devices.table import platform_client, platform_server
from hiltestbed.devices.url import LOOPBACK
from hiltestbed.errors import InputError

PERCENTILES = (50.0, 90.0, 99.0, 99.9, 99.99)
# bin width [s] and number of bins of the histogram: up to 1 ms, plus one bin for longer times
BIN, BINS = 5e-6, 200


def measure(
    rate: float, seconds: float, *, device: bool = False, priority: int | None = PRIORITY
) -> dict[str, Any]:
    """Run cycles at ``rate`` [Hz] for ``seconds``. Raises InputError.

    Returns whether a ``device`` was in the cycle; numbers of ``cycles`` begun, ``skipped`` because
    of overruns, and with a ``missed`` deadline; times from due time to start (``wake_up``) and from
    command to echo (``round_trip``), see :func:`_times`; real-time settings ``granted`` and
    ``refused``; ``stolen``, the fraction of the processors' time that the hypervisor gave to other
    virtual machines, None if the system does not report it.
    """
    if not 0.0 < seconds <= 86_400.0 or not 1.0 <= rate <= 20_000.0:
        raise InputError(
            f"the measurement cannot be made (got {rate:g} Hz for {seconds:g} s); allowed are 1 "
            f"to 20000 Hz and up to a day"
        )
    cycles = max(round(rate * seconds), 2)
    clock = CycleClock(rate, cycles)
    round_trips = np.zeros(cycles)
    echo = _Echo(rate, priority) if device else None
    before = _processors()
    try:
        with prepared(priority=priority) as given:
            missed = _run(clock, round_trips, echo.client if echo else None)
    finally:
        if echo is not None:
            echo.close()
    return {
        "rate": rate,
        "device": device,
        "cycles": clock.cycles,
        "skipped": clock.skipped,
        "missed": missed,
        "wake_up": _times(clock.latency()),
        "round_trip": _times(round_trips[round_trips > 0.0]) if device else None,
        "granted": given.granted,
        "refused": given.refused,
        "stolen": _stolen(before, _processors()),
    }


def _run(clock: CycleClock, round_trips: NDArray[np.float64], client: PlatformClient | None) -> int:
    """Run a cycle for each of the ``round_trips`` [s]; returns the number of missed deadlines."""
    missed = 0
    pose = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    clock.start()
    for k in range(len(round_trips)):
        clock.wait()
        answered = True
        if client is not None:
            client.poll()
            sent = time.monotonic_ns()
            client.command(pose)
            answered = client.wait(clock.left())
            if answered:
                round_trips[k] = (time.monotonic_ns() - sent) * 1e-9
        missed += not answered or clock.left() < 0.0
    return missed


def _processors() -> list[int] | None:
    """Times of all processors in the columns of /proc/stat (proc_stat(5)); None without it."""
    try:
        with open("/proc/stat", encoding="ascii") as file:
            columns = file.readline().split()[1:9]
    except OSError:
        return None
    return [int(c) for c in columns] if len(columns) == 8 else None


def _stolen(before: list[int] | None, after: list[int] | None) -> float | None:
    """Fraction of the time between two such lines in the column ``steal``."""
    if before is None or after is None:
        return None
    spent = [b - a for a, b in zip(before, after, strict=True)]
    return spent[-1] / sum(spent) if sum(spent) else 0.0


def _times(values: NDArray[np.float64]) -> dict[str, Any]:
    """Statistics of a time over all cycles [s]: percentiles by name, the maximum, and a histogram
    whose last bin holds all longer times.
    """
    levels, worst = np.full(len(PERCENTILES), np.inf), np.inf
    if len(values):
        levels, worst = np.percentile(values, PERCENTILES), float(values.max())
    histogram = np.bincount(np.minimum((values / BIN).astype(int), BINS), minlength=BINS + 1)
    named = {f"{p:g}": float(level) for p, level in zip(PERCENTILES, levels, strict=True)}
    times = {"percentiles": named, "worst": worst, "bin_width": BIN}
    return times | {"histogram": histogram.tolist()}


class _Echo:
    """The device's process, and the client that talks to it."""

    def __init__(self, rate: float, priority: int | None) -> None:
        here, there = _free_ports(2)
        url = f"udp://{LOOPBACK}:{there}"
        options = f"rate={rate:.6f}&clock=host&connect={PATIENCE:g}"
        here_url = f"{url}?peer={LOOPBACK}:{here}"
        self._process = Companion("bench", here_url, *([priority] if priority else []))
        self.client = platform_client(f"{url}?listen={LOOPBACK}:{here}&{options}")
        try:
            self.client.open()
        except DeviceError:
            self.close()
            raise

    def close(self) -> None:
        self.client.stop()
        self.client.close()
        self._process.end()


def _free_ports(count: int) -> list[int]:
    """Currently unused ports of the loopback address."""
    held = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    try:
        for opened in held:
            opened.bind((LOOPBACK, 0))
        return [opened.getsockname()[1] for opened in held]
    finally:
        for opened in held:
            opened.close()


def main() -> int:
    """Entry point of the device's process: echoes every pose until it is stopped or its parent
    dies, at the loop's priority, since a real device does not wait for this machine's other work.
    """
    url, *priority = sys.argv[1:]
    ordinary()
    with (
        prepared(priority=int(priority[0]) if priority else None),
        platform_server(url) as server,
    ):
        server.publish(server.command, 0.0)
        while server.stopped is None and not select.select([0], [], [], 0.0)[0]:
            if server.wait(0.05) or not server.commanded:
                server.publish(server.command, time.monotonic_ns() * 1e-9)
    return 0


if __name__ == "__main__":
    sys.exit(main())
