"""What happens to the wrench between the contact and the sensor's reading.

The order is the physical one. The wrench arrives late (nominal delay, `sensor.delay`, `sensor.jitter`); the transducer scales
and mixes axes (`sensor.gain`, `sensor.crosstalk`); its electronics filter (nominal low-pass, `sensor.lag`, then the nominal charge
leak, `sensor.highpass`) and add what does not depend on the force (`sensor.bias`, `sensor.drift`, `sensor.hum`, noise); the
conversion then cuts small forces (`sensor.deadzone`), clips (`sensor.saturation`, the nominal range) and quantises.

One set of kernels serves the simulation, which calls them sample by sample, and the diagnosis, which runs them over a record.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from hiltestbed.effects.vocabulary import AXES, WRENCH_AXES
from hiltestbed.frames import Array

_KEYS = ("delay", "jitter", "calibration", "lag", "leak", "offset", "drift", "tone", "deadzone", "limit", "step")


@dataclass
class SensorChain:
    """Parameters of one sensor (or of n: every array then has the run as leading axis).

    Attributes:
        delay: () [s], nominal and added. jitter: () [s], its standard deviation.
        calibration: (6, 6) what the transducer makes of the wrench.
        lag: (S,) blend factor of each low-pass a tick, 1 - exp(-h/T); 1 passes.
        leak: (S,) factor of each high-pass a tick, exp(-h/T); negative passes.
        offset: (6,) [N, N m]. drift: (6,) [N/s, N m/s].
        tone: (H, 5) amplitude on x, y, z [N], frequency [Hz], phase [rad].
        deadzone: (6,) and limit: (6,) [N, N m]. step: (6,) quantisation step, 0 for none.
    """

    delay: Array
    jitter: Array
    calibration: Array
    lag: Array
    leak: Array
    offset: Array
    drift: Array
    tone: Array
    deadzone: Array
    limit: Array
    step: Array

    def arrays(self) -> tuple[Array, Array, Array, Array, Array, Array, Array, Array, Array]:
        """The fields in the order of the kernels' arguments, after the delay and its jitter."""
        return (
            self.calibration, self.lag, self.leak, self.offset, self.drift, self.tone, self.deadzone, self.limit, self.step,
        )  # fmt: skip


def sensor_chain(
    effects: Sequence[tuple[str, dict]],
    h: float,
    delay: float = 0.0,
    lowpass: float | None = None,
    time_constant: float | None = None,
    drift: Sequence[float] = (0.0, 0.0, 0.0),
    quantisation: Sequence[float] = (0.0, 0.0),
    ranges: Sequence[float | None] = (None, None),
) -> SensorChain:
    """The chain of one sensor at tick `h` [s].

    Args:
        effects: (id, parameters) of the rig; those of other links are passed over.
        delay: nominal delay [s]. lowpass: cutoff [Hz]. time_constant: of the charge leak [s]. drift: [N/s] on x, y, z.
        quantisation, ranges: of the forces [N] and of the torques [N m].
    """
    calibration = np.eye(6)
    lag, leak, tone = [1.0], [-1.0], [(0.0, 0.0, 0.0, 1.0, 0.0)]
    offset, ramp, jitter = np.zeros(6), np.zeros(6), 0.0
    ramp[:3] = drift
    deadzone, limit = np.zeros(6), np.full(6, np.inf)
    if lowpass is not None:
        lag[0] = -math.expm1(-h * 2.0 * math.pi * lowpass)
    if time_constant is not None:
        leak[0] = math.exp(-h / time_constant)
    for part, most in zip((slice(0, 3), slice(3, 6)), ranges, strict=True):
        limit[part] = np.inf if most is None else most
    for kind, p in effects:
        match kind:
            case "sensor.delay":
                delay += p["delay"]
            case "sensor.jitter":
                jitter = math.hypot(jitter, p["sigma"])
            case "sensor.gain":
                calibration[WRENCH_AXES.index(p["axis"])] *= p["factor"]
            case "sensor.crosstalk":
                calibration[WRENCH_AXES.index(p["axis"])] += p["ratio"] * calibration[WRENCH_AXES.index(p["source"])]
            case "sensor.lag":
                lag.append(-math.expm1(-h / p["time_constant"]))
            case "sensor.highpass":
                leak.append(math.exp(-h / p["time_constant"]))
            case "sensor.bias":
                offset += np.concatenate([p["force"], p["torque"]])
            case "sensor.drift":
                ramp[AXES.index(p["axis"])] += p["rate"]
            case "sensor.hum":
                on = np.ones(3) if p["axis"] == "all" else np.eye(3)[AXES.index(p["axis"])]
                tone.append((*(p["amplitude"] * on), p["frequency"], p["phase"]))
            case "sensor.deadzone":
                deadzone[:3] = np.maximum(deadzone[:3], p["width"])
            case "sensor.saturation":
                limit[:3] = np.minimum(limit[:3], p["limit"])
    step = np.repeat(np.asarray(quantisation, dtype=float), 3)
    return SensorChain(
        np.array(float(delay)), np.array(float(jitter)), calibration, np.array(lag), np.array(leak), offset, ramp, np.array(tone),
        deadzone, limit, step,
    )  # fmt: skip


def stack(chains: Sequence[SensorChain]) -> SensorChain:
    """One chain with the run as leading axis; shorter lists of filters and tones are filled with those that pass."""

    def filled(key: str, neutral: Array) -> Array:
        rows = [getattr(c, key) for c in chains]
        longest = max(len(r) for r in rows)
        return np.array([np.concatenate([r, np.repeat(neutral, longest - len(r), axis=0)]) for r in rows])

    neutral = {"lag": np.ones(1), "leak": -np.ones(1), "tone": np.array([[0.0, 0.0, 0.0, 1.0, 0.0]])}
    return SensorChain(**{k: filled(k, neutral[k]) if k in neutral else np.array([getattr(c, k) for c in chains]) for k in _KEYS})


@njit(cache=True)
def condition(w, t, noise, calibration, lag, leak, offset, drift, tone, deadzone, limit, step, low, high, before, out):
    """One sample through the sensor, after the delay.

    Args:
        w: (6,) the delayed wrench. t: [s]. noise: (6,) added before the conversion.
        calibration ... step: see SensorChain.
        low: (S, 6), high: (S, 6), before: (S, 6): states of the filters, changed in place; zero at the start.
        out: (6,) the reading.
    """
    for j in range(6):
        y = 0.0
        for i in range(6):
            if calibration[j, i] != 0.0:
                y += calibration[j, i] * w[i]
        for s in range(lag.shape[0]):
            if lag[s] < 1.0:
                low[s, j] += (y - low[s, j]) * lag[s]
                y = low[s, j]
        for s in range(leak.shape[0]):
            if leak[s] >= 0.0:
                high[s, j] = leak[s] * (high[s, j] + y - before[s, j])
                before[s, j] = y
                y = high[s, j]
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
