"""The force sensor: its input is the physical wrench at the physics rate, its output one reading
per tick.

The reading at t_k is the wrench at t_k - delay, interpolated linearly in a ring buffer of the last
physics instants, so that the delay need not be a whole number of ticks or of physics steps; before
the start it is zero. Filters see the delayed wrench at every physics instant of the tick. The rest
of the chain is in :mod:`hiltestbed.sensor.chain`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array
from hiltestbed.sensor.chain import MEMORY, condition, filters
from hiltestbed.sensor.parameters import SensorParameters, stack

BLOCK = 256  # ticks of noise drawn at a time
# physics steps within which a delay counts as whole: 5 ms is 20 steps of 0.25 ms, however the
# division was rounded
WHOLE = 1e-6
# standard deviations at which delay jitter is clipped, and for which the ring buffer is sized
JITTER_CLIP = 8.0


class _Delay(NamedTuple):
    """The delay line, in physics steps."""

    ring: Array  # (n, L, 6)
    delay: Array  # (n,)
    jitter: Array  # (n,) standard deviation
    shake: Array  # (n, BLOCK) random numbers of a block of ticks
    arrived: Array  # (n, m, 6) the wrench that arrives in a tick


class Sensors:
    """The sensors of `n` runs.

    Attributes:
        reading: (n, 6) the last reading [N, N m].
        ring: (n, L, 6) the last L physical wrenches, instant j at slot j modulo L.
        late: (n,) whether a run's delay is never shorter than a physics step: its reading at t_k
            then does not need the wrench at t_k.
    """

    def __init__(
        self,
        parameters: Sequence[SensorParameters],
        tick: float,
        substeps: int,
        rngs: Sequence[np.random.Generator],
    ) -> None:
        """Sensors with ``parameters``, read every ``tick`` [s] of so many ``substeps`` of the
        physics; ``rngs``: one per run, so that random numbers do not depend on the batch.
        """
        n, self.substeps, physics_step = len(parameters), substeps, tick / substeps
        elements = stack(parameters, physics_step)
        stages = max(elements.lag.shape[1], elements.leak.shape[1])
        memory, self.reading = np.zeros((n, stages, MEMORY, 6)), np.zeros((n, 6))
        delay, jitter = (np.array([getattr(p, k) for p in parameters]) for k in ("delay", "jitter"))
        longest = float(np.max(delay + JITTER_CLIP * jitter))
        steps, spread = delay / physics_step, jitter / physics_step
        self.late = steps - JITTER_CLIP * spread > 1.0 - WHOLE
        self.ring = np.zeros((n, math.ceil(longest / physics_step) + substeps + 2, 6))
        # separate streams: noise does not shift jitter, nor jitter noise
        self._streams = [rng.spawn(2) for rng in rngs]
        self._noise = np.zeros((n, BLOCK, 6))
        self._jitter = np.zeros((n, BLOCK))
        self._level = np.array([p.noise for p in parameters])
        self._noisy = np.flatnonzero(self._level.any(axis=1))
        self._jittery = np.flatnonzero(jitter)
        self._next_block = 0
        late = _Delay(self.ring, steps, spread, self._jitter, np.zeros((n, substeps, 6)))
        chain = (self._noise, elements, memory, self.reading)
        self._read = Call(_read, ..., tick, GIVEN, late, *chain)

    def read(self, k: int, wrench_sub: Array) -> Array:
        """The reading (n, 6) at t_k.

        Args:
            k: the tick; called once for each, from 0 on.
            wrench_sub: (n, m, 6) physical wrench at the m physics instants up to t_k, the last of
                which is t_k; for a run that is `late` the last may be arbitrary, if :meth:`feel`
                supplies it before the next tick.
        """
        # a loop that starts from a saved state draws the earlier blocks as well
        while k >= self._next_block:
            self._draw()
        self._read.on(wrench_sub)(k)
        return self.reading

    def feel(self, k: int, wrench: Array) -> None:
        """Supply the wrench (n, 6) at t_k that :meth:`read` did not know: of `late` runs."""
        self.ring[:, k * self.substeps % self.ring.shape[1]] = wrench

    def _draw(self) -> None:
        self._next_block += BLOCK
        for i in self._noisy:
            self._streams[i][0].standard_normal(out=self._noise[i])
            self._noise[i] *= self._level[i]
        for i in self._jittery:
            self._streams[i][1].standard_normal(out=self._jitter[i])


@njit(cache=True)
def _read(k, h, sub, late, noise, e, memory, out):
    """One tick of all sensors: delay, then the elements ``e``; ``noise`` (n, BLOCK, 6)."""
    ring, delay, jitter, shake, arrived = late
    (n, m, _), length, row = sub.shape, ring.shape[1], k % BLOCK
    for i in range(n):
        for s in range(m):
            for j in range(6):
                ring[i, (k * m - m + 1 + s) % length, j] = sub[i, s, j]
        lateness = delay[i]
        if jitter[i] > 0.0:
            lateness += jitter[i] * min(max(shake[i, row], -JITTER_CLIP), JITTER_CLIP)
        # the wrench at t - delay, at each instant of the tick if a filter needs it, else the last
        for s in range(0 if filters(e.lag[i], e.leak[i]) else m - 1, m):
            at = k * m - max(lateness, 0.0) - (m - 1 - s)
            whole = round(at)
            if abs(at - whole) < WHOLE:
                at = whole
            first = math.floor(at)
            part = at - first
            for j in range(6):
                arrived[i, s, j] = 0.0
                if first >= 0:
                    arrived[i, s, j] = ring[i, first % length, j]
                if part > 0.0:
                    after = ring[i, (first + 1) % length, j] if first + 1 >= 0 else 0.0
                    arrived[i, s, j] += part * (after - arrived[i, s, j])
        condition(i, e, arrived[i], k * h, noise[i, row], memory[i], out[i])
