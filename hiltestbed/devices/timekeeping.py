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
# [s] over which a rate is measured: records that arrive up to 50 ms late, alone or in a burst,
# then change the slope of the regression by less than RATE_ERROR
WINDOW = 1.0
LEAST = 20  # ticks in a window
NANOSECOND = 1e-9  # [s]

Now = Callable[[], int]  # the wall clock [ns], monotonic


class Timekeeper:
    """Compares the ticks of a loop with the wall clock.

    Attributes:
        fault: why the motion has to stop; None while both times agree.
        rate: ticks a second that the clock has told in the last window, by the wall clock [Hz].
        worst: largest difference between model time and wall time since :meth:`start` [s].
    """

    def __init__(self, tick: float, limit: float | None, now: Now = time.monotonic_ns) -> None:
        """``tick`` [s]; ``limit`` [s] of the difference in any cycle, None for none."""
        self._tick, self._limit = tick, math.inf if limit is None else limit
        self._now = now
        self._last = now()  # of the last tick
        self._checked = False
        self.rate = math.nan
        self.watch()

    def watch(self) -> None:
        """Begin to measure the rate while nothing moves."""
        self._checked = False
        self._zero(self._now())

    def start(self) -> None:
        """From the last tick on both times are compared: the platform may move."""
        self._checked = True
        self._zero(self._last)

    def _zero(self, at: int) -> None:
        self.fault: str | None = None
        self.worst = 0.0
        self._begin, self._ticks = at, 0
        self._window()

    def _window(self) -> None:
        """Begin a window: sums of wall time, told time, its products, and the number of records."""
        self._opened, self._told = self._now(), -math.inf
        self._sums = [0.0] * 5

    def ticked(self, ticks: int, told: float) -> None:
        """A tick begins.

        Args:
            ticks: that have begun since the last call; all but one are made up for.
            told: ticks since the start by the clock's own count.
        """
        now = self._last = self._now()
        wall = (now - self._begin) * NANOSECOND
        late = wall - (self._ticks + 1) * self._tick
        self._ticks += ticks
        early = self._ticks * self._tick - wall
        self._add((now - self._opened) * NANOSECOND, told)
        if not self._checked:
            return
        apart, sign = max((late, "behind"), (early, "ahead of"))
        self.worst = max(self.worst, apart)
        if apart > self._limit and self.fault is None:
            self.fault = (
                f"model time is {1e3 * apart:.1f} ms {sign} the wall clock; "
                f"devices.limits.time_offset is {1e3 * self._limit:g} ms"
            )
        if now - self._opened > max(WINDOW, LEAST * self._tick) / NANOSECOND:
            factor = self.factor()
            self._window()
            if abs(factor - 1.0) > RATE_ERROR and self.fault is None:
                self.fault = (
                    f"in the last second it ran at {self.rate:.5g} Hz by the wall clock; the "
                    f"scenario's rate is {1.0 / self._tick:g} Hz (limit {100.0 * RATE_ERROR:g} %)"
                )

    def _add(self, x: float, told: float) -> None:
        if not told > self._told:  # no new record
            return
        y = told * self._tick
        self._told = told
        for i, value in enumerate((1.0, x, y, x * x, x * y)):
            self._sums[i] += value

    def factor(self) -> float:
        """Rate of the clock over the scenario's, since the window began: the slope of the
        regression of the time that its records tell on the wall clock. 0 for one that stands still.
        """
        n, x, y, xx, xy = self._sums
        spread = n * xx - x * x
        # of three records and fewer a slope is as uncertain as their arrival
        factor = (n * xy - x * y) / spread if n > 3 and spread > 0.0 else 0.0
        self.rate = factor / self._tick
        return factor
