"""A delay line: past values of an array, each run with its own delay."""

from __future__ import annotations

import math

import numpy as np

from hiltestbed.frames import Array


class History:
    """The last values of an array ``(n, m)``, one per tick, interpolated between ticks; before the
    first tick the first value holds.
    """

    def __init__(self, width: int, longest: Array) -> None:
        """``longest`` (n,): longest delay of each run [ticks]."""
        n = len(longest)
        self.values = np.zeros((n, math.ceil(float(np.max(longest))) + 2, width))
        self.clock = np.zeros(1, dtype=np.int64)

    def remember(self, value: Array) -> None:
        """Store the value ``(n, m)`` of this tick."""
        k = int(self.clock[0])
        if k == 0:
            self.values[:] = value[:, None]
        else:
            self.values[:, k % self.values.shape[1]] = value
        self.clock[0] = k + 1

    def before(self, ticks: Array, out: Array) -> Array:
        """``out`` (n, m): the value ``ticks`` (n,) before the last stored one."""
        whole = np.floor(ticks)
        part, slot = (ticks - whole)[:, None], int(self.clock[0]) - 1 - whole.astype(np.int64)
        runs, length = np.arange(len(out)), self.values.shape[1]
        late, early = self.values[runs, slot % length], self.values[runs, (slot - 1) % length]
        np.add((1.0 - part) * late, part * early, out=out)
        return out
