"""A delay line: past values of an array, each run with its own delay."""

from __future__ import annotations

import math

import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array


class History:
    """The last values of an array ``(n, m)``, one per tick, interpolated; before them the first."""

    def __init__(self, width: int, longest: Array) -> None:
        """``longest`` (n,): longest delay of each run [ticks]."""
        n = len(longest)
        self.values = np.zeros((n, math.ceil(float(np.max(longest))) + 2, width))
        self.clock, self._out = np.zeros(1, dtype=np.int64), np.zeros((n, width))

    def remember(self, value: Array) -> None:
        """Store the value ``(n, m)`` of this tick."""
        k = int(self.clock[0])
        if k == 0:
            self.values[:] = value[:, None]
        else:
            self.values[:, k % self.values.shape[1]] = value
        self.clock[0] = k + 1

    def before(self, ticks: Array) -> Array:
        """``(n, m)`` the value ``ticks`` (n,) before the last stored one, until the next call."""
        _before(int(self.clock[0]) - 1, self.values, ticks, self._out)
        return self._out


@njit(cache=True)
def _before(k, values, ticks, out):
    length = values.shape[1]
    for i in range(out.shape[0]):
        whole = int(math.floor(ticks[i]))
        part = ticks[i] - whole
        late, early = (k - whole) % length, (k - whole - 1) % length
        for j in range(out.shape[1]):
            out[i, j] = (1.0 - part) * values[i, late, j] + part * values[i, early, j]
