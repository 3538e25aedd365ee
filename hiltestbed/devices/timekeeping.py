"""Model time against the wall clock: whatever begins the ticks, they have to begin at the
scenario's rate.

Every kind of clock is compared in the same way, while nothing moves, in every second of motion and
in every cycle: a device that sends faster than it was said to would otherwise move the platform
faster than the model by the same factor.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

RATE_ERROR = 0.01  # largest relative deviation of a clock's rate from the scenario's
WINDOW = 1.0  # [s] after which a rate is judged; no larger difference of the times is allowed
LEAST = 20  # ticks in a window
DOUBT = 12.0  # residuals over the window that a rate is uncertain by; derived in is_right
NANOSECOND = 1e-9  # [s]


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
        return round((self._told() + self._slept) / NANOSECOND)

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
        last = self._ticks * self._tick - (self._last - self._begin) * NANOSECOND
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
        slack = (now - self._last) * NANOSECOND * RATE_ERROR
        self._last = now
        wall = (now - self._begin) * NANOSECOND
        late = wall - (self._ticks + 1) * self._tick
        self._ticks += ticks
        early = self._ticks * self._tick - wall
        seconds = (now - self._opened) * NANOSECOND
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
