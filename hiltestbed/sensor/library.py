"""The force sensor as a piece of its own: arrays in, arrays out, in any simulation.

Units and frames are the caller's: the sensor treats each of the six columns alike, three forces
[N] and three torques [N m] of one wrench. Order of the chain: :mod:`hiltestbed.sensor.chain`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from hiltestbed.config.validation import nearest
from hiltestbed.effects import EFFECTS, Effect
from hiltestbed.errors import InputError
from hiltestbed.frames import Array
from hiltestbed.scenario import load_scenario, resolved
from hiltestbed.sensor.parameters import SensorParameters
from hiltestbed.sensor.sensor import Sensors
from hiltestbed.sensor.settings import Sensor as Settings

# samples of a segment of the spectrum of noise, at most: 1 s of a sensor at 2 kHz
SEGMENT = 2048


class ForceSensor:
    """One force-torque sensor.

        sensor = ForceSensor(2000.0, {"delay": 0.005, "noise": 0.2}, seed=1)
        reading = sensor(wrench)            # (6,), once a sample
        readings = sensor.record(wrenches)  # (rows, 6), from the start

    Attributes:
        rate: of the readings [Hz]. substeps: instants of the wrench per reading. samples: readings
            since the start.
    """

    def __init__(
        self,
        rate: float,
        settings: Mapping[str, Any] | None = None,
        effects: Sequence[Mapping[str, Any]] = (),
        *,
        substeps: int = 1,
        seed: int = 0,
    ) -> None:
        """``settings``: keys of the section `sensor` of a scenario (delay, lowpass, time_constant,
        noise, torque_noise, drift, quantisation, torque_quantisation, range, torque_range);
        ``effects``: those of the link sensor, as in a scenario (gain, crosstalk, hum, jitter, ...).

        Raises:
            InputError: a rate that is not above 0, an unknown key, a value out of range, or an
                effect of another link.
        """
        if not (np.isfinite(rate) and rate > 0.0 and substeps >= 1):
            raise InputError(
                f"sensor: rate [Hz] must be above 0 and substeps 1 or more (got {rate:g}, "
                f"{substeps})"
            )
        self.rate, self.substeps, self._seed = float(rate), int(substeps), seed
        try:
            nominal = SensorParameters.believed(Settings.model_validate(dict(settings or {})))
            self._parameters = nominal.with_effects(_effect(dict(effect)) for effect in effects)
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(map(str, first["loc"]))
            raise InputError(
                f"sensor: {where}: {first['msg']} (got {first['input']!r}); hiltestbed schema "
                f"sensor lists the keys"
            ) from None
        self.reset()

    @classmethod
    def from_scenario(cls, scenario: str | Path) -> ForceSensor:
        """The sensor of a scenario, file or shipped name: for one fitted to a log, the
        `extended_scenario` that `hiltestbed diagnose` wrote. Raises InputError.
        """
        found = load_scenario(scenario)
        data = resolved(found)
        effects = [
            keys
            for effect, keys in zip(found.effects, data["effects"], strict=True)
            if effect.link == "sensor"
        ]
        return cls(found.rate, data["sensor"], effects, substeps=found.substeps, seed=found.seed)

    def reset(self) -> None:
        """Begin anew: no force before the start, filters at rest, the same noise again."""
        generators = [np.random.default_rng(self._seed)]
        self._sensor = Sensors([self._parameters], 1.0 / self.rate, self.substeps, generators)
        self._wrench = np.zeros((1, self.substeps, 6))
        self.samples = 0

    @property
    def delay(self) -> float:
        """[s] pure delay, without filters."""
        return self._parameters.delay

    def __call__(self, wrench: Array) -> Array:
        """The reading (6,) now, for the wrench (6,) now; with ``substeps``, (substeps, 6) at the
        instants since the last reading, the last of which is now. Raises InputError.
        """
        given = np.asarray(wrench, dtype=float)
        if given.shape not in ((6,), self._wrench.shape[1:]):
            raise InputError(
                f"sensor: the wrench has the shape {given.shape}; allowed are (6,), three forces "
                f"and three torques, and ({self.substeps}, 6)"
            )
        self._wrench[0] = given
        reading = self._sensor.read(self.samples, self._wrench)[0].copy()
        self.samples += 1
        return reading

    def record(self, wrenches: Array) -> Array:
        """(rows, 6) readings of a record that begins now: wrenches (rows, 6), or (rows, substeps,
        6). Raises InputError.
        """
        self.reset()
        return np.array([self(wrench) for wrench in wrenches]).reshape(-1, 6)


def noise_like(record: Array, rows: int, rng: np.random.Generator) -> Array:
    """(rows, columns) Gaussian noise with the spectrum of a ``record`` (samples, columns) taken at
    the same rate without a contact: its colour and tones. Columns are independent of each other.

    White noise is shaped by the square root of the record's power spectral density (Welch's
    method); the mean of the record, its bias, is left out.

    Raises:
        InputError: fewer than 16 samples.
    """
    from scipy.signal import welch

    given = np.atleast_2d(np.asarray(record, dtype=float).T)
    if given.shape[1] < 16:
        raise InputError(
            f"noise_like: too few samples (got {given.shape[1]}); allowed are 16 and more"
        )
    frequency, density = welch(given, nperseg=min(SEGMENT, given.shape[1]), detrend="constant")
    wanted = np.fft.rfftfreq(rows)
    shaped = np.empty((rows, len(given)))
    for j, power in enumerate(density):
        # a one-sided density of 2 a sample^-1 is white noise of variance 1
        gain = np.sqrt(0.5 * np.interp(wanted, frequency, power))
        shaped[:, j] = np.fft.irfft(gain * np.fft.rfft(rng.standard_normal(rows)), rows)
    return shaped


def _effect(keys: dict[str, Any]) -> Effect:
    """The effect of these keys. Raises InputError unless it is one of the sensor."""
    allowed = [kind for kind, cls in EFFECTS.items() if cls.link == "sensor"]
    kind = str(keys.get("kind"))
    if kind not in allowed:
        raise InputError(
            f"sensor: no effect of a sensor has the kind {kind!r}{nearest(kind, allowed)}; "
            f"allowed: {', '.join(allowed)}"
        )
    return EFFECTS[kind].model_validate(keys)
