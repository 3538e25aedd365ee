"""Errors that the electronics add to the reading, independent of the force."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from hiltestbed.config.validation import Vector3
from hiltestbed.effects.base import Effect, quantity
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.sensor.parameters import SensorParameters

AXES = ("x", "y", "z")
DRIFTS = 3.0  # largest drift over a run that is searched, in peak forces
NEAR = 3.0  # [Hz] to either side of a spectral line, within which a tone is fitted


@register
class SensorBias(Effect):
    """A constant offset on the wrench."""

    kind: Literal["sensor.bias"] = "sensor.bias"
    force: Vector3 = quantity(
        "N", "Offset of the force, x, y, z", default=(0.0, 0.0, 0.0), search=(-50.0, 50.0)
    )
    torque: Vector3 = quantity(
        "N m", "Offset of the torque, x, y, z", default=(0.0, 0.0, 0.0), search=(-20.0, 20.0)
    )
    link = "sensor"
    equation = "w += (force, torque)"
    reference = "tare error"
    resembles = ("sensor.drift",)
    repeats = True
    leading = "force"

    def apply(self, p: SensorParameters) -> None:
        p.offset += np.concatenate([self.force, self.torque])

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        most = max(50.0, 0.3 * scales.force)
        names = {f"{part}.{j}": [0.0] for part in ("force", "torque") for j in range(3)}
        yield candidate(cls, names, bounds={f"force.{j}": (-most, most) for j in range(3)})


@register
class SensorDrift(Effect):
    """One force axis drifts linearly from the start of the run."""

    kind: Literal["sensor.drift"] = "sensor.drift"
    rate: float = quantity("N/s", "Rate of the drift", search=(-20.0, 20.0))
    axis: Literal["x", "y", "z"] = Field(default="z", description="Force axis that drifts")
    link = "sensor"
    equation = "f_axis += rate t"
    reference = "charge-amplifier leakage current"
    resembles = ("sensor.bias", "sensor.highpass")
    repeats = True
    leading = "rate"

    def apply(self, p: SensorParameters) -> None:
        p.drift[AXES.index(self.axis)] += self.rate

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        fastest = DRIFTS * scales.force / scales.duration
        return (
            candidate(
                cls, {"rate": [0.0]}, choices=3, bounds={"rate": (-fastest, fastest)}, axis=axis
            )
            for axis in AXES
        )


@register
class SensorHum(Effect):
    """A sinusoidal tone on the force reading, in contact and out of it."""

    kind: Literal["sensor.hum"] = "sensor.hum"
    frequency: float = quantity(
        "Hz", "Frequency of the tone", gt=0.0, search=(1.0, 400.0), ratio=True
    )
    amplitude: float = quantity("N", "Amplitude of the tone", ge=0.0, search=(0.0, 20.0))
    phase: float = quantity(
        "rad", "Phase of the tone at t = 0", default=0.0, search=(-math.pi, math.pi)
    )
    axis: Literal["x", "y", "z", "all"] = Field(
        default="z", description="Force axis that shows the tone, or all three"
    )
    link = "sensor"
    equation = "f_axis += amplitude sin(2 pi frequency t + phase)"
    reference = "mains pick-up or a structural tone"
    resembles = ("frame.mode",)
    repeats = True
    leading = "amplitude"

    def apply(self, p: SensorParameters) -> None:
        on = [float(self.axis in (axis, "all")) * self.amplitude for axis in AXES]
        p.tone.append((on[0], on[1], on[2], self.frequency, self.phase))

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        return (cls.near(axis, *line) for axis, line in scales.lines.items())

    @classmethod
    def near(cls, axis: str, frequency: float, amplitude: float, phase: float) -> Candidate:
        """The hypothesis of a tone near an observed spectral line: frequency [Hz], amplitude [N],
        phase [rad].
        """
        start = {"frequency": [frequency], "amplitude": [amplitude], "phase": [phase]}
        bounds = {
            "frequency": (max(0.5, frequency - NEAR), frequency + NEAR),
            "phase": (phase - math.pi, phase + math.pi),
            "amplitude": (0.0, 20.0 * amplitude + 1.0),
        }
        return candidate(cls, start, choices=4, bounds=bounds, axis=axis)
