"""Moderate sizes of the vocabulary's effects, for a given facility.

`SIZES[kind](rng, facility, scale)` returns parameters; `scale` multiplies the deviation from the
nominal rig: below 1 it is harder to find. Times scale with the contact's period, forces with its
peak, lengths with its depth.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from numpy.random import Generator

from tests.equipment.independent_rig.facility import Facility, rounded, sign

Draw = Callable[[Generator, Facility, float], dict]

NEEDS: dict[str, frozenset[str]] = {
    "contact.surface_friction": frozenset({"slide"}),
    "contact.backlash": frozenset({"latched"}),
    "dynamics.inertia": frozenset({"offset"}),
    "dynamics.port_offset": frozenset({"offset"}),
}  # what a facility's runs must excite to make the effect observable

ALIKE: tuple[frozenset[str], ...] = (
    frozenset({"sensor.delay", "sensor.lag", "log.skew", "sensor.jitter"}),
    frozenset({"platform.delay", "platform.lag", "platform.mode"}),
    frozenset({"platform.backlash", "platform.friction"}),
    frozenset(
        {"dynamics.mass", "dynamics.appendage", "dynamics.step_delay", "dynamics.integrator"}
    ),
    frozenset({"dynamics.inertia", "dynamics.port_offset"}),
    frozenset(
        {
            "sensor.gain",
            "contact.stiffness",
            "frame.compliance",
            "frame.mode",
            "contact.power_law",
            "contact.relaxation",
        }
    ),
    frozenset(
        {
            "contact.damping",
            "contact.hunt_crossley",
            "contact.dry_friction",
            "contact.relaxation",
            "frame.compliance",
            "frame.mode",
        }
    ),
    frozenset(
        {"contact.preload", "contact.touch_offset", "contact.dry_friction", "contact.power_law"}
    ),
    frozenset({"contact.hard_stop", "contact.power_law", "sensor.saturation"}),
    frozenset({"sensor.crosstalk", "contact.misalignment"}),
    frozenset({"sensor.deadzone", "loop.deadzone", "contact.adhesion"}),
    frozenset({"sensor.drift", "sensor.bias", "sensor.highpass", "sensor.hum"}),
)  # effects of one group are not hidden together: they mask each other


def alike(a: str, b: str) -> bool:
    """Whether two effects are too similar to be hidden together."""
    return a == b or any(a in group and b in group for group in ALIKE)


def _lateness(rng: Generator, f: Facility, s: float, low: float = 0.04, high: float = 0.1) -> float:
    """A time [s] that is a small phase of the contact's oscillation, but not too short to be
    observable in the loop.
    """
    time = rng.uniform(low, high) / (2.0 * math.pi * f.frequency)
    return rounded(s * min(max(time, 1.2e-3), 7e-3))


def _jitter(rng: Generator, f: Facility, s: float) -> dict:
    time = rng.uniform(0.01, 0.03) / (2.0 * math.pi * f.frequency)
    return {"sigma": rounded(s * min(time, f.scenario["sensor"]["delay"] / 3.0))}


def factor(rng: Generator, s: float, low: float, high: float) -> float:
    """A factor that departs from 1 either way."""
    return rounded(1.0 + s * sign(rng) * rng.uniform(low, high))


def _damping(rng: Generator, f: Facility, s: float) -> dict:
    departure = rng.uniform(0.6, 1.5) if rng.random() < 0.5 else -rng.uniform(0.4, 0.7)
    return {"factor": rounded(max(1.0 + s * departure, 0.0))}


def _mode(rng: Generator, f: Facility, s: float) -> dict:
    ratio = rng.uniform(4.0, 8.0) / math.sqrt(min(s, 4.0))
    return {
        "frequency": rounded(ratio * f.frequency),
        "damping_ratio": rounded(max(rng.uniform(0.02, 0.1), 2.0 / ratio**2)),
    }


def _frame_mode(rng: Generator, f: Facility, s: float) -> dict:
    static = rng.uniform(3.0, 10.0) * f.stiffness / s
    frequency = f.frequency * rng.uniform(2.0, 5.0)
    mass = static / (2.0 * math.pi * frequency) ** 2
    return {
        "frequency": rounded(frequency),
        "damping_ratio": rounded(rng.uniform(0.02, 0.1)),
        "mass": rounded(mass),
    }


def _power_law(rng: Generator, f: Facility, s: float) -> dict:
    exponent = rounded(1.0 + s * rng.uniform(0.15, 0.5), 3)
    return {
        "exponent": exponent,
        "stiffness": rounded(f.stiffness * f.depth ** (1.0 - exponent) * rng.uniform(0.8, 1.2)),
    }


def _bias(rng: Generator, f: Facility, s: float) -> dict:
    size = s * max(6.0 * f.noise, 0.008 * f.peak)
    force = [rounded(size * sign(rng) * rng.uniform(0.7, 1.5), 3) for _ in range(3)]
    torque = [rounded(s * f.torque_noise * sign(rng) * rng.uniform(5.0, 15.0), 3) for _ in range(3)]
    return {"force": force, "torque": torque}


def _misalignment(rng: Generator, f: Facility, s: float) -> dict:
    return {"angles_deg": [rounded(s * sign(rng) * rng.uniform(0.7, 3.0), 3) for _ in range(2)]}


def _crosstalk(rng: Generator, f: Facility, s: float) -> dict:
    return {
        "ratio": rounded(s * sign(rng) * rng.uniform(0.02, 0.06)),
        "source": "z",
        "axis": str(rng.choice(["x", "y"])),
    }


def _port_offset(rng: Generator, f: Facility, s: float) -> dict:
    side = [rounded(s * sign(rng) * rng.uniform(0.03, 0.12), 3) for _ in range(2)]
    return {"offset": [*side, 0.0], "body": either_body(rng)}


def _appendage(rng: Generator, f: Facility, s: float) -> dict:
    return {
        "mass_ratio": rounded(min(s * rng.uniform(0.08, 0.25), 0.5)),
        "frequency": rounded(f.frequency * rng.uniform(0.4, 1.8)),
        "damping_ratio": rounded(rng.uniform(0.01, 0.06)),
        "body": "chaser",
    }


def either_body(rng: Generator) -> str:
    """One of the two bodies."""
    return str(rng.choice(["chaser", "target"]))


def _scale(rng: Generator, f: Facility, s: float) -> dict:
    axis = str(rng.choice(["x", "z"], p=[0.25, 0.75])) if "slide" in f.design else "z"
    return {"factor": factor(rng, s, 0.02, 0.07), "axis": axis}


def _hum(rng: Generator, f: Facility, s: float) -> dict:
    return {
        "frequency": rounded(rng.choice([50.0, 60.0, 100.0, rng.uniform(15.0, 150.0)])),
        "amplitude": rounded(s * f.noise * rng.uniform(5.0, 12.0)),
        "phase": rounded(rng.uniform(-math.pi, math.pi)),
        "axis": "z",
    }


def _drift(rng: Generator, f: Facility, s: float) -> dict:
    rate = s * sign(rng) * rng.uniform(20.0, 60.0) * f.noise / f.scenario["duration"]
    return {"rate": rounded(rate), "axis": str(rng.choice(["x", "y", "z"], p=[0.2, 0.2, 0.6]))}


SIZES: dict[str, Draw] = {
    "sensor.delay": lambda rng, f, s: {"delay": _lateness(rng, f, s)},
    "sensor.lag": lambda rng, f, s: {"time_constant": _lateness(rng, f, s)},
    "sensor.highpass": lambda rng, f, s: {
        "time_constant": rounded(f.contact_time * rng.uniform(1.5, 5.0) / s)
    },
    "sensor.drift": _drift,
    "sensor.bias": _bias,
    "sensor.gain": lambda rng, f, s: {"factor": factor(rng, s, 0.05, 0.15), "axis": "z"},
    "sensor.crosstalk": _crosstalk,
    "sensor.deadzone": lambda rng, f, s: {
        "width": rounded(s * max(rng.uniform(0.02, 0.06) * f.peak, 6.0 * f.noise))
    },
    "sensor.saturation": lambda rng, f, s: {
        "limit": rounded(f.top_peak * (1.0 - min(s * rng.uniform(0.2, 0.4), 0.9)))
    },
    "sensor.hum": _hum,
    "sensor.jitter": _jitter,
    "contact.stiffness": lambda rng, f, s: {"factor": factor(rng, s, 0.08, 0.3)},
    "contact.damping": _damping,
    "contact.power_law": _power_law,
    "contact.hunt_crossley": lambda rng, f, s: {
        "alpha": rounded(s * rng.uniform(0.1, 0.4) / f.middle_speed)
    },
    "contact.dry_friction": lambda rng, f, s: {
        "force": rounded(s * rng.uniform(0.025, 0.08) * f.peak)
    },
    "contact.preload": lambda rng, f, s: {"force": rounded(s * rng.uniform(0.04, 0.12) * f.peak)},
    "contact.hard_stop": lambda rng, f, s: {
        "position": rounded(f.depth * rng.uniform(0.5, 0.9)),
        "stiffness": rounded(s * rng.uniform(0.5, 2.0) * f.stiffness),
    },
    "contact.relaxation": lambda rng, f, s: {
        "stiffness": rounded(s * rng.uniform(0.15, 0.4) * f.stiffness),
        "time_constant": rounded(f.contact_time * rng.uniform(0.15, 0.6)),
    },
    "contact.adhesion": lambda rng, f, s: {
        "force": rounded(s * rng.uniform(0.25, 0.5) * f.damping * f.top_speed)
    },
    "contact.surface_friction": lambda rng, f, s: {
        "coefficient": rounded(
            f.scenario["mechanism"]["contact"]["friction"] + s * rng.uniform(0.06, 0.25)
        )
    },
    "contact.touch_offset": lambda rng, f, s: {
        "offset": rounded(s * sign(rng) * rng.uniform(0.07, 0.2) * f.depth)
    },
    "contact.backlash": lambda rng, f, s: {"width": rounded(s * rng.uniform(0.1, 0.3) * f.depth)},
    "contact.misalignment": _misalignment,
    "frame.compliance": lambda rng, f, s: {
        "stiffness": rounded(rng.uniform(3.0, 12.0) * f.stiffness / s)
    },
    "frame.mode": _frame_mode,
    "platform.delay": lambda rng, f, s: {"delay": _lateness(rng, f, s)},
    "platform.lag": lambda rng, f, s: {
        "bandwidth": rounded(1.4 / (2.0 * math.pi * _lateness(rng, f, s, 0.05, 0.13)))
    },
    "platform.backlash": lambda rng, f, s: {
        "width": rounded(s * max(rng.uniform(0.04, 0.12) * f.depth, 4e-5))
    },
    "platform.friction": lambda rng, f, s: {
        "stick": rounded(s * max(rng.uniform(0.03, 0.08) * f.depth, 4e-5))
    },
    "platform.mode": _mode,
    "platform.scale": _scale,
    "platform.speed_limit": lambda rng, f, s: {
        "speed": rounded(f.top_speed * (1.0 - min(s * rng.uniform(0.04, 0.15), 0.9)))
    },
    "dynamics.mass": lambda rng, f, s: {
        "factor": factor(rng, s, 0.08, 0.25),
        "body": either_body(rng),
    },
    "dynamics.inertia": lambda rng, f, s: {
        "factor": factor(rng, s, 0.2, 0.5),
        "body": either_body(rng),
    },
    "dynamics.port_offset": _port_offset,
    "dynamics.appendage": _appendage,
    "dynamics.step_delay": lambda rng, f, s: {
        "ticks": max(1, round(_lateness(rng, f, s) / f.tick))
    },
    "dynamics.integrator": lambda rng, f, s: {"scheme": "explicit_euler"},
    "loop.deadzone": lambda rng, f, s: {
        "width": rounded(s * max(rng.uniform(0.02, 0.06) * f.peak, 6.0 * f.noise))
    },
    "log.skew": lambda rng, f, s: {"delay": _lateness(rng, f, s)},
}
