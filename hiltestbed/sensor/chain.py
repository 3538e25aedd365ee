"""The sensor's signal chain, from the contact wrench to the reading.

The order is the physical one. The wrench is delayed (nominal delay, `sensor.delay`,
`sensor.jitter`); the transducer measures it along its own axes (`sensor.rotation`), scales and
mixes them (`sensor.gain`, `sensor.crosstalk`) and applies a calibration curve (`sensor.map`); the
electronics filter (nominal low-pass, `sensor.lag`, then the nominal charge leakage,
`sensor.highpass`) and add errors that do not depend on the force (`sensor.bias`, `sensor.drift`,
`sensor.hum`, noise); the conversion then zeroes small forces (`sensor.deadzone`), clips
(`sensor.saturation`, the nominal range) and quantises.
"""

from __future__ import annotations

import math

import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.config.piecewise import along
from hiltestbed.sensor.filters import lagged, leaked

# Rows of a filter stage's memory: output and last input of its low-pass and of its high-pass.
LOW, LOW_INPUT, HIGH, HIGH_INPUT, MEMORY = range(5)


@njit(cache=True)
def condition(
    w,
    t,
    noise,
    calibration,
    curve,
    lag,
    leak,
    offset,
    drift,
    tone,
    deadzone,
    limit,
    step,
    memory,
    out,
):
    """Pass one sample through the sensor, after the delay.

    Args:
        w: (m, 6) the delayed wrench at the instants of the tick that ends with the sample; without
            a filter only the last is used.
        t: [s]. noise: (6,) added before the conversion.
        calibration ... step: see :class:`hiltestbed.sensor.parameters.Chain`, of one run.
        memory: (S, MEMORY, 6) of the filters, changed in place; zero at the start.
        out: (6,) the reading.
    """
    last = w.shape[0] - 1
    for j in range(6):
        y = 0.0
        for at in range(0 if filters(lag, leak) else last, last + 1):
            y = 0.0
            for i in range(6):
                if calibration[j, i] != 0.0:
                    y += calibration[j, i] * w[at, i]
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
        y += offset[j] + drift[j] * t
        if j < 3:
            for s in range(tone.shape[0]):
                if tone[s, j] != 0.0:
                    y += tone[s, j] * math.sin(2.0 * math.pi * tone[s, 3] * t + tone[s, 4])
        y += noise[j]
        if abs(y) < deadzone[j]:
            y = 0.0
        y = min(max(y, -limit[j]), limit[j])
        if step[j] > 0.0:
            y = step[j] * np.rint(y / step[j])
        out[j] = y


@njit(cache=True)
def condition_all(
    t,
    late,
    noise,
    calibration,
    curve,
    lag,
    leak,
    offset,
    drift,
    tone,
    deadzone,
    limit,
    step,
    memory,
    out,
):
    """:func:`condition` for n runs: late (n, m, 6), noise and out (n, 6), t (n,) [s], memory (n, S,
    MEMORY, 6).
    """
    for i in range(late.shape[0]):
        condition(
            late[i],
            t[i],
            noise[i],
            calibration[i],
            curve[i],
            lag[i],
            leak[i],
            offset[i],
            drift[i],
            tone[i],
            deadzone[i],
            limit[i],
            step[i],
            memory[i],
            out[i],
        )


@njit(cache=True)
def filters(lag, leak):
    """Whether a low-pass or a high-pass acts: the reading then depends on the whole tick."""
    return np.any(lag[:, 0] < 1.0) or np.any(leak[:, 0] < 1.0)


@njit(cache=True)
def passes(calibration, curve, lag, leak, offset, drift, tone, deadzone, limit):
    """Whether the reading is the wrench, apart from noise and quantisation; see :func:`condition`
    for the arguments.
    """
    for j in range(6):
        for i in range(6):
            if calibration[j, i] != (1.0 if i == j else 0.0):
                return False
        if (
            curve[j, 0] > 0.0
            or offset[j] != 0.0
            or drift[j] != 0.0
            or deadzone[j] != 0.0
            or limit[j] < math.inf
        ):
            return False
    for s in range(tone.shape[0]):
        for j in range(3):
            if tone[s, j] != 0.0:
                return False
    return not filters(lag, leak)
