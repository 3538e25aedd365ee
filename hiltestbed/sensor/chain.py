"""The sensor's signal chain, from the contact wrench to the reading.

The order is the physical one. The wrench is delayed (nominal delay, `sensor.delay`,
`sensor.jitter`); the transducer measures it along its own axes (`sensor.rotation`), scales and
mixes them (`sensor.gain`, `sensor.crosstalk`) and applies a calibration curve (`sensor.map`); the
electronics filter (nominal low-pass, `sensor.lag`, then the nominal charge leakage,
`sensor.highpass`) and add errors that do not depend on the force (`sensor.bias`, `sensor.drift`,
`sensor.hum`, noise); the conversion then zeroes small forces (`sensor.deadzone`), clips
(`sensor.saturation`, the nominal range) and quantises.

The filters are of first order; their analogue signal is known at instants a step h apart and linear
between them. From y' = (u - y)/T, with a = exp(-h/T) and b = (1 - a) T/h, the response to u(t) =
u_0 + (u_1 - u_0) t/h at the end of the step is y_1 = a y_0 + (b - a) u_0 + (1 - b) u_1. It is
exact, so that a ramp comes out later by T whatever the step is; held over the step, the signal
would come out later by only h/(exp(h/T) - 1). The high-pass s T/(1 + s T) is the signal minus its
low-pass: z_1 = a z_0 + b (u_1 - u_0).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from hiltestbed.compiled.jit import njit
from hiltestbed.config.piecewise import along
from hiltestbed.frames import Array

if TYPE_CHECKING:
    from hiltestbed.sensor.settings import Sensor


def filters_of(sensors: Sequence[Sensor]) -> tuple[Array, Array]:
    """(n,) nominal time constants [s] of low-pass, 0: none, and high-pass, infinite: none."""
    low = [0.0 if s.lowpass is None else 1.0 / (2.0 * math.pi * s.lowpass) for s in sensors]
    high = [math.inf if s.time_constant is None else s.time_constant for s in sensors]
    return np.array(low), np.array(high)


def low_pass(time_constant: ArrayLike, step: float) -> Array:
    """``(..., 2)`` weights per step [s] of the signal, 1 - b, b - a; time constant [s], 0: none."""
    a, b = _decay(time_constant, step)
    return np.stack([1.0 - b, b - a], axis=-1)


def high_pass(time_constant: ArrayLike, step: float) -> Array:
    """``(..., 2)`` factors per step [s], a and b; time constant [s], infinite: none."""
    return np.stack(_decay(time_constant, step), axis=-1)


def _decay(time_constant: ArrayLike, step: float) -> tuple[Array, Array]:
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = step / np.asarray(time_constant, dtype=float)
        mean = np.where(ratio > 0.0, -np.expm1(-ratio) / ratio, 1.0)
    return np.exp(-ratio), mean


@njit(cache=True)
def lagged(y, u, before, weights):
    """Low-passed at the end of a step; ``y``, ``before``: output and signal at its start."""
    return y + ((u - y) * weights[0] + (before - y) * weights[1])


@njit(cache=True)
def leaked(z, u, before, factors):
    """The high-passed signal at the end of a step, as in :func:`lagged`."""
    return factors[0] * z + factors[1] * (u - before)


FILTERED = 3  # numbers that :func:`filtered` remembers: low-passed value, its input, high-passed


@njit(cache=True)
def filtered(u, low, high, memory):
    """``u``, at the end of a step, through a low-pass and a high-pass; ``memory`` (FILTERED,)."""
    before = memory[0]
    memory[0] = lagged(before, u, memory[1], low)
    memory[1] = u
    if high[0] < 1.0:
        memory[2] = leaked(memory[2], memory[0], before, high)
        return memory[2]
    return memory[0]


# Rows of a filter stage's memory: output and last input of its low-pass and of its high-pass.
LOW, LOW_INPUT, HIGH, HIGH_INPUT, MEMORY = range(5)


@njit(cache=True)
def condition(i, e, w, t, noise, memory, out):
    """Pass one sample through sensor ``i``, after the delay.

    Args:
        e: :class:`hiltestbed.sensor.parameters.Elements` of all sensors.
        w: (m, 6) the delayed wrench at the instants of the tick that ends with the sample; without
            a filter only the last is used.
        t: [s]. noise: (6,) added before the conversion.
        memory: (S, MEMORY, 6) of the filters, changed in place; zero at the start.
        out: (6,) the reading.
    """
    calibration, curve, tone = e.calibration[i], e.curve[i], e.tone[i]
    lag, leak, limit, step = e.lag[i], e.leak[i], e.limit[i], e.step[i]
    last = w.shape[0] - 1
    for j in range(6):
        y = 0.0
        for at in range(0 if filters(lag, leak) else last, last + 1):
            y = 0.0
            for c in range(6):
                if calibration[j, c] != 0.0:
                    y += calibration[j, c] * w[at, c]
            if curve[j, 0] > 0.0:
                y = along(curve[j], y)
            for s in range(lag.shape[0]):
                if lag[s, 0] < 1.0:
                    state = memory[s]
                    u, y = y, lagged(state[LOW, j], y, state[LOW_INPUT, j], lag[s])
                    state[LOW, j], state[LOW_INPUT, j] = y, u
            for s in range(leak.shape[0]):
                if leak[s, 0] < 1.0:
                    state = memory[s]
                    u, y = y, leaked(state[HIGH, j], y, state[HIGH_INPUT, j], leak[s])
                    state[HIGH, j], state[HIGH_INPUT, j] = y, u
        y += e.offset[i, j] + e.drift[i, j] * t
        if j < 3:
            for s in range(tone.shape[0]):
                if tone[s, j] != 0.0:
                    y += tone[s, j] * math.sin(2.0 * math.pi * tone[s, 3] * t + tone[s, 4])
        y += noise[j]
        if abs(y) < e.deadzone[i, j]:
            y = 0.0
        y = min(max(y, -limit[j]), limit[j])
        if step[j] > 0.0:
            y = step[j] * np.rint(y / step[j])
        out[j] = y


@njit(cache=True)
def filters(lag, leak):
    """Whether a low-pass or a high-pass acts: the reading then depends on the whole tick."""
    for s in range(lag.shape[0]):
        if lag[s, 0] < 1.0:
            return True
    for s in range(leak.shape[0]):
        if leak[s, 0] < 1.0:
            return True
    return False


@njit(cache=True)
def passes(i, e):
    """Whether sensor ``i`` changes nothing but adds noise and quantises, see :func:`condition`."""
    for j in range(6):
        for c in range(6):
            if e.calibration[i, j, c] != (1.0 if c == j else 0.0):
                return False
        clear = e.curve[i, j, 0] == 0.0 and e.offset[i, j] == 0.0 and e.drift[i, j] == 0.0
        if not clear or e.deadzone[i, j] != 0.0 or e.limit[i, j] < math.inf:
            return False
    if np.any(e.tone[i, :, :3] != 0.0):
        return False
    return not filters(e.lag[i], e.leak[i])
