"""Effects of the sensor: errors that the electronics add, calibration and its learned curve,
conversion, delay, filters, mounting.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, Strict

from hiltestbed.config.piecewise import Curve
from hiltestbed.config.validation import Vector3
from hiltestbed.effects.base import Effect
from hiltestbed.effects.departure import quantity
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.frames import quat_exp, rotation_matrix
from hiltestbed.plugins import register
from hiltestbed.signals import AXES

if TYPE_CHECKING:
    from hiltestbed.sensor.parameters import SensorParameters


FORCES = AXES[:3]
WrenchAxis = Literal["x", "y", "z", "rx", "ry", "rz"]
DRIFTS = 3.0  # largest drift over a run that is searched, in peak forces
NEAR = 3.0  # [Hz] to either side of a spectral line, within which a tone is fitted


class SensorEffect(Effect):
    """Base of the effects of the sensor."""

    link = "sensor"


@register
class SensorBias(SensorEffect):
    """A constant offset on the wrench."""

    kind: Literal["sensor.bias"] = "sensor.bias"
    force: Vector3 = quantity(
        "N", "Offset of the force, x, y, z", default=(0.0, 0.0, 0.0), search=(-50.0, 50.0)
    )
    torque: Vector3 = quantity(
        "N m", "Offset of the torque, x, y, z", default=(0.0, 0.0, 0.0), search=(-20.0, 20.0)
    )
    equation = "w += (force, torque)"
    reference = "tare error"
    resembles = ("sensor.drift",)
    repeats = True

    def apply(self, p: SensorParameters) -> None:
        p.offset += np.concatenate([self.force, self.torque])

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        most = max(50.0, 0.3 * scales.force)
        names = {f"{part}.{j}": [0.0] for part in ("force", "torque") for j in range(3)}
        yield candidate(cls, names, bounds={f"force.{j}": (-most, most) for j in range(3)})


@register
class SensorDrift(SensorEffect):
    """One force axis drifts linearly from the start of the run."""

    kind: Literal["sensor.drift"] = "sensor.drift"
    rate: float = quantity("N/s", "Rate of the drift", search=(-20.0, 20.0))
    axis: Literal["x", "y", "z"] = Field(default="z", description="Force axis that drifts")
    equation = "f_axis += rate t"
    reference = "charge-amplifier leakage current"
    resembles = ("sensor.bias", "sensor.highpass")
    repeats = True

    def apply(self, p: SensorParameters) -> None:
        p.drift[FORCES.index(self.axis)] += self.rate

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        fastest = DRIFTS * scales.force / scales.duration
        return (
            candidate(
                cls, {"rate": [0.0]}, choices=3, bounds={"rate": (-fastest, fastest)}, axis=axis
            )
            for axis in FORCES
        )


@register
class SensorHum(SensorEffect):
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
    equation = "f_axis += amplitude sin(2 pi frequency t + phase)"
    reference = "mains pick-up or a structural tone"
    resembles = ("frame.mode",)
    repeats = True
    leading = "amplitude"

    def apply(self, p: SensorParameters) -> None:
        on = [float(self.axis in (axis, "all")) * self.amplitude for axis in FORCES]
        p.tone.append((on[0], on[1], on[2], self.frequency, self.phase))

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        """None: a tone is sought at the lines of what a link leaves, see :meth:`near`."""
        return iter(())

    @classmethod
    def near(cls, axis: str, frequency: float, amplitude: float, phase: float) -> Candidate:
        """A tone near an observed line: frequency [Hz], amplitude [N], phase [rad]."""
        start = {"frequency": [frequency], "amplitude": [amplitude], "phase": [phase]}
        bounds = {
            "frequency": (max(0.5, frequency - NEAR), frequency + NEAR),
            "phase": (phase - math.pi, phase + math.pi),
            "amplitude": (0.0, 20.0 * amplitude + 1.0),
        }
        return candidate(cls, start, choices=4, bounds=bounds, axis=axis)


@register
class SensorGain(SensorEffect):
    """The gain of one axis of the wrench is wrong."""

    kind: Literal["sensor.gain"] = "sensor.gain"
    factor: float = quantity(
        "-", "True gain over nominal gain", gt=0.0, search=(0.3, 3.0), ratio=True
    )
    axis: WrenchAxis = Field(default="z", description="Axis of the wrench that is scaled")
    equation = "w_axis *= factor"
    reference = "calibration error"
    resembles = ("contact.stiffness",)
    repeats = True

    def apply(self, p: SensorParameters) -> None:
        p.gain[AXES.index(self.axis)] *= self.factor

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        return (
            candidate(cls, {"factor": [0.9, 1.1]}, choices=2, linear="factor", axis=axis)
            for axis in AXES
        )


@register
class SensorCrosstalk(SensorEffect):
    """A fraction of one axis of the wrench appears on another axis."""

    kind: Literal["sensor.crosstalk"] = "sensor.crosstalk"
    ratio: float = quantity(
        "-",
        "Fraction of the source axis that appears on the other",
        ge=-1.0,
        le=1.0,
        search=(-0.3, 0.3),
    )
    source: WrenchAxis = Field(
        default="z", description="Axis of the wrench that couples into the other"
    )
    axis: WrenchAxis = Field(
        default="x", description="Axis of the wrench on which the crosstalk appears"
    )
    equation = "w_axis += ratio w_source, after the gains"
    reference = "calibration-matrix error"
    resembles = ("contact.misalignment", "contact.surface_friction")
    repeats = True

    def apply(self, p: SensorParameters) -> None:
        p.cross[AXES.index(self.axis), AXES.index(self.source)] += self.ratio

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        pairs = [(a, b) for a in AXES for b in AXES if a != b]
        return (candidate(cls, {"ratio": [0.0]}, choices=6, source=a, axis=b) for a, b in pairs)


@register
class SensorDeadzone(SensorEffect):
    """A dead zone in the sensor: force axes read zero below a threshold."""

    kind: Literal["sensor.deadzone"] = "sensor.deadzone"
    width: float = quantity(
        "N", "Force below which an axis reads zero", gt=0.0, search=(0.2, 60.0), ratio=True
    )
    equation = "f_axis = 0 where |f_axis| < width"
    reference = "dead zone of an analogue-to-digital conversion"
    resembles = ("loop.deadzone",)
    repeats = True
    jumps = "width"

    def apply(self, p: SensorParameters) -> None:
        p.deadzone[:3] = np.maximum(p.deadzone[:3], self.width)

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        widths = list(np.geomspace(scales.noise, 0.5 * scales.force, 16))
        yield candidate(
            cls, {"width": widths}, bounds={"width": (0.5 * scales.noise, 0.7 * scales.force)}
        )


@register
class SensorSaturation(SensorEffect):
    """Force axes clip at the range of the sensor."""

    kind: Literal["sensor.saturation"] = "sensor.saturation"
    limit: float = quantity(
        "N", "Force at which an axis clips", gt=0.0, search=(5.0, 5000.0), ratio=True
    )
    equation = "f_axis = min(max(f_axis, -limit), limit)"
    reference = "range of the sensor or of its amplifier"
    resembles = ("contact.power_law",)
    repeats = True
    vanishes = True
    jumps = "limit"

    def apply(self, p: SensorParameters) -> None:
        p.limit[:3] = np.minimum(p.limit[:3], self.limit)

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        f = scales.force
        limits = [q * f for q in (0.25, 0.4, 0.55, 0.7, 0.8, 0.9, 0.97)] + list(scales.reading)
        yield candidate(cls, {"limit": limits}, bounds={"limit": (0.05 * f, 1.2 * f)})


@register
class SensorDelay(SensorEffect):
    """An additional constant delay of the force reading."""

    kind: Literal["sensor.delay"] = "sensor.delay"
    delay: float = quantity(
        "s", "Delay on top of the nominal one", ge=0.0, le=1.0, search=(0.0, 0.03)
    )
    equation = "w_meas(t) = w(t - delay_nominal - delay)"
    reference = "pure transport delay"
    resembles = ("contact.damping", "log.skew", "sensor.lag")
    repeats = True
    jumps = "delay"

    def apply(self, p: SensorParameters) -> None:
        p.delay += self.delay

    def worth(self, tick: float, frequency: float) -> float:
        return self.delay

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        yield candidate(
            cls, {"delay": scales.delays}, bounds={"delay": (0.0, scales.longest_delay)}
        )


@register
class SensorJitter(SensorEffect):
    """Jitter: the delay of the force reading varies from sample to sample."""

    kind: Literal["sensor.jitter"] = "sensor.jitter"
    sigma: float = quantity(
        "s", "Standard deviation of the delay", ge=0.0, le=0.1, search=(0.0, 0.005)
    )
    equation = "w_meas(t_k) = w(t_k - delay - sigma n_k), n_k standard normal, total delay >= 0"
    reference = "sampling jitter"
    resembles = ("sensor.delay",)
    repeats = True

    def apply(self, p: SensorParameters) -> None:
        p.jitter = math.hypot(p.jitter, self.sigma)

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        """None: jitter is noise proportional to the reading's rate of change; it is found by
        likelihood, not by a change of the mean.
        """
        return iter(())


SLOWEST = 50.0  # ticks: upper bound of a lag's time constant in the search on a slow loop


@register
class SensorLag(SensorEffect):
    """The force reading passes an additional first-order low-pass."""

    kind: Literal["sensor.lag"] = "sensor.lag"
    time_constant: float = quantity(
        "s", "Time constant of the low-pass", gt=0.0, search=(1e-4, 0.05), ratio=True
    )
    equation = "T y' = u - y, the wrench linear between the physics instants"
    reference = "first-order low-pass, 1/(1 + s T)"
    resembles = ("sensor.delay",)
    repeats = True

    def apply(self, p: SensorParameters) -> None:
        p.lag.append(self.time_constant)

    def worth(self, tick: float, frequency: float) -> float:
        return self.time_constant

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        h = scales.tick
        bounds = {"time_constant": (1e-4, max(0.05, SLOWEST * h))}
        yield candidate(
            cls, {"time_constant": [0.3 * h, h, 3.0 * h, 8.0 * h, 25.0 * h]}, bounds=bounds
        )


@register
class SensorHighpass(SensorEffect):
    """Charge leakage, a high-pass: the reading of a steady force decays, and an undershoot follows
    the contact.
    """

    kind: Literal["sensor.highpass"] = "sensor.highpass"
    time_constant: float = quantity(
        "s", "Time constant of the charge leakage", gt=0.0, search=(0.02, 100.0), ratio=True
    )
    equation = "T (y' - u') = -y, the wrench linear between the physics instants"
    reference = "charge amplifier, s T/(1 + s T)"
    resembles = ("contact.relaxation", "sensor.drift")
    repeats = True
    vanishes = True

    def apply(self, p: SensorParameters) -> None:
        p.leak.append(self.time_constant)

    def worth(self, tick: float, frequency: float) -> float:
        # a high-pass leads: phase 1/(w T)
        return -1.0 / (frequency * frequency * self.time_constant)

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        yield candidate(cls, {"time_constant": [0.05, 0.2, 1.0, 5.0, 25.0]})


Reading = Annotated[Curve, Field(min_length=2)]


@register
class SensorMap(SensorEffect):
    """The reading of one axis follows a non-linear calibration curve instead of the nominal
    straight line.
    """

    kind: Literal["sensor.map"] = "sensor.map"
    reading: Reading = quantity(
        "N, N",
        "Knots of the reading over the true force (torque axes: N m); linearly extrapolated "
        "beyond the ends",
    )
    axis: WrenchAxis = Field(
        default="z", description="Axis of the wrench that the curve applies to"
    )
    equation = "w_axis = curve(w_axis), piecewise linear"
    reference = "calibration curve"
    resembles = ("sensor.gain", "sensor.saturation", "contact.power_law")
    repeats = True

    def apply(self, p: SensorParameters) -> None:
        p.curve[AXES.index(self.axis)] = self.reading

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        """None: it is learned where the named effects leave a residual above the noise floor, see
        :mod:`hiltestbed.diagnosis.learned`.
        """
        return iter(())


Angles = Annotated[
    tuple[Annotated[float, Field(ge=-180.0, le=180.0)], ...],
    Strict(False),
    Field(min_length=3, max_length=3),
]
LATERAL = ("angles_deg.0", "angles_deg.1")
ALL = (*LATERAL, "angles_deg.2")


@register
class SensorRotation(SensorEffect):
    """The sensor's frame is rotated against its nominal attitude: force and torque are read along
    other axes.
    """

    kind: Literal["sensor.rotation"] = "sensor.rotation"
    angles_deg: Angles = quantity(
        "deg",
        "Rotation vector of the sensor's true frame in the nominal frame, x, y, z",
        search=(-10.0, 10.0),
    )
    equation = "f = R^T f and tau = R^T tau, R = exp([angles]_x), before gain and crosstalk"
    reference = "mounting error"
    resembles = ("sensor.crosstalk", "contact.misalignment", "contact.surface_friction")
    repeats = True

    def apply(self, p: SensorParameters) -> None:
        quaternion = np.empty(4)
        quat_exp(np.radians(np.array(self.angles_deg, dtype=float)), quaternion)
        p.mounting = p.mounting @ np.kron(np.eye(2), rotation_matrix(quaternion).T)

    @classmethod
    def hypothesis(cls, variant: Mapping[str, Any], **values: Any) -> Self:
        """Angles that are not searched are zero."""
        return super().hypothesis(variant, angles_deg=(*values["angles_deg"], 0.0, 0.0, 0.0)[:3])

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        """About the lateral axes, and about all three: a rotation about z shows only in lateral
        loads and must justify its parameter.
        """
        return (candidate(cls, {name: [0.0] for name in names}) for names in (LATERAL, ALL))
