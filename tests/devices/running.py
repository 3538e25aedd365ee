"""What several tests of devices need: free addresses, a device that goes on by itself, and a wait
for something that another thread will do.
"""

from __future__ import annotations

import os
import random
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import cycle

import numpy as np

PATIENCE = 5.0  # [s] a busy machine may take this long for what is done in a millisecond
START = np.array(
    [0.1, -0.2, 0.9, *(np.array([0.1, 0.2, -0.3, 0.9]) / np.linalg.norm([0.1, 0.2, -0.3, 0.9]))]
)


@contextmanager
def going(step: Callable[[], object], period: float = 0.002) -> Iterator[None]:
    """Call ``step`` again and again from another thread."""
    stop, failures = threading.Event(), []

    def run() -> None:
        while not stop.is_set():
            try:
                step()
            except BaseException as error:
                failures.append(error)
                return
            time.sleep(period)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
    if failures:
        raise failures[0]


def until(condition: Callable[[], object]) -> None:
    """Wait until ``condition`` holds; fails where it does not in time."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "did not happen in time"
        time.sleep(0.0005)


# each worker has ports of its own, and gives none twice before all were given
WORKERS = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
WORKER = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
OWN = range(20_000 + WORKER, 32_000, WORKERS)
PORTS = cycle(random.sample(OWN, len(OWN)))


def free_ports(count: int) -> list[int]:
    """Ports of the loopback address that nobody uses just now, that the kernel gives nobody of
    itself (Linux: those below 32768), and that no other test is given.
    """
    held: list[socket.socket] = []
    while len(held) < count:
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            opened.bind(("127.0.0.1", next(PORTS)))
            held.append(opened)
        except OSError:
            opened.close()
    ports = [opened.getsockname()[1] for opened in held]
    for opened in held:
        opened.close()
    return ports


def urls(scheme: str) -> tuple[str, str]:
    """Of the loop's and of the device's side, at a free address."""
    a, b = free_ports(2)
    host, name = "127.0.0.1", f"shm://hiltestbed-test-{os.getpid()}-{a}"
    return {
        "rdt": (
            f"rdt://{host}:{a}?counts_per_force=1e6&counts_per_torque=1e6",
            f"rdt://{host}:{a}",
        ),
        "rsi": (f"rsi://{host}:{a}?connect=10", f"rsi://{host}:{a}?late_limit=1000000"),
        "rtde": (f"rtde://{host}:{a}?connect=10", f"rtde://{host}:{a}"),
        "udp": (f"udp://{host}:{a}?listen={b}&connect=10", f"udp://{host}:{a}?peer={b}"),
        "shm": (name, name),
    }[scheme]
