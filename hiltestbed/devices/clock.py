"""The cycle clock of a loop that is not paced by a device: due times, wake-up latencies and run
times of the cycles.

Cycle k is due at ``start + k period`` on the monotonic clock, however long the cycles before it
took: there is no drift. The wait sleeps until shortly before that and then spins. Cycles that an
overrun has passed completely are skipped and counted, not caught up with.
"""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from hiltestbed.devices.interface import SPIN
from hiltestbed.errors import InputError

SECOND = 1_000_000_000  # [ns]


class CycleClock:
    """Paces cycles and records their times in preallocated arrays.

    Attributes:
        cycles: number of cycles begun.
        skipped: number of cycles skipped because those before took too long.
        due, began, ended: (capacity,) [ns] on the monotonic clock, of each cycle; ``began - due``
            is its wake-up latency. Only the last ``capacity`` cycles are kept.
    """

    def __init__(self, rate: float, capacity: int, spin: float = SPIN) -> None:
        """``rate`` [Hz] of the cycles; times of the last ``capacity`` are kept; ``spin`` [s] of
        each wait is busy.
        """
        if not 0.1 <= rate <= 1e5 or capacity < 1:
            raise InputError(
                f"rate: cannot be paced (got {rate:g} Hz for {capacity} cycles); allowed are 0.1 "
                f"to 1e5 Hz and at least one cycle"
            )
        self.period = 1.0 / rate
        self.cycles = self.skipped = 0
        self.due: NDArray[np.int64] = np.zeros(capacity, dtype=np.int64)
        self.began: NDArray[np.int64] = np.zeros(capacity, dtype=np.int64)
        self.ended: NDArray[np.int64] = np.zeros(capacity, dtype=np.int64)
        self._rate, self._spin = rate, round(spin * SECOND)
        self._start = self._next = 0

    def start(self) -> None:
        """Start the clock: the first cycle is due one period from now."""
        self.cycles = self.skipped = 0
        self._start = time.monotonic_ns()
        self._next = 1

    def wait(self) -> int:
        """Wait for the next cycle; returns the number of cycles skipped before it."""
        due = self._start + round(self._next * SECOND / self._rate)
        now = time.monotonic_ns()
        left_out = 0
        if now - due > SECOND / self._rate:
            left_out = int((now - due) * self._rate / SECOND)
            self._next += left_out
            self.skipped += left_out
            due = self._start + round(self._next * SECOND / self._rate)
        asleep = due - now - self._spin
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

    def done(self) -> None:
        """Mark the end of the cycle's work."""
        self.ended[(self.cycles - 1) % len(self.due)] = time.monotonic_ns()

    def left(self) -> float:
        """Time until the next cycle is due [s]; negative if it is overdue."""
        return (
            self._start + round(self._next * SECOND / self._rate) - time.monotonic_ns()
        ) / SECOND

    def latency(self) -> NDArray[np.float64]:
        """(cycles,) wake-up latency of each kept cycle [s], in order."""
        return self._in_order(self.began - self.due)

    def busy(self) -> NDArray[np.float64]:
        """(cycles,) run time of each kept cycle [s], in order."""
        return self._in_order(self.ended - self.began)

    def _in_order(self, times: NDArray[np.int64]) -> NDArray[np.float64]:
        n = len(times)
        kept = times[: self.cycles] if self.cycles <= n else np.roll(times, -(self.cycles % n))
        return kept / SECOND
