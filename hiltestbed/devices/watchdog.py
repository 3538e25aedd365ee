"""The watchdog: a separate process that holds or stops the platform when the loop's process no
longer responds.

The loop sends a heartbeat once per cycle: the time and the last command, written to shared memory.
After ``timeout`` without one, the watchdog trips: through its duplicate of the platform's socket it
sends the configured message once per period for ``lasting``. A loop that resumes finds
:attr:`Watchdog.tripped` set and has to stop as well.

It covers a loop that hangs or dies, not a failure of the machine or the network. It is not a safety
device.
"""

from __future__ import annotations

import math
import os
import select
import subprocess
import sys
import time
from typing import Literal

import numpy as np

from hiltestbed.devices.interface import PlatformClient
from hiltestbed.devices.realtime import PRIORITY, ended, ordinary, prepared, started
from hiltestbed.devices.ring import READY, Array, Ring, attached
from hiltestbed.errors import InputError

Action = Literal["hold", "stop"]
ACTIONS: tuple[Action, ...] = ("hold", "stop")
BEATS = 512  # rows of the ring: unread heartbeats
COLUMNS = 10  # time [s], armed, held (8,)
LASTING = 2.0  # [s]


class Watchdog:
    """The loop's side; trips after a ``timeout`` [s] without a heartbeat."""

    def __init__(
        self,
        url: str,
        platform: PlatformClient,
        timeout: float,
        action: Action = "hold",
        lasting: float = LASTING,
    ) -> None:
        """Start the process for the open ``platform`` at ``url``. Raises InputError."""
        if not 0.005 <= timeout <= 10.0 or action not in ACTIONS or lasting <= 0.0:
            raise InputError(
                f"watchdog: invalid settings (got timeout {timeout:g} s, action {action!r}, "
                f"lasting {lasting:g} s); allowed are "
                f"0.005 to 10 s, {' or '.join(ACTIONS)}, and more than 0 s"
            )
        self.timeout = timeout
        self._platform = platform
        self._ring = Ring(COLUMNS, BEATS)
        self._answer = Ring(1, 4)
        self._row: Array = np.zeros(COLUMNS)
        self._ready = self._tripped = False
        period = platform.period if math.isfinite(platform.period) else timeout
        fileno = platform.fileno()
        self._process = started(
            "watchdog",
            *(self._ring.name, self._answer.name, url, action),
            *(timeout, lasting, period, fileno, os.getpid()),
            stdout=subprocess.PIPE,
            pass_fds=(fileno,) if fileno >= 0 else (),
        )

    def ready(self, timeout: float = 0.0) -> bool:
        """Whether its process is ready; waits up to ``timeout`` [s] for it to start or to end."""
        out = self._process.stdout
        if not self._ready and out and select.select([out], [], [], timeout)[0]:
            self._ready = out.readline().strip() == READY
        return self._ready

    def beat(self) -> None:
        """Send a heartbeat; call once per cycle, after the command. The first one arms it."""
        self._row[2:] = self._platform.held
        self._push(armed=True)

    def disarm(self) -> None:
        """Disarm the watchdog: the loop ends normally and sends no more heartbeats."""
        self._push(armed=False)

    def _push(self, armed: bool) -> None:
        self._row[0], self._row[1] = time.monotonic_ns() * 1e-9, armed
        self._ring.push(self._row)

    @property
    def tripped(self) -> bool:
        """Whether it has acted."""
        self._tripped = self._tripped or len(self._answer.take()) > 0
        return self._tripped

    @property
    def alive(self) -> bool:
        """Whether its process runs."""
        return self._process.poll() is None

    def close(self) -> None:
        """End the process; may be called twice."""
        if self._process.stdout is None or self._process.stdout.closed:
            return
        self._ring.finish()
        ended(self._process)
        self._process.stdout.close()
        self._ring.close()
        self._answer.close()


def main() -> int:
    """Entry point of the process: checks the heartbeats until the loop has finished."""
    from hiltestbed.devices.table import platform_client

    *names, url, action = sys.argv[1:5]
    timeout, lasting, period = map(float, sys.argv[5:8])
    fileno, parent = map(int, sys.argv[8:])
    client = platform_client(url)
    client.adopt(fileno)
    with attached(*names) as rings:
        if not rings:
            return 1
        beats, answer = rings
        ordinary()
        # above the loop, which may be stuck at its own priority
        with prepared(priority=PRIORITY + 1):
            held = _lost(beats, timeout, parent)
            if held is None:
                return 0
            answer.push(np.ones(1))
            until = time.monotonic() + lasting
            while (began := time.monotonic()) < until:
                client.keep(held, action == "stop")
                time.sleep(max(period - (time.monotonic() - began), 0.0))
    return 0


def _lost(beats: Ring, timeout: float, parent: int) -> Array | None:
    """The last command of an armed loop that has fallen silent or died; None once it has ended."""
    newest: Array | None = None
    while not beats.finished:
        rows = beats.take()
        newest = rows[-1].copy() if len(rows) else newest
        orphaned = os.getppid() != parent
        if newest is not None and newest[1] > 0.0:
            if orphaned or time.monotonic_ns() * 1e-9 - newest[0] > timeout:
                return newest[2:]
        elif orphaned:
            return None
        time.sleep(timeout / 10.0)
    return None


if __name__ == "__main__":
    sys.exit(main())
