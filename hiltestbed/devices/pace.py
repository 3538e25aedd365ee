"""Pacing of the loop: each tick waits for a record of the device that sets the clock, or for the
loop's own clock.

A tick is assigned to a record by the device's own record number, not by the time of arrival. A lost
or late record affects only its tick,
not the time base: half a period after it was due the tick begins without it, and if several records
have arrived at once, the loop catches up.
"""

from __future__ import annotations

import math
import time
from typing import Protocol

from hiltestbed.devices.clock import CycleClock
from hiltestbed.devices.interface import Clock, DeviceError, PlatformClient, SensorClient

SLACK = 0.5  # periods after the due time at which a missing record counts as a miss
RATE_ERROR = 0.02  # largest relative deviation of the device's rate from the scenario's


class Pace(Protocol):
    """Waits for the ticks of a loop.

    Attributes:
        source: what sets the clock, for the results of a run.
    """

    source: str

    def start(self) -> None:
        """Start counting: the next tick is the first."""
        ...

    def wait(self) -> int:
        """Wait for the next tick; returns the number of ticks that have begun since the last call,
        at least 1.
        """
        ...


class DevicePace:
    """Ticks that begin with every ``records``-th record of ``link``."""

    def __init__(self, link: SensorClient | PlatformClient, tick: float, records: int) -> None:
        self.source = link.where
        self._link, self._tick = link, tick
        self._numbers = records * link.step
        self._first = self._count = 0
        self._due = 0.0

    def start(self) -> None:
        self._first, self._count = self._link.sample.sequence, 0
        self._due = time.monotonic()

    def wait(self) -> int:
        self._count += 1
        deadline = self._due + (1.0 + SLACK) * self._tick
        while self._wait(deadline):
            index = (self._link.sample.sequence - self._first) // self._numbers
            if index >= self._count:
                ticks, self._count = index - self._count + 1, index
                self._due = time.monotonic()
                return ticks
        self._due += self._tick
        return 1

    def _wait(self, deadline: float) -> bool:
        now = time.monotonic()
        return self._link.wait(max(deadline - now, 0.0), max(self._due + self._tick - now, 0.0))


class AtOnce:
    """Ticks without any waiting."""

    source = "none"

    def start(self) -> None:
        """Nothing to start."""

    def wait(self) -> int:
        return 1


class HostPace:
    """Ticks from the loop's own clock."""

    source = "the loop's own clock"

    def __init__(self, tick: float) -> None:
        self._clock = CycleClock(1.0 / tick, 1)

    def start(self) -> None:
        self._clock.start()

    def wait(self) -> int:
        return 1 + self._clock.wait()


def pace_of(sensor: SensorClient, platform: PlatformClient, tick: float) -> Pace:
    """The platform sets the clock if its protocol does so; otherwise a streaming sensor; otherwise
    the loop.

    Raises:
        DeviceError: the rate of the device that sets the clock is not a whole multiple of the
            loop's.
    """
    for link, sets in (
        (platform, platform.clock is Clock.DEVICE),
        (sensor, math.isfinite(sensor.period)),
    ):
        if not sets:
            continue
        records = max(round(tick / link.period), 1)
        if abs(records * link.period / tick - 1.0) > RATE_ERROR:
            raise DeviceError(
                f"{link.where}: sets the clock at {1.0 / link.period:g} Hz, which is not a whole "
                f"multiple of the scenario's rate of "
                f"{1.0 / tick:g} Hz; set rate to {1.0 / link.period:g}, or to that divided by a "
                f"whole number"
            )
        return DevicePace(link, tick, records)
    return HostPace(tick)
