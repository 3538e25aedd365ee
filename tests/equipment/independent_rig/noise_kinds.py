"""Kinds of noise in facilities' logs: `NOISE_KINDS[name](log, strength, rng)` gives the log with
the noise.

Kinds with place `sensor` are the force sensor's whole noise, added to a noise-free reading; in a
set they act inside the loop, so that wrench_comp is computed from the noisy wrench_meas. Kinds with
place `log` are changes by the logger to a log that is already noisy. All sensor kinds include white
noise of the facility's sigma, except those that replace it by noise of another spectrum or
distribution.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.random import Generator
from scipy import signal

from tests.equipment.independent_rig.log import STAMP_DIGITS, Log
from tests.equipment.independent_rig.log_errors import log_errors
from tests.equipment.independent_rig.nuisances import shifted

Apply = Callable[[Log, float, Generator], Log]
FILTER_ORDER = 4
# rad: low-frequency delay of a fourth-order Butterworth filter times its cut-off frequency
SLOW_DELAY = 2.6131259
SPIKE = (10.0, 30.0)  # sigma
LONGEST_HOLD = 5  # rows
MAINS = 50.0  # Hz
HARMONICS = (1, 2, 3, 5)


@dataclass(frozen=True)
class NoiseKind:
    """A kind of noise.

    Attributes:
        meaning: of the strength, with its unit. strengths: those used by the benchmark, the weaker
            first.
        place: where it arises. apply: function that returns the log with it.
    """

    meaning: str
    strengths: tuple[float, ...]
    place: Literal["sensor", "log"]
    apply: Apply

    def __call__(self, log: Log, strength: float, rng: Generator) -> Log:
        return self.apply(log, strength, rng)


def _added(log: Log, noise: np.ndarray) -> Log:
    return replace(log, wrench_meas=log.wrench_meas + noise)


def _white_noise(log: Log, rng: Generator) -> np.ndarray:
    return rng.standard_normal((len(log.t), 6)) * log.sigma


def white(log: Log, strength: float, rng: Generator) -> Log:
    """Independent from row to row, with a standard deviation of `strength` sigma."""
    return _added(log, strength * _white_noise(log, rng))


def coloured(log: Log, strength: float, rng: Generator) -> Log:
    """First-order, with the variance of the white noise; `strength` is the correlation of
    neighbouring rows.
    """
    fresh = _white_noise(log, rng)
    noise = signal.lfilter([np.sqrt(1.0 - strength**2)], [1.0, -strength], fresh, axis=0)
    start = _white_noise(log, rng)[:1]  # initial state of the stationary process
    return _added(log, noise + start * strength ** np.arange(1, len(log.t) + 1)[:, None])


def pink(log: Log, strength: float, rng: Generator) -> Log:
    """Power density proportional to 1/f up to half the rate, rms `strength` sigma, zero mean."""
    n = len(log.t)
    spectrum = np.fft.rfft(rng.standard_normal((n, 6)), axis=0)
    spectrum[0] = 0.0
    spectrum[1:] /= np.sqrt(np.arange(1, len(spectrum)))[:, None]
    noise = np.fft.irfft(spectrum, n, axis=0)
    return _added(log, noise / np.std(noise, axis=0) * strength * log.sigma)


def anti_aliasing(log: Log, strength: float, rng: Generator) -> Log:
    """A Butterworth low-pass at `strength` Hz; the logger corrects the stamps for its delay."""
    rate = 1.0 / log.tick
    if strength >= 0.5 * rate:
        return log
    sections = signal.butter(FILTER_ORDER, strength, fs=rate, output="sos")
    filtered = np.asarray(signal.sosfilt(sections, log.wrench_meas, axis=0))
    rows = SLOW_DELAY / (2.0 * np.tan(np.pi * strength / rate))  # delay of slow changes
    return replace(log, wrench_meas=shifted(filtered, -rows))


def student_t(log: Log, strength: float, rng: Generator) -> Log:
    """Student's t with `strength` degrees of freedom, with the variance of the white noise."""
    noise = rng.standard_t(strength, (len(log.t), 6)) * np.sqrt((strength - 2.0) / strength)
    return _added(log, noise * log.sigma)


def proportional(log: Log, strength: float, rng: Generator) -> Log:
    """White, plus noise on each axis of `strength` times its reading."""
    share = strength * np.abs(log.wrench_meas) * rng.standard_normal((len(log.t), 6))
    return _added(log, share + _white_noise(log, rng))


def spikes(log: Log, strength: float, rng: Generator) -> Log:
    """White, plus spikes of 10 to 30 sigma on a fraction `strength` of an axis's rows."""
    shape = (len(log.t), 6)
    size = (
        rng.uniform(*SPIKE, shape) * rng.choice([-1.0, 1.0], shape) * (rng.random(shape) < strength)
    )
    return _added(log, size * log.sigma + _white_noise(log, rng))


def converter_steps(log: Log, strength: float, rng: Generator) -> Log:
    """White, then quantisation of the forces in steps of `strength` N."""
    noisy = log.wrench_meas + _white_noise(log, rng)
    noisy[:, :3] = strength * np.floor(noisy[:, :3] / strength + 0.5)
    return replace(log, wrench_meas=noisy)


def tare(log: Log, strength: float, rng: Generator) -> Log:
    """White, plus a random offset of each axis that differs from run to run, `strength` sigma."""
    return _added(log, rng.standard_normal(6) * strength * log.sigma + _white_noise(log, rng))


def slow_drift(log: Log, strength: float, rng: Generator) -> Log:
    """White, plus a drift of up to `strength` sigma with a period longer than the run."""
    length = max(log.t[-1] - log.t[0], log.tick)
    turns, phase = rng.uniform(0.25, 0.75, 6), rng.uniform(-np.pi, np.pi, 6)
    sway = np.sin(2.0 * np.pi * turns * ((log.t - log.t[0]) / length)[:, None] + phase) - np.sin(
        phase
    )
    return _added(log, 0.5 * strength * sway * log.sigma + _white_noise(log, rng))


def mains(log: Log, strength: float, rng: Generator) -> Log:
    """White, plus 50 Hz with three harmonics, the n-th of amplitude `strength`/n sigma."""
    lines = np.zeros((len(log.t), 6))
    for n in HARMONICS:
        phase = rng.uniform(-np.pi, np.pi, 6)
        lines += strength / n * np.sin(2.0 * np.pi * n * MAINS * log.t[:, None] + phase)
    return _added(log, lines * log.sigma + _white_noise(log, rng))


def held_rows(log: Log, strength: float, rng: Generator) -> Log:
    """The force is held for one to five rows, so that a fraction `strength` of them repeats."""
    n = len(log.t)
    mean = 0.5 * (1 + LONGEST_HOLD)
    source = np.arange(n)
    for k in np.flatnonzero(rng.random(n) < strength / mean):
        source[k + 1 : k + 1 + int(rng.integers(1, LONGEST_HOLD + 1))] = source[k]
    return replace(log, wrench_meas=log.wrench_meas[source])


def pose_steps(log: Log, strength: float, rng: Generator) -> Log:
    """Quantisation of the measured position in steps of `strength` m."""
    pose = log.pose_act.copy()
    pose[:, :3] = strength * np.round(pose[:, :3] / strength)
    return replace(log, pose_act=pose)


def digits(log: Log, strength: float, rng: Generator) -> Log:
    """A text file with `strength` significant digits; stamps have enough to increase."""
    count = int(strength)
    found = {name: _rounded(rows, count) for name, rows in log.channels().items()}
    return replace(log, t=_rounded(log.t, max(count, STAMP_DIGITS)), digits=count, **found)


def _rounded(values: np.ndarray, count: int) -> np.ndarray:
    return np.array([float(f"{v:.{count}g}") for v in values.ravel()]).reshape(values.shape)


def lost_rows(log: Log, strength: float, rng: Generator) -> Log:
    """A fraction `strength` of the rows is missing, never the first and the last."""
    kept = rng.random(len(log.t)) >= strength
    kept[0] = kept[-1] = True
    return replace(log.each(lambda rows: rows[kept]), t=log.t[kept])


def stamp_jitter(log: Log, strength: float, rng: Generator) -> Log:
    """Stamps with errors of `strength` rows, 1 sigma, without changing their order."""
    off = np.clip(strength * rng.standard_normal(len(log.t)), -0.45, 0.45)
    return replace(log, t=log.t + off * log.tick)


def clock(log: Log, strength: float, rng: Generator) -> Log:
    """The logger's clock is fast by the fraction `strength`, in all runs."""
    return replace(log, t=log.t * (1.0 + strength))


def log_rate(log: Log, strength: float, rng: Generator) -> Log:
    """Logged at `strength` Hz, interpolated linearly between the loop's rows."""
    t = np.arange(int(np.floor(log.t[-1] * strength)) + 1) / strength

    def resample(rows: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(t, log.t, rows[:, j]) for j in range(rows.shape[1])], axis=1)

    return replace(log.each(resample), t=t)


NOISE_KINDS: dict[str, NoiseKind] = {
    "white": NoiseKind("rms in sigma", (1.0, 2.0), "sensor", white),
    "coloured": NoiseKind("correlation of neighbouring rows", (0.1, 0.6), "sensor", coloured),
    "pink": NoiseKind("rms in sigma", (1.0, 3.0), "sensor", pink),
    "student_t": NoiseKind("degrees of freedom", (6.0, 3.0), "sensor", student_t),
    "proportional": NoiseKind("fraction of the reading", (0.002, 0.01), "sensor", proportional),
    "spikes": NoiseKind("fraction of the rows", (0.002, 0.01), "sensor", spikes),
    "converter_steps": NoiseKind("N", (1.0, 2.0), "sensor", converter_steps),
    "tare": NoiseKind("rms from run to run in sigma", (1.0, 4.0), "sensor", tare),
    "slow_drift": NoiseKind("in sigma", (1.0, 4.0), "sensor", slow_drift),
    "mains": NoiseKind("amplitude at 50 Hz in sigma", (0.5, 2.0), "sensor", mains),
    "anti_aliasing": NoiseKind("Hz", (150.0, 50.0), "log", anti_aliasing),
    "held_rows": NoiseKind("fraction of the rows", (0.01, 0.05), "log", held_rows),
    "pose_steps": NoiseKind("m", (1e-5, 2e-5), "log", pose_steps),
    "digits": NoiseKind("significant digits", (5.0, 4.0), "log", digits),
    "lost_rows": NoiseKind("fraction of the rows", (0.01, 0.05), "log", lost_rows),
    "stamp_jitter": NoiseKind("fraction of a row, 1 sigma", (0.05, 0.1), "log", stamp_jitter),
    "clock": NoiseKind("fraction", (2e-4, 5e-4), "log", clock),
    "log_rate": NoiseKind("Hz", (1700.0, 500.0, 250.0), "log", log_rate),
} | {
    name: NoiseKind("m, N, sigma of the wrench or fraction", sizes, "log", apply)
    for name, (sizes, apply) in log_errors().items()
}
