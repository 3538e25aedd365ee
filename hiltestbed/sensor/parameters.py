"""Parameters of a sensor: each element of the signal chain, from the settings and the effects."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiltestbed.config.piecewise import Pairs, packed
from hiltestbed.effects.base import LinkParameters
from hiltestbed.frames import Array
from hiltestbed.sensor.chain import high_pass, low_pass

if TYPE_CHECKING:
    from hiltestbed.sensor.settings import Sensor as SensorSettings


@dataclass
class SensorParameters(LinkParameters):
    """One sensor; an inactive element has a neutral value.

    Attributes:
        delay: nominal plus additional [s]. jitter: standard deviation of the delay [s].
        mounting: (6, 6) from the wrench in P to that in the sensor's axes. gain: (6,) of each.
            cross: (6, 6) of these, from the axis that is felt (column) to the one that shows it.
        curve: of each axis pairs of true value and reading; empty: identity.
        lag, leak: time constant [s] of each low-pass and of each high-pass.
        offset: (6,) [N, N m]. drift: (6,) [N/s, N m/s]. tone: amplitude on x, y, z [N], frequency
            [Hz], phase [rad] of each.
        deadzone, limit: (6,) [N, N m]. step: (6,) quantisation step, 0 for none. noise: (6,)
            standard deviation [N, N m].
    """

    link = "sensor"
    delay: float = 0.0
    jitter: float = 0.0
    mounting: Array = field(default_factory=lambda: np.eye(6))
    gain: Array = field(default_factory=lambda: np.ones(6))
    cross: Array = field(default_factory=lambda: np.eye(6))
    curve: list[Pairs] = field(default_factory=lambda: [()] * 6)
    lag: list[float] = field(default_factory=list)
    leak: list[float] = field(default_factory=list)
    offset: Array = field(default_factory=lambda: np.zeros(6))
    drift: Array = field(default_factory=lambda: np.zeros(6))
    tone: list[tuple[float, float, float, float, float]] = field(default_factory=list)
    deadzone: Array = field(default_factory=lambda: np.zeros(6))
    limit: Array = field(default_factory=lambda: np.full(6, np.inf))
    step: Array = field(default_factory=lambda: np.zeros(6))
    noise: Array = field(default_factory=lambda: np.zeros(6))

    @property
    def calibration(self) -> Array:
        """(6, 6) from the wrench in P to the reading, whatever the order of the effects."""
        return self.cross @ np.diag(self.gain) @ self.mounting

    @classmethod
    def believed(cls, settings: SensorSettings) -> SensorParameters:
        """The nominal sensor: a scenario's settings, without effects."""
        p = cls(settings.delay)
        if settings.lowpass is not None:
            p.lag.append(1.0 / (2.0 * math.pi * settings.lowpass))
        if settings.time_constant is not None:
            p.leak.append(settings.time_constant)
        p.drift[:3] = settings.drift
        p.limit[:3] = np.inf if settings.range is None else settings.range
        p.limit[3:] = np.inf if settings.torque_range is None else settings.torque_range
        p.step[:3], p.step[3:] = settings.quantisation, settings.torque_quantisation
        p.noise[:3], p.noise[3:] = settings.noise, settings.torque_noise
        return p


class Elements(NamedTuple):
    """The elements after the delay of n sensors as arrays; the leading axis is the run."""

    calibration: Array  # (n, 6, 6)
    curve: Array  # (n, 6, 1 + 2K) packed
    lag: Array  # (n, S, 2) weights of the filters per step, see :mod:`hiltestbed.sensor.chain`
    leak: Array  # (n, S, 2)
    offset: Array  # (n, 6) like all that follow, but for the tones
    drift: Array
    tone: Array  # (n, H, 5)
    deadzone: Array
    limit: Array
    step: Array


def stack(sensors: Sequence[SensorParameters], step: float) -> Elements:
    """Stack several sensors, whose filters see the wrench at instants ``step`` [s] apart; shorter
    lists of filters and tones are padded with inactive elements.
    """

    def filled(rows: list[list], neutral: object) -> Array:
        longest = max(1, *(len(r) for r in rows))
        return np.array([[*r, *[neutral] * (longest - len(r))] for r in rows], dtype=float)

    def rows(name: str) -> Array:
        return np.array([getattr(p, name) for p in sensors], dtype=float)

    knots = max(len(curve) for p in sensors for curve in p.curve)
    return Elements(
        calibration=rows("calibration"),
        curve=np.array([[packed(curve, knots) for curve in p.curve] for p in sensors]),
        lag=low_pass(filled([p.lag for p in sensors], 0.0), step),
        leak=high_pass(filled([p.leak for p in sensors], math.inf), step),
        offset=rows("offset"),
        drift=rows("drift"),
        tone=filled([p.tone for p in sensors], (0.0, 0.0, 0.0, 1.0, 0.0)),
        deadzone=rows("deadzone"),
        limit=rows("limit"),
        step=rows("step"),
    )
