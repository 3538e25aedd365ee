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
from collections.abc import Callable
from typing import Literal

import numpy as np

from hiltestbed.devices.interface import DeviceError, PlatformClient
from hiltestbed.devices.realtime import PRIORITY, ended, ordinary, prepared, started
from hiltestbed.devices.ring import READY, Array, Ring, attached
from hiltestbed.errors import InputError

Action = Literal["hold", "stop"]
ACTIONS: tuple[Action, ...] = ("hold", "stop")
BEATS = 512  # rows of the ring: unread heartbeats
COLUMNS = 10  # time [s], armed, held (8,)
LASTING = 2.0  # [s]


class Watchdog:
    """The loop's side of the watchdog.

    Attributes:
        timeout: [s] without a heartbeat after which it trips.
    """

    def __init__(
        self,
        url: str,
        platform: PlatformClient,
        timeout: float,
        action: Action = "hold",
        lasting: float = LASTING,
        *,
        wait: bool = True,
    ) -> None:
        """Start the process for the open ``platform`` at ``url``, and ``wait`` until it is ready.
        Raises InputError, DeviceError.
        """
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
        self._tripped = False
        fileno = platform.fileno()
        self._process = started(
            "watchdog",
            self._ring.name,
            self._answer.name,
            url,
            action,
            timeout,
            lasting,
            platform.period if math.isfinite(platform.period) else timeout,
            fileno,
            os.getpid(),
            stdout=subprocess.PIPE,
            pass_fds=(fileno,) if fileno >= 0 else (),
        )
        self._ready = False
        if wait and not self._heard():
            self.close()
            raise DeviceError(f"{platform.where}: the watchdog did not start")

    @property
    def ready(self) -> bool:
        """Whether its process is ready."""
        out = self._process.stdout
        if not self._ready and out and select.select([out], [], [], 0.0)[0]:
            self._heard()
        return self._ready

    def _heard(self) -> bool:
        line = self._process.stdout.readline() if self._process.stdout else ""
        self._ready = line.strip() == READY
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


def watch(
    beats: Ring,
    answer: Ring,
    send: Callable[[Array], None],
    timeout: float,
    lasting: float,
    period: float,
    parent: int,
) -> bool:
    """Check the heartbeats until the loop has finished; True if the watchdog has acted: it calls
    ``send`` with the last command once per ``period`` [s].
    """
    newest: Array | None = None
    while not beats.finished:
        rows = beats.take()
        if len(rows):
            newest = rows[-1].copy()
        orphaned = os.getppid() != parent
        silent = newest is not None and time.monotonic_ns() * 1e-9 - newest[0] > timeout
        if newest is not None and newest[1] > 0.0 and (orphaned or silent):
            answer.push(np.ones(1))
            until = time.monotonic() + lasting
            while (began := time.monotonic()) < until:
                send(newest[2:])
                time.sleep(max(period - (time.monotonic() - began), 0.0))
            return True
        if orphaned:
            return False
        time.sleep(timeout / 10.0)
    return False


def main() -> int:
    """Entry point of the process."""
    from hiltestbed.devices.table import find, settings_of

    beats, answer, url, action, *numbers = sys.argv[1:]
    timeout, lasting, period = map(float, numbers[:3])
    fileno, parent = map(int, numbers[3:])
    kind = find(url, "--platform").keeper
    if kind is None:
        return 1
    keeper = kind(settings_of(url, "--platform"), fileno)
    send = keeper.hold if action == "hold" else keeper.stop
    with attached(beats, answer) as rings:
        if not rings:
            return 1
        ordinary()
        # above the loop, which may be stuck at its own priority
        with prepared(priority=PRIORITY + 1):
            watch(rings[0], rings[1], send, timeout, lasting, period, parent)
    return 0


if __name__ == "__main__":
    sys.exit(main())
