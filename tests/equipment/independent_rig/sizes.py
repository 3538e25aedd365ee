"""Moderate sizes of the vocabulary's effects, for a given facility.

`drawn(SIZES[kind], rng, facility, scale)` returns parameters; `scale` multiplies the deviation from
the nominal rig: below 1 it is harder to find. Times scale with the contact's period, forces with
its peak, lengths with its depth. A docking is longer, deeper and starts farther away:
`DOCKING_SIZES`; `ACTING[design]` lists the effects that act in one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from numpy.random import Generator

from tests.equipment.independent_rig.facility import Facility, rounded, sign

Number = Callable[[Generator, Facility, float], Any]
Size = Callable[[float, Facility], float]  # of a share, in a facility
Draw = Mapping[str, Any] | Callable[[Generator, Facility, float], dict]
AXES = ("x", "y", "z")
SHORTEST = 1.2e-3  # s, of a delay that is observable in the loop

NEEDS: dict[str, frozenset[str]] = {
    "contact.surface_friction": frozenset({"slide"}),
    "contact.backlash": frozenset({"latched"}),
    "dynamics.inertia": frozenset({"offset"}),
    "dynamics.port_offset": frozenset({"offset"}),
}  # what a facility's runs must excite to make the effect observable

ALIKE = (
    "sensor.delay sensor.lag log.skew sensor.jitter",
    "platform.delay platform.lag platform.mode",
    "platform.backlash platform.friction",
    "dynamics.mass dynamics.appendage dynamics.step_delay dynamics.integrator",
    "dynamics.inertia dynamics.port_offset",
    "sensor.gain contact.stiffness frame.compliance frame.mode contact.power_law "
    "contact.relaxation",
    "contact.damping contact.hunt_crossley contact.dry_friction contact.relaxation "
    "frame.compliance frame.mode",
    "contact.preload contact.touch_offset contact.dry_friction contact.power_law",
    "contact.hard_stop contact.power_law sensor.saturation",
    "sensor.crosstalk contact.misalignment",
    "sensor.deadzone loop.deadzone contact.adhesion",
    "sensor.drift sensor.bias sensor.highpass sensor.hum",
)  # effects of one group are not hidden together: they mask each other


def alike(a: str, b: str) -> bool:
    """Whether two effects are too similar to be hidden together."""
    return a == b or any({a, b} <= set(group.split()) for group in ALIKE)


def drawn(draw: Draw, rng: Generator, f: Facility, s: float) -> dict:
    """The parameters of an effect: numbers, drawn in their order, and constants."""
    if callable(draw):
        return draw(rng, f, s)
    return {k: v(rng, f, s) if callable(v) else v for k, v in draw.items()}


def plain(v: float, f: Facility) -> float:
    """A size that is the same in every facility."""
    return v


def of(name: str) -> Size:
    """A share of a size of the facility."""
    return lambda v, f: v * getattr(f, name)


of_peak, of_depth, of_noise = of("peak"), of("depth"), of("noise")
of_stiffness, of_contact_time = of("stiffness"), of("contact_time")


def scaled(
    low: float,
    high: float,
    size: Size = plain,
    signed: bool = False,
    digits: int = 4,
    least: Callable[[Facility], float] | None = None,
) -> Number:
    """A share between `low` and `high`, times the scale, as a size in the facility, or `least`."""

    def draw(rng: Generator, f: Facility, s: float) -> float:
        way = sign(rng) if signed else 1.0
        if least is not None:
            return rounded(s * max(size(rng.uniform(low, high), f), least(f)))
        return rounded(size(s * way * rng.uniform(low, high), f), digits)

    return draw


def between(low: float, high: float, size: Size = plain) -> Number:
    """The same without the scale."""
    return lambda rng, f, s: rounded(size(rng.uniform(low, high), f))


def inverse(low: float, high: float, size: Size = plain) -> Number:
    """The same divided by the scale."""
    return lambda rng, f, s: rounded(size(rng.uniform(low, high) / s, f))


def below(low: float, high: float, size: Size) -> Number:
    """A size that is reduced by a share times the scale."""
    return lambda rng, f, s: rounded(size(1.0 - min(s * rng.uniform(low, high), 0.9), f))


def factor(low: float, high: float) -> Number:
    """A factor that departs from 1 either way."""
    return scaled(low, high, lambda v, f: 1.0 + v, signed=True)


def lateness(low: float = 0.04, high: float = 0.1, longest: float = 7e-3) -> Number:
    """A time [s] that is a small phase of the contact's oscillation, but observable in the loop."""

    def draw(rng: Generator, f: Facility, s: float) -> float:
        time = rng.uniform(low, high) / (2.0 * math.pi * f.frequency)
        return rounded(s * min(max(time, SHORTEST), longest))

    return draw


def bandwidth(time: Number) -> Number:
    """The bandwidth [Hz] of a lag that is worth the delay `time`: 1.4/w with damping ratio 0.7."""
    return lambda rng, f, s: rounded(1.4 / (2.0 * math.pi * time(rng, f, s)))


def several(*numbers: Number | float) -> Number:
    """A list."""
    return lambda rng, f, s: [n(rng, f, s) if callable(n) else n for n in numbers]


def body(rng: Generator, f: Facility, s: float) -> str:
    """One of the two bodies."""
    return str(rng.choice(["chaser", "target"]))


def _axis(rng: Generator, f: Facility, s: float) -> str:
    return str(rng.choice(AXES))


def _jitter(rng: Generator, f: Facility, s: float) -> dict:
    time = rng.uniform(0.01, 0.03) / (2.0 * math.pi * f.frequency)
    return {"sigma": rounded(s * min(time, f.scenario["sensor"]["delay"] / 3.0))}


def _damping(rng: Generator, f: Facility, s: float) -> dict:
    departure = rng.uniform(0.6, 1.5) if rng.random() < 0.5 else -rng.uniform(0.4, 0.7)
    return {"factor": rounded(max(1.0 + s * departure, 0.0))}


def _mode(rng: Generator, f: Facility, s: float) -> dict:
    ratio = rng.uniform(4.0, 8.0) / math.sqrt(min(s, 4.0))
    damping_ratio = rounded(max(rng.uniform(0.02, 0.1), 2.0 / ratio**2))
    return {"frequency": rounded(ratio * f.frequency), "damping_ratio": damping_ratio}


def _frame_mode(frequency: Number, least_damping: float) -> Draw:
    def draw(rng: Generator, f: Facility, s: float) -> dict:
        static = rng.uniform(3.0, 10.0) * f.stiffness / s
        hertz = frequency(rng, f, s)
        mass = static / (2.0 * math.pi * hertz) ** 2
        damping_ratio = rounded(rng.uniform(least_damping, 0.1))
        return {
            "frequency": rounded(hertz), "damping_ratio": damping_ratio, "mass": rounded(mass)
        }  # fmt: skip

    return draw


def _power_law(rng: Generator, f: Facility, s: float) -> dict:
    exponent = rounded(1.0 + s * rng.uniform(0.15, 0.5), 3)
    stiffness = f.stiffness * f.depth ** (1.0 - exponent) * rng.uniform(0.8, 1.2)
    return {"exponent": exponent, "stiffness": rounded(stiffness)}


def _appendage(share: float, frequency: Number) -> Draw:
    return {
        "mass_ratio": scaled(0.08, share, lambda v, f: min(v, 0.5)),
        "frequency": frequency,
        "damping_ratio": between(0.01, 0.06),
        "body": "chaser",
    }


def _scale(rng: Generator, f: Facility, s: float) -> dict:
    axis = str(rng.choice(["x", "z"], p=[0.25, 0.75])) if "slide" in f.design else "z"
    return {"factor": factor(0.02, 0.07)(rng, f, s), "axis": axis}


def _crosstalk(rng: Generator, f: Facility, s: float) -> dict:
    source, axis = (str(v) for v in rng.choice(AXES, 2, replace=False))
    ratio = scaled(0.03, 0.08, signed=True)(rng, f, s)
    return {"ratio": ratio, "source": source, "axis": axis}


_bias = scaled(0.7, 1.5, lambda v, f: v * max(6.0 * f.noise, 0.008 * f.peak), True, 3)
_bias_torque = scaled(5.0, 15.0, of("torque_noise"), True, 3)
_docking_bias = scaled(6.0, 12.0, of_noise, True, 3)
_docking_bias_torque = scaled(6.0, 12.0, of("torque_noise"), True, 3)
_angle, _docking_angle = scaled(0.7, 3.0, plain, True, 3), scaled(0.3, 1.5, plain, True, 3)
_side, _docking_side = scaled(0.03, 0.12, plain, True, 3), scaled(0.02, 0.06, plain, True, 3)
_deadzone = scaled(0.02, 0.06, of_peak, least=lambda f: 6.0 * f.noise)

SIZES: dict[str, Draw] = {
    "sensor.delay": {"delay": lateness()},
    "sensor.lag": {"time_constant": lateness()},
    "sensor.highpass": {"time_constant": inverse(1.5, 5.0, of_contact_time)},
    "sensor.drift": {
        "rate": scaled(20.0, 60.0, lambda v, f: v * f.noise / f.scenario["duration"], True),
        "axis": lambda rng, f, s: str(rng.choice(AXES, p=[0.2, 0.2, 0.6])),
    },
    "sensor.bias": {"force": several(*[_bias] * 3), "torque": several(*[_bias_torque] * 3)},
    "sensor.gain": {"factor": factor(0.05, 0.15), "axis": "z"},
    "sensor.crosstalk": {
        "ratio": scaled(0.02, 0.06, signed=True),
        "source": "z",
        "axis": lambda rng, f, s: str(rng.choice(["x", "y"])),
    },
    "sensor.deadzone": {"width": _deadzone},
    "sensor.saturation": {"limit": below(0.2, 0.4, of("top_peak"))},
    "sensor.hum": {
        "frequency": lambda rng, f, s: rounded(
            rng.choice([50.0, 60.0, 100.0, rng.uniform(15.0, 150.0)])
        ),
        "amplitude": scaled(5.0, 12.0, of_noise),
        "phase": between(-math.pi, math.pi),
        "axis": "z",
    },
    "sensor.jitter": _jitter,
    "contact.stiffness": {"factor": factor(0.08, 0.3)},
    "contact.damping": _damping,
    "contact.power_law": _power_law,
    "contact.hunt_crossley": {"alpha": scaled(0.1, 0.4, lambda v, f: v / f.middle_speed)},
    "contact.dry_friction": {"force": scaled(0.025, 0.08, of_peak)},
    "contact.preload": {"force": scaled(0.04, 0.12, of_peak)},
    "contact.hard_stop": {
        "position": between(0.5, 0.9, of_depth),
        "stiffness": scaled(0.5, 2.0, of_stiffness),
    },
    "contact.relaxation": {
        "stiffness": scaled(0.15, 0.4, of_stiffness),
        "time_constant": between(0.15, 0.6, of_contact_time),
    },
    "contact.adhesion": {"force": scaled(0.25, 0.5, lambda v, f: v * f.damping * f.top_speed)},
    "contact.surface_friction": {
        "coefficient": scaled(
            0.06, 0.25, lambda v, f: f.scenario["mechanism"]["contact"]["friction"] + v
        )
    },
    "contact.touch_offset": {"offset": scaled(0.07, 0.2, of_depth, True)},
    "contact.backlash": {"width": scaled(0.1, 0.3, of_depth)},
    "contact.misalignment": {"angles_deg": several(_angle, _angle)},
    "frame.compliance": {"stiffness": inverse(3.0, 12.0, of_stiffness)},
    "frame.mode": _frame_mode(lambda rng, f, s: f.frequency * rng.uniform(2.0, 5.0), 0.02),
    "platform.delay": {"delay": lateness()},
    "platform.lag": {"bandwidth": bandwidth(lateness(0.05, 0.13))},
    "platform.backlash": {"width": scaled(0.04, 0.12, of_depth, least=lambda f: 4e-5)},
    "platform.friction": {"stick": scaled(0.03, 0.08, of_depth, least=lambda f: 4e-5)},
    "platform.mode": _mode,
    "platform.scale": _scale,
    "platform.speed_limit": {"speed": below(0.04, 0.15, of("top_speed"))},
    "dynamics.mass": {"factor": factor(0.08, 0.25), "body": body},
    "dynamics.inertia": {"factor": factor(0.2, 0.5), "body": body},
    "dynamics.port_offset": {"offset": several(_side, _side, 0.0), "body": body},
    "dynamics.appendage": _appendage(0.25, between(0.4, 1.8, of("frequency"))),
    "dynamics.step_delay": {
        "ticks": lambda rng, f, s: max(1, round(lateness()(rng, f, s) / f.tick))
    },
    "dynamics.integrator": {"scheme": "explicit_euler"},
    "loop.deadzone": {"width": _deadzone},
    "log.skew": {"delay": lateness()},
}

_late = lateness(0.03, 0.08, 6e-3)  # of the oscillation against a wall
DOCKING_SIZES: dict[str, Draw] = SIZES | {
    "sensor.delay": {"delay": _late},
    "sensor.lag": {"time_constant": _late},
    "sensor.highpass": {"time_constant": inverse(1.0, 4.0, of("span"))},
    "sensor.bias": {
        "force": several(*[_docking_bias] * 3),
        "torque": several(*[_docking_bias_torque] * 3),
    },
    "sensor.gain": {"factor": factor(0.05, 0.15), "axis": _axis},
    "sensor.crosstalk": _crosstalk,
    "sensor.saturation": {"limit": below(0.3, 0.5, of_peak)},
    "sensor.jitter": {"sigma": scaled(0.1, 0.25, lambda v, f: v * f.scenario["sensor"]["delay"])},
    "contact.hunt_crossley": lambda rng, f, s: {
        "alpha": rounded(
            s * rng.uniform(0.5, 1.0) * f.damping / (f.stiffness * f.depth * rng.uniform(0.3, 0.6))
        )
    },
    "contact.relaxation": {
        "stiffness": scaled(0.15, 0.4, of_stiffness),
        "time_constant": between(0.02, 0.15),
    },
    "contact.adhesion": {"force": scaled(0.15, 0.4, of_peak)},
    "contact.touch_offset": {"offset": scaled(0.05, 0.2, of_depth, True)},
    "contact.misalignment": {"angles_deg": several(_docking_angle, _docking_angle)},
    "frame.mode": _frame_mode(lambda rng, f, s: rng.uniform(12.0, 35.0), 0.03),
    "platform.delay": {"delay": _late},
    "platform.lag": {"bandwidth": bandwidth(_late)},
    # A position that sticks changes the contact force by damping times its step over a tick: the
    # step must be small.
    "platform.friction": {"stick": scaled(10.0, 25.0, of("pose_noise"))},
    "platform.mode": {
        "frequency": lambda rng, f, s: rounded(rng.uniform(8.0, 25.0) / math.sqrt(s)),
        "damping_ratio": between(0.03, 0.1),
    },
    "platform.scale": {"factor": factor(0.005, 0.02), "axis": _axis},
    "platform.speed_limit": {"speed": below(0.1, 0.3, of("top_speed"))},
    "dynamics.mass": {"factor": factor(0.05, 0.2), "body": body},
    "dynamics.inertia": {"factor": factor(0.1, 0.3), "body": body},
    "dynamics.port_offset": {"offset": several(_docking_side, _docking_side, 0.0), "body": body},
    "dynamics.appendage": _appendage(0.2, between(0.6, 3.0)),
    "log.skew": {"delay": _late},
}

_NOT_HELD = {
    "contact.surface_friction",
    "contact.adhesion",
    "contact.hard_stop",
    "contact.touch_offset",
    "contact.misalignment",
}
_DOCKING = tuple(name for name in DOCKING_SIZES if name != "contact.backlash")
ACTING: dict[str, tuple[str, ...]] = {
    "docking": _DOCKING,
    "mounted": _DOCKING,
    "held": tuple(name for name in DOCKING_SIZES if name not in _NOT_HELD),
}
