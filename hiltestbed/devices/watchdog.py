"""The watchdog: a separate process that holds or stops the platform when the loop's process no
longer responds.

The loop sends a heartbeat once per cycle: the time and the last command. After ``timeout`` without
one, or if the loop's process has died, the watchdog trips: through its duplicate of the platform's
socket it sends the configured message once per period for ``lasting``. A loop that resumes finds
:attr:`Watchdog.tripped` set and has to stop as well.

It covers a loop that hangs or dies, not a failure of the machine or the network. It is not a safety
device.
"""

from __future__ import annotations

import math
import os
import sys
import time
from typing import Literal

import numpy as np

from hiltestbed.devices.interface import PlatformClient
from hiltestbed.devices.realtime import PRIORITY, Companion, ordinary, prepared, say
from hiltestbed.errors import InputError
from hiltestbed.frames import Array

Action = Literal["hold", "stop"]
ACTIONS: tuple[Action, ...] = ("hold", "stop")
READY, TRIPPED = b"ready\n", b"tripped\n"
BEAT = np.dtype([("time", "f8"), ("armed", "f8"), ("held", "f8", 8)])  # time [s], monotonic


class Watchdog:
    """The loop's side; trips after a ``timeout`` [s] without a heartbeat."""

    def __init__(
        self,
        url: str,
        platform: PlatformClient,
        timeout: float,
        action: Action = "hold",
        lasting: float = 2.0,
    ) -> None:
        """Start the process for the open ``platform`` at ``url``; ``lasting`` [s]. Raises
        InputError.
        """
        if not 0.005 <= timeout <= 10.0 or action not in ACTIONS or lasting <= 0.0:
            raise InputError(
                f"watchdog: invalid settings (got timeout {timeout:g} s, action {action!r}, "
                f"lasting {lasting:g} s); allowed are "
                f"0.005 to 10 s, {' or '.join(ACTIONS)}, and more than 0 s"
            )
        self.timeout = timeout
        self._platform = platform
        self._beat = np.zeros(1, BEAT)
        period = platform.period if math.isfinite(platform.period) else timeout
        fileno = platform.fileno()
        self._process = Companion(
            *("watchdog", url, action, timeout, lasting, period, fileno),
            pass_fds=(fileno,) if fileno >= 0 else (),
        )

    def ready(self, timeout: float = 0.0) -> bool:
        """Whether its process is ready; waits up to ``timeout`` [s] for it to start or to end."""
        return self._process.has_said(READY, timeout)

    def beat(self) -> None:
        """Send a heartbeat; call once per cycle, after the command. The first one arms it."""
        self._beat["held"] = self._platform.held
        self._send(armed=True)

    def disarm(self) -> None:
        """Disarm the watchdog: the loop ends normally and sends no more heartbeats."""
        self._send(armed=False)

    def _send(self, armed: bool) -> None:
        self._beat["time"], self._beat["armed"] = time.monotonic_ns() * 1e-9, armed
        self._process.send(self._beat.tobytes())

    @property
    def tripped(self) -> bool:
        """Whether it has acted."""
        return self._process.has_said(TRIPPED)

    @property
    def alive(self) -> bool:
        """Whether its process runs."""
        return self._process.running

    def close(self) -> None:
        """End the process; may be called twice."""
        if self.alive:
            self.disarm()
        self._process.end()


def main() -> int:
    """Entry point of the process: checks the heartbeats until the loop has finished."""
    from hiltestbed.devices.table import platform_client

    url, action = sys.argv[1:3]
    timeout, lasting, period = map(float, sys.argv[3:6])
    client = platform_client(url)
    client.adopt(int(sys.argv[6]))
    if not say(READY):
        return 1
    ordinary()
    # above the loop, which may be stuck at its own priority
    with prepared(priority=PRIORITY + 1):
        held = _lost(timeout)
        if held is None:
            return 0
        say(TRIPPED)
        until = time.monotonic() + lasting
        while (began := time.monotonic()) < until:
            client.keep(held, action == "stop")
            time.sleep(max(period - (time.monotonic() - began), 0.0))
    return 0


def _lost(timeout: float) -> Array | None:
    """The last command of an armed loop that has fallen silent or died; None once it has ended."""
    os.set_blocking(0, False)
    newest = np.zeros(1, BEAT)[0]
    alive = True
    while alive:
        time.sleep(timeout / 10.0)
        try:
            while beats := os.read(0, 1024 * BEAT.itemsize):
                newest = np.frombuffer(beats, BEAT)[-1]
            alive = False
        except BlockingIOError:
            pass
        if newest["armed"] and not (
            alive and time.monotonic_ns() * 1e-9 - newest["time"] <= timeout
        ):
            return newest["held"].copy()
    return None


if __name__ == "__main__":
    sys.exit(main())
