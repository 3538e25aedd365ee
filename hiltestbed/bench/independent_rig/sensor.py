"""The force sensor and the compensator of this rig.

Effects follow each other as delay, gain, crosstalk, lag, high-pass, hum, drift, bias, noise, dead zone, saturation;
with `quiet_zone` the dead zone and the saturation come before the noise.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

LAG, HIGH, BEFORE, HELD = range(4)  # states, (4, 6)


class Sensor(NamedTuple):
    """The chain from the physical wrench to the reading. SI; zero switches a term off."""

    gain: np.ndarray  # (6,)
    cross: np.ndarray  # (6, 6): what a source (column) adds to an axis (row)
    drift: np.ndarray  # (3,) N/s
    bias: np.ndarray  # (6,)
    hum: np.ndarray  # (3,) N
    delay: float
    hum_frequency: float = 0.0
    hum_phase: float = 0.0
    lag: float = 0.0
    highpass: float = 0.0
    jitter: float = 0.0
    deadzone: float = 0.0
    limit: float = 0.0
    quiet_zone: bool = False
    skew: float = 0.0  # s, of the record alone
    stretch: float = 0.0  # foreign: the clock of the record runs fast by this part
    freeze: float = 0.0  # s, foreign: the record holds its value this long, every 0.1 s
    warming: float = 0.0  # 1/s, foreign: gain that grows with time
    slope: float = 0.0  # 1/m, foreign: gain that varies along the lateral position
    heavy: float = 0.0  # s/N, foreign: delay that grows with the force
    hysteresis: float = 0.0  # N, foreign: play in the reading
    quantum: float = 0.0  # N, foreign: steps of the converter
    repeat: float = 0.0  # s, foreign: the reading stands still this long, at random


class Compensator(NamedTuple):
    """Phase lead (T1 s + 1)/(T2 s + 1) and what is done before and after it."""

    t1: float
    t2: float
    lead: bool = True
    deadzone: float = 0.0
    gain: float = 1.0  # foreign
    slew: float = 0.0  # N/s, foreign: limit of the output's rate


@njit(cache=True)
def _clip(sensor, out):
    for a in range(3):
        if abs(out[a]) < sensor.deadzone:
            out[a] = 0.0
        if sensor.limit > 0.0:
            out[a] = min(max(out[a], -sensor.limit), sensor.limit)


@njit(cache=True)
def read(sensor, raw, place, noise, t, h, state, out):
    """Reading (6,) at t from the late physical wrench `raw` (6,); `place` (3,) is where the tip was then."""
    for a in range(6):
        out[a] = raw[a] * sensor.gain[a] * (1.0 + sensor.warming * t + sensor.slope * place[0])
        for source in range(6):
            out[a] += sensor.cross[a, source] * raw[source]
    if sensor.lag > 0.0:
        state[LAG] += (out - state[LAG]) * (1.0 - math.exp(-h / sensor.lag))
        out[:] = state[LAG]
    if sensor.highpass > 0.0:
        state[HIGH] = math.exp(-h / sensor.highpass) * (state[HIGH] + out - state[BEFORE])
        state[BEFORE] = out
        out[:] = state[HIGH]
    if sensor.hysteresis > 0.0:
        for a in range(3):
            state[HELD, a] = min(max(state[HELD, a], out[a] - sensor.hysteresis), out[a] + sensor.hysteresis)
            out[a] = state[HELD, a]
    tone = math.sin(2.0 * math.pi * sensor.hum_frequency * t + sensor.hum_phase)
    for a in range(3):
        out[a] += sensor.hum[a] * tone + sensor.drift[a] * t
    out += sensor.bias
    if sensor.quiet_zone:
        _clip(sensor, out)
    out += noise
    if not sensor.quiet_zone:
        _clip(sensor, out)
    if sensor.quantum > 0.0:
        for a in range(3):
            out[a] = sensor.quantum * math.floor(out[a] / sensor.quantum + 0.5)


@njit(cache=True)
def compensate(comp, reading, h, last, out):
    """What drives the numerical model; `last` (2, 6) holds the input and the output of the tick before, `out` (6,) is written."""
    for a in range(6):
        u = reading[a]
        if a < 3 and abs(u) < comp.deadzone:
            u = 0.0
        y = u
        if comp.lead:
            y = (last[1, a] * comp.t2 / h + u + comp.t1 * (u - last[0, a]) / h) / (1.0 + comp.t2 / h)
        last[0, a], last[1, a] = u, y
        y *= comp.gain
        if comp.slew > 0.0:
            y = min(max(y, out[a] - comp.slew * h), out[a] + comp.slew * h)
        out[a] = y
