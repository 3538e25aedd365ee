"""The force sensor of this rig.

Effects are applied in the order delay, gain, crosstalk, lag, high-pass, hum, drift, bias, noise,
dead zone, saturation; with `quiet_zone` the dead zone and the saturation come before the noise.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hiltestbed.compiled.jit import njit

LAG, HIGH, BEFORE, HELD, INPUT, STATES = range(6)  # states, (STATES, 6)
EXPONENTIAL, BACKWARD, TRAPEZOIDAL = range(3)  # schemes of the lag


class Sensor(NamedTuple):
    """The chain from the physical wrench to the reading. SI; zero switches a term off."""

    gain: np.ndarray  # (6,)
    cross: np.ndarray  # (6, 6): crosstalk from a source (column) to an axis (row)
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
    skew: float = 0.0  # s, delay of the log only
    stretch: float = 0.0  # foreign: the clock of the log is fast by this fraction
    freeze: float = 0.0  # s, foreign: the log holds its value this long, every 0.1 s
    warming: float = 0.0  # 1/s, foreign: gain that grows with time
    slope: float = 0.0  # 1/m, foreign: gain that varies with the lateral position
    heavy: float = 0.0  # s/N, foreign: delay that grows with the force
    hysteresis: float = 0.0  # N, foreign: play in the reading, half width
    quantum: float = 0.0  # N, foreign: quantisation of the converter
    repeat: float = 0.0  # s, foreign: the reading is held this long, at random times
    depth_slope: float = 0.0  # 1/m, foreign: gain that varies along the insertion
    lag_scheme: int = EXPONENTIAL


@njit(cache=True)
def _clip(sensor, out):
    for a in range(3):
        if abs(out[a]) < sensor.deadzone:
            out[a] = 0.0
        if sensor.limit > 0.0:
            out[a] = min(max(out[a], -sensor.limit), sensor.limit)


@njit(cache=True)
def lagged(sensor, y, before, u, h):
    """The low-pass of y at the end of a tick h [s] with a linear input from `before` to `u`."""
    if sensor.lag_scheme == BACKWARD:
        return y + (u - y) * h / (sensor.lag + h)
    if sensor.lag_scheme == TRAPEZOIDAL:
        return y + (0.5 * (before + u) - y) * h / (sensor.lag + 0.5 * h)
    behind = sensor.lag * (u - before) / h  # of a ramp, once the start is forgotten
    return u - behind + (y - before + behind) * math.exp(-h / sensor.lag)


@njit(cache=True)
def read(sensor, raw, place, noise, t, h, state, out):
    """Reading (6,) at t of the delayed wrench `raw` (6,) with the tip at `place` (3,)."""
    for a in range(6):
        out[a] = raw[a] * sensor.gain[a] * (1.0 + sensor.warming * t + sensor.slope * place[0])
        if sensor.depth_slope != 0.0:
            out[a] *= 1.0 + sensor.depth_slope * place[2]
        for source in range(6):
            out[a] += sensor.cross[a, source] * raw[source]
    if sensor.lag > 0.0:
        state[LAG] = lagged(sensor, state[LAG], state[INPUT], out, h)
        state[INPUT] = out
        out[:] = state[LAG]
    if sensor.highpass > 0.0:
        settled = sensor.highpass * (out - state[BEFORE]) / h  # after a long ramp
        state[HIGH] = settled + (state[HIGH] - settled) * math.exp(-h / sensor.highpass)
        state[BEFORE] = out
        out[:] = state[HIGH]
    if sensor.hysteresis > 0.0:
        for a in range(3):
            state[HELD, a] = min(
                max(state[HELD, a], out[a] - sensor.hysteresis), out[a] + sensor.hysteresis
            )
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
def lateness(sensor, drawn, force):
    """Delay [s] of a reading, with a random number for its jitter, under a force [N]."""
    return max(sensor.delay + sensor.jitter * drawn + sensor.heavy * abs(force), 0.0)


@njit(cache=True)
def logs_apart(sensor):
    """Whether the log reads the sensor at another time than the loop."""
    return sensor.skew > 0.0 or sensor.stretch != 0.0


@njit(cache=True)
def stamped(sensor, t):
    """The time [s] that the log shows in its row of `t`."""
    return t * (1.0 - sensor.stretch) - sensor.skew


@njit(cache=True)
def sense(sensor, noise, k, h, felt, chains, still, used, logged):
    """Read tick k to `used` and `logged` (ticks, 6).

    felt: wrench and place for the loop, and those for the log. chains: (STATES, 6) of both.
        still: ticks for which a held reading still repeats; returned anew.
    """
    raw, where, raw_log, where_log = felt
    t = k * h
    read(sensor, raw, where, noise.reading[k], t, h, chains[0], used[k])
    if sensor.repeat > 0.0:
        if still > 0:
            used[k], still = used[k - 1], still - 1
        elif k > 0 and noise.repeat[k] < 0.01:
            still = int(sensor.repeat / h)
    logged[k] = used[k]
    if logs_apart(sensor):
        stamp = stamped(sensor, t)
        back = k - int((t - stamp) / h + 0.5)
        then = noise.reading[back] if 0 <= back < len(noise.reading) else np.zeros(6)
        read(sensor, raw_log, where_log, then, stamp, h, chains[1], logged[k])
    if sensor.freeze > 0.0 and k > 0 and (t % 0.1) < sensor.freeze:
        logged[k] = logged[k - 1]
    return still
