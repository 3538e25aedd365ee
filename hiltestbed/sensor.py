"""The force sensor: the physical wrench goes in at the physics rate, its reading comes out once a tick.

The reading at t_k is the wrench at t_k less the delay, taken from a ring of the last physics instants by linear interpolation, so
that a delay need not be a whole number of ticks or of physics steps; before the start it is zero. The rest of the chain is in
:mod:`hiltestbed.effects.sensor`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from hiltestbed.effects.access import effects_of
from hiltestbed.effects.sensor import SensorChain, condition, sensor_chain, stack
from hiltestbed.frames import Array

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario

BLOCK = 256  # ticks of noise drawn at a time
WHOLE = 1e-6  # of a step: 5 ms is 20 steps of 0.25 ms, however the division was rounded
JITTER_CLIP = 8.0  # standard deviations of delay jitter that the ring can hold


class Sensor:
    """The sensors of `n` runs.

    Attributes:
        reading: (n, 6) the last reading [N, N m].
        ring: (n, L, 6) the last L physical wrenches, instant j at slot j modulo L.
        late: (n,) runs whose delay is never shorter than a physics step: their reading at t_k does not need the wrench at t_k.
    """

    def __init__(self, scenarios: Sequence[Scenario], rngs: Sequence[np.random.Generator]) -> None:
        """One generator a run: the same stream whatever the batch it runs in."""
        n = len(scenarios)
        self.tick = 1.0 / scenarios[0].rate
        self.substeps = round(scenarios[0].physics_rate / scenarios[0].rate)
        self.chain = stack([chain_of(s) for s in scenarios])
        self.noise_level = np.array([[s.sensor.noise] * 3 + [s.sensor.torque_noise] * 3 for s in scenarios])
        physics_step = self.tick / self.substeps
        longest = float(np.max(self.chain.delay + JITTER_CLIP * self.chain.jitter))
        self._delay_steps = self.chain.delay / physics_step
        self._jitter_steps = self.chain.jitter / physics_step
        self.late = self._delay_steps - JITTER_CLIP * self._jitter_steps > 1.0 - WHOLE
        self.ring = np.zeros((n, math.ceil(longest / physics_step) + self.substeps + 2, 6))
        stages = max(self.chain.lag.shape[1], self.chain.leak.shape[1])
        self._low, self._high, self._before = np.zeros((n, stages, 6)), np.zeros((n, stages, 6)), np.zeros((n, stages, 6))
        self.reading = np.zeros((n, 6))
        self._streams = [rng.spawn(2) for rng in rngs]  # noise and jitter apart: one does not shift the other
        self._noise = np.zeros((n, BLOCK, 6))
        self._jitter = np.zeros((n, BLOCK))
        self._noisy = np.flatnonzero(self.noise_level.any(axis=1))
        self._jittery = np.flatnonzero(self.chain.jitter)
        self._next_block = 0

    def read(self, k: int, wrench_sub: Array) -> Array:
        """The reading (n, 6) at t_k.

        Args:
            k: the tick; called once for each, from 0 on.
            wrench_sub: (n, m, 6) physical wrench at the m physics instants up to t_k, the last of which is t_k; of a run that is
                `late` the last may be anything, if :meth:`feel` tells it before the next tick.
        """
        while k >= self._next_block:  # a loop that starts from a saved state draws what lies before it
            self._draw()
        _read(
            k, self.tick, self.ring, wrench_sub, self._delay_steps, self._jitter_steps, self._noise, self._jitter,
            *self.chain.arrays(), self._low, self._high, self._before, self.reading,
        )  # fmt: skip
        return self.reading

    def feel(self, k: int, wrench: Array) -> None:
        """The wrench (n, 6) at t_k, where it was not known to :meth:`read`: of runs that are `late`."""
        self.ring[:, k * self.substeps % self.ring.shape[1]] = wrench

    def _draw(self) -> None:
        self._next_block += BLOCK
        for i in self._noisy:
            self._streams[i][0].standard_normal(out=self._noise[i])
            self._noise[i] *= self.noise_level[i]
        for i in self._jittery:
            self._streams[i][1].standard_normal(out=self._jitter[i])

    def buffers(self) -> dict[str, Array]:
        """The arrays that make up the state."""
        return {
            "ring": self.ring, "reading": self.reading, "low": self._low, "high": self._high, "before": self._before,
            "noise": self._noise, "jitter": self._jitter,
        }  # fmt: skip


def chain_of(scenario: Scenario) -> SensorChain:
    """The sensor chain that a scenario describes, effects included."""
    s = scenario.sensor
    return sensor_chain(
        effects_of(scenario),
        1.0 / scenario.rate,
        delay=s.delay,
        lowpass=s.lowpass,
        time_constant=s.time_constant,
        drift=s.drift,
        quantisation=(s.quantisation, s.torque_quantisation),
        ranges=(s.range, s.torque_range),
    )


@njit(cache=True)
def _read(k, h, ring, sub, delay, jitter, noise, shake, calibration, lag, leak, offset, drift, tone, deadzone, limit, step, low, high,
          before, out):  # fmt: skip
    n, m = sub.shape[0], sub.shape[1]
    length = ring.shape[1]
    late = np.empty(6)
    row = k % noise.shape[1]
    for i in range(n):
        for s in range(m):
            ring[i, (k * m - m + 1 + s) % length] = sub[i, s]
        lateness = delay[i]
        if jitter[i] > 0.0:
            lateness += jitter[i] * min(max(shake[i, row], -JITTER_CLIP), JITTER_CLIP)
        at = k * m - max(lateness, 0.0)
        whole = round(at)
        if abs(at - whole) < WHOLE:
            at = whole
        first = math.floor(at)
        part = at - first
        for j in range(6):
            late[j] = 0.0
            if first >= 0:
                late[j] = ring[i, first % length, j]
            if part > 0.0:
                after = ring[i, (first + 1) % length, j] if first + 1 >= 0 else 0.0
                late[j] += part * (after - late[j])
        condition(
            late, k * h, noise[i, row], calibration[i], lag[i], leak[i], offset[i], drift[i], tone[i], deadzone[i], limit[i], step[i],
            low[i], high[i], before[i], out[i],
        )  # fmt: skip
