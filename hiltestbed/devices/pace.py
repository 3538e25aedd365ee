"""Pacing of the loop: each tick waits for a record of the device that sets the clock, or for the
loop's own clock.

A tick is assigned to a record by the device's own record number, not by the time of arrival. A lost
or late record affects only its tick, not the time base: half a period after it was due the tick
begins without it, and if several records have arrived at once, the loop catches up. Whether the
device's time base is that of the wall clock is compared in the same way for every kind of clock,
while nothing moves, in every second of motion and in every cycle: a device that sends faster than
it was said to would otherwise move the platform faster than the model by the same factor.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hiltestbed.devices.interface import SPIN, Client, DeviceError
from hiltestbed.errors import InputError

SECOND = 1_000_000_000  # [ns]
SLACK = 0.5  # periods after the due time at which a missing record counts as a miss
RATE_ERROR = 0.01  # largest relative deviation of a clock's rate from the scenario's
WINDOW = 1.0  # [s] after which a rate is judged; no larger difference of the times is allowed
LEAST = 20  # ticks in a window
DOUBT = 12.0  # residuals over the window that a rate is uncertain by; derived in is_right


class CycleClock:
    """Paces cycles and records their times in preallocated arrays.

    Cycle k is due at ``start + k period`` on the monotonic clock, however long the cycles before it
    took: there is no drift. The wait sleeps until shortly before that and then spins. Cycles that
    an overrun has passed completely are skipped and counted, not caught up with.

    Attributes:
        cycles: number of cycles begun.
        skipped: number of cycles skipped because those before took too long.
        due, began: (capacity,) [ns] on the monotonic clock, of each of the last cycles.
    """

    def __init__(self, rate: float, capacity: int) -> None:
        """``rate`` [Hz] of the cycles; ``capacity`` of times."""
        if not 0.1 <= rate <= 1e5 or capacity < 1:
            raise InputError(
                f"rate: cannot be paced (got {rate:g} Hz for {capacity} cycles); allowed are 0.1 "
                f"to 1e5 Hz and at least one cycle"
            )
        self.cycles = self.skipped = 0
        times: NDArray[np.int64] = np.zeros((2, capacity), dtype=np.int64)
        self.due, self.began = times
        self._rate = rate
        self._start = self._next = 0

    def start(self) -> None:
        """Start the clock: the first cycle is due one period from now."""
        self.cycles = self.skipped = 0
        self._start = time.monotonic_ns()
        self._next = 1

    def wait(self) -> int:
        """Wait for the next cycle; returns the number of cycles skipped before it."""
        due = self._next_due()
        now = time.monotonic_ns()
        left_out = 0
        if now - due > SECOND / self._rate:
            left_out = int((now - due) * self._rate / SECOND)
            self._next += left_out
            self.skipped += left_out
            due = self._next_due()
        asleep = due - now - round(SPIN * SECOND)
        if asleep > 0:
            time.sleep(asleep / SECOND)
        now = time.monotonic_ns()
        while now < due:
            now = time.monotonic_ns()
        slot = self.cycles % len(self.due)
        self.due[slot], self.began[slot] = due, now
        self.cycles += 1
        self._next += 1
        return left_out

    def left(self) -> float:
        """Time until the next cycle is due [s]; negative if it is overdue."""
        return (self._next_due() - time.monotonic_ns()) / SECOND

    def _next_due(self) -> int:
        return self._start + round(self._next * SECOND / self._rate)

    def latency(self) -> NDArray[np.float64]:
        """(cycles,) from due time to start of each kept cycle [s]."""
        return (self.began - self.due)[: self.cycles] / SECOND


class Pace:
    """Waits for the ticks of a loop; ``source`` sets the clock, for the results of a run. This one
    does not wait at all.
    """

    source = "none"
    _count = 0

    def start(self) -> None:
        """Start counting: the next tick is the first."""
        self._count = 0

    def wait(self) -> int:
        """Wait for the next tick; the number that have begun since the last call, at least 1."""
        self._count += 1
        return 1

    def told(self) -> float:
        """Ticks since :meth:`start` by the clock's own count, also where records are missing."""
        return self._count

    def advice(self, factor: float) -> str:
        """What to set for a clock that runs at ``factor`` times the expected rate."""
        return "give it a clock"


class DevicePace(Pace):
    """Ticks that begin with every ``records``-th record of ``link``."""

    def __init__(self, link: Client, tick: float, records: int) -> None:
        self.source = link.where
        self._link, self._tick = link, tick
        self._records, self._numbers = records, records * link.step
        self._first, self._due = 0, 0.0

    def start(self) -> None:
        self._first, self._count = self._link.sample.sequence, 0
        self._due = time.monotonic()

    def wait(self) -> int:
        self._count += 1
        deadline = self._due + (1.0 + SLACK) * self._tick
        while self._link.wait(
            max(deadline - (now := time.monotonic()), 0.0), max(self._due + self._tick - now, 0.0)
        ):
            index = (self._link.sample.sequence - self._first) // self._numbers
            if index >= self._count:
                ticks, self._count = index - self._count + 1, index
                self._due = time.monotonic()
                return ticks
        self._due += self._tick
        return 1

    def told(self) -> float:
        return (self._link.sample.sequence - self._first) / self._numbers

    def advice(self, factor: float) -> str:
        whole = round(max(factor, 1.0 / factor)) if factor > 0.0 else 1
        near = whole if factor > 1.0 else 1.0 / whole
        if abs(factor / near - 1.0) <= RATE_ERROR:  # measured to a fraction of a per cent
            factor = near
        records = factor * self._records / self._tick
        return (
            f"its records arrive at some {records:.4g} Hz where "
            f"{self._records / self._tick:.4g} Hz were expected: set rate to "
            f"{factor / self._tick:.4g} (--set rate=...), or give the true rate in the device's "
            f"URL (rate={records:.4g})"
        )


class HostPace(Pace):
    """Ticks from the loop's own clock."""

    source = "the loop's own clock"

    def __init__(self, tick: float) -> None:
        self._clock = CycleClock(1.0 / tick, 1)

    def start(self) -> None:
        super().start()
        self._clock.start()

    def wait(self) -> int:
        ticks = 1 + self._clock.wait()
        self._count += ticks
        return ticks

    def advice(self, factor: float) -> str:
        return "this machine cannot keep the rate; set a lower one, or relieve it of other work"


def pace_of(sensor: Client, platform: Client, tick: float) -> Pace:
    """The platform sets the clock if its protocol does so; otherwise a streaming sensor; otherwise
    the loop. Raises DeviceError if that rate is not a whole multiple of the loop's.
    """
    for link in (platform, sensor):
        if link.clock != "device" or not math.isfinite(link.period):
            continue
        records = max(round(tick / link.period), 1)
        if abs(records * link.period / tick - 1.0) > RATE_ERROR:
            raise DeviceError(
                f"{link.where}: sets the clock at {1.0 / link.period:g} Hz, which is not a whole "
                f"multiple of the scenario's rate of {1.0 / tick:g} Hz; set rate to "
                f"{1.0 / link.period:g}, or to that divided by a whole number"
            )
        return DevicePace(link, tick, records)
    return HostPace(tick)


class WallClock:
    """The machine's monotonic clock."""

    def __call__(self) -> int:
        """The time [ns]."""
        return time.monotonic_ns()

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)


class SimulatedClock(WallClock):
    """The time that a function tells [s], and what has been slept."""

    def __init__(self, told: Callable[[], float]) -> None:
        self._told, self._slept = told, 0.0

    def __call__(self) -> int:
        return round((self._told() + self._slept) * SECOND)

    def sleep(self, seconds: float) -> None:
        self._slept += seconds


class Timekeeper:
    """Compares the ticks of a loop with the wall clock, and holds back those that come too early.

    A record may be late, but not early: the earliest records of a clock show its phase. While the
    platform moves, no tick begins earlier against that phase than a clock that is fast by
    :data:`RATE_ERROR` would begin it.

    Attributes:
        fault: why the motion has to stop; None while both times agree.
        factor: rate of the clock in the last window, by the wall clock, over the scenario's.
        worst: largest difference between model time and wall time since :meth:`start` [s].
    """

    def __init__(self, tick: float, limit: float | None, clock: WallClock) -> None:
        """``tick`` [s]; ``limit`` [s] of the difference in any cycle, None: :data:`WINDOW`."""
        self._tick, self._limit = tick, WINDOW if limit is None else limit
        self._now = clock
        self._last = clock()  # of the last tick
        self.factor = math.nan
        self.watch()

    @property
    def rate(self) -> float:
        """Ticks a second of the clock in the last window, by the wall clock [Hz]."""
        return self.factor / self._tick

    def watch(self) -> None:
        """Begin to measure the rate while nothing moves."""
        self._checked = False
        self._phase = -math.inf  # [s] by which the earliest ticks are ahead of the wall clock
        self._zero(self._now())

    def start(self) -> None:
        """From the last tick on both times are compared: the platform may move."""
        self._checked = True
        last = self._ticks * self._tick - (self._last - self._begin) / SECOND
        self._phase = max(self._phase - last, 0.0)
        self._zero(self._last)

    def _zero(self, at: int) -> None:
        self.fault: str | None = None
        self.worst = 0.0
        self._begin, self._ticks = at, 0
        self._window()

    def _window(self) -> None:
        self._opened, self._told = self._now(), -math.inf
        # number of records, sums of wall time x, told time y and products
        self._sums = [0.0] * 6

    def ticked(self, ticks: int, told: float) -> None:
        """A tick is to begin; waits if it comes too early.

        Args:
            ticks: that have begun since the last call; all but one are made up for.
            told: ticks since the start by the clock's own count.
        """
        now = self._now()
        slack = (now - self._last) / SECOND * RATE_ERROR
        self._last = now
        wall = (now - self._begin) / SECOND
        late = wall - (self._ticks + 1) * self._tick
        self._ticks += ticks
        early = self._ticks * self._tick - wall
        seconds = (now - self._opened) / SECOND
        if told > self._told:  # a new record
            self._told, y = told, told * self._tick
            new = (1.0, seconds, y, seconds * seconds, seconds * y, y * y)
            self._sums = [total + value for total, value in zip(self._sums, new, strict=True)]
        latest = self._phase + slack
        self._phase = max(self._phase - slack, min(early, latest) if self._checked else early)
        if not self._checked:
            return
        apart, sign = max((late, "behind"), (early, "ahead of"))
        self.worst = max(self.worst, apart)
        if apart > self._limit and self.fault is None:
            self.fault = (
                f"model time is {1e3 * apart:.1f} ms {sign} the wall clock; "
                f"devices.limits.time_offset is {1e3 * self._limit:g} ms"
            )
        if seconds > max(WINDOW, LEAST * self._tick):
            right = self.is_right()
            if right is False and self.fault is None:
                self.fault = (
                    f"in the last {seconds:.1f} s it ran at {self.rate:.5g} Hz by the wall clock; "
                    f"the scenario's rate is {1.0 / self._tick:g} Hz (limit "
                    f"{100.0 * RATE_ERROR:g} %)"
                )
            if right is not None:
                self._window()
        if early > latest and self.fault is None:
            self._now.sleep(early - latest)

    def is_right(self) -> bool | None:
        """Whether the clock has run at the scenario's rate since the window began; None where that
        cannot be told yet, because its records came too unevenly.

        The rate is the slope of the regression of the time that its records tell on the wall clock;
        a clock that stands still has none. Records that were held back, or a clock that paused
        once, for d leave a residual of d/4 (root mean square) in a window T with a slope that is
        off by 1.5 d/T: six times the residual over T covers that, twice as much also a pause of a
        third of the window, without records. With T it vanishes.
        """
        n, x, y, xx, xy, yy = self._sums
        spread = xx - x * x / n if n > 3 else 0.0  # of fewer records a slope is nothing
        if spread <= 0.0:
            self.factor = 0.0
            return False
        self.factor = (xy - x * y / n) / spread
        residual = math.sqrt(max(yy - y * y / n - self.factor**2 * spread, 0.0) / n)
        length = math.sqrt(12.0 * spread / n)
        off = abs(self.factor - 1.0)
        if off <= RATE_ERROR:
            return True
        return None if off - DOUBT * residual / length <= RATE_ERROR else False
