"""Pairs of effects that look alike: with sizes at which both change most records in the same way.

`LOOK_ALIKES[(a, b)](rng, facility, scale)` returns the parameters of both; with one hidden, a
diagnosis may name the other.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from numpy.random import Generator

from tests.equipment.independent_rig.facility import Facility, rounded, sign
from tests.equipment.independent_rig.sizes import SIZES, drawn, lateness

Pair = tuple[str, str]
Both = Callable[[Generator, Facility, float], tuple[dict, dict]]
SEEN = 1e3  # the smallest factor is 1/SEEN
_time = lateness(0.05, 0.1, 6e-3)


def _same(draw: Callable, first: str, second: str) -> Both:
    """One number for both."""

    def both(rng: Generator, f: Facility, s: float) -> tuple[dict, dict]:
        value = draw(rng, f, s)
        return {first: value}, {second: value}

    return both


def _delay_or_damping(rng: Generator, f: Facility, s: float) -> tuple[dict, dict]:
    """A force delayed by t corresponds to the damping c - k t."""
    time = min(_time(rng, f, s), 0.9 * f.damping / f.stiffness)
    factor = rounded(max(1.0 - f.stiffness * time / f.damping, 1.0 / SEEN))
    return {"delay": rounded(time)}, {"factor": factor}


def _like(kind: str, name: str) -> Both:
    """The first effect at its usual size, and its parameter `name` for the second."""

    def both(rng: Generator, f: Facility, s: float) -> tuple[dict, dict]:
        first = drawn(SIZES[kind], rng, f, s)
        return first, {name: first[name]}

    return both


def _lag_or_delay_of_platform(rng: Generator, f: Facility, s: float) -> tuple[dict, dict]:
    """A second-order response with damping ratio 0.7 has a low-frequency delay of 1.4/w."""
    time = _time(rng, f, s)
    return {"bandwidth": rounded(1.4 / (2.0 * math.pi * time))}, {"delay": time}


def _either_mass(rng: Generator, f: Facility, s: float) -> tuple[dict, dict]:
    """Masses of chaser or target that give the same reduced mass."""
    chaser, target = (float(f.scenario["spacecraft"][b]["mass"]) for b in ("chaser", "target"))
    for _ in range(100):
        factor = rounded(1.0 + s * sign(rng) * rng.uniform(0.05, 0.2))
        rest = 1.0 / (factor * chaser) + 1.0 / target - 1.0 / chaser
        if rest > 0.2 / target:
            other = rounded(1.0 / (target * rest))
            return {"factor": factor, "body": "chaser"}, {"factor": other, "body": "target"}
    raise RuntimeError("no mass of the target gives the same reduced mass as that of the chaser")


def _offset_or_preload(rng: Generator, f: Facility, s: float) -> tuple[dict, dict]:
    early = s * rng.uniform(0.05, 0.15) * f.depth
    return {"offset": rounded(-early)}, {"force": rounded(f.stiffness * early)}


def _frame_or_stiffness(rng: Generator, f: Facility, s: float) -> tuple[dict, dict]:
    frame = rounded(rng.uniform(4.0, 12.0) * f.stiffness / s)
    return {"stiffness": frame}, {"factor": rounded(1.0 / (1.0 + f.stiffness / frame))}


def _friction_or_damping(rng: Generator, f: Facility, s: float) -> tuple[dict, dict]:
    """Over a cycle of amplitude X at w, friction dissipates 4 F X and a damper pi c w X^2."""
    force = s * rng.uniform(0.02, 0.06) * f.peak
    added = 4.0 * force / (math.pi * 2.0 * math.pi * f.frequency * f.depth)
    return {"force": rounded(force)}, {"factor": rounded(1.0 + added / f.damping)}


def _play_or_stiction(rng: Generator, f: Facility, s: float) -> tuple[dict, dict]:
    width = rounded(s * max(rng.uniform(0.04, 0.1) * f.depth, 4e-5))
    return {"width": width}, {"stick": rounded(0.5 * width)}


LOOK_ALIKES: dict[Pair, Both] = {
    ("sensor.delay", "contact.damping"): _delay_or_damping,
    ("sensor.gain", "contact.stiffness"): _like("sensor.gain", "factor"),
    ("log.skew", "sensor.delay"): _same(_time, "delay", "delay"),
    ("platform.lag", "platform.delay"): _lag_or_delay_of_platform,
    ("sensor.lag", "sensor.delay"): _same(_time, "time_constant", "delay"),
    ("sensor.delay", "platform.delay"): _same(_time, "delay", "delay"),
    ("dynamics.mass", "dynamics.mass"): _either_mass,
    ("contact.touch_offset", "contact.preload"): _offset_or_preload,
    ("frame.compliance", "contact.stiffness"): _frame_or_stiffness,
    ("dynamics.integrator", "dynamics.step_delay"): lambda rng, f, s: (
        {"scheme": "explicit_euler"},
        {"ticks": 1},
    ),
    ("contact.dry_friction", "contact.damping"): _friction_or_damping,
    ("sensor.deadzone", "loop.deadzone"): _like("sensor.deadzone", "width"),
    ("platform.backlash", "platform.friction"): _play_or_stiction,
}


def draw_look_alike(
    rng: Generator, pair: Pair, facility: Facility, scale: float = 1.0
) -> tuple[dict, dict]:
    """Both effects of a pair, as in a scenario's `effects`, at sizes that look alike."""
    first, second = LOOK_ALIKES[pair](rng, facility, scale)
    return {"kind": pair[0], **first}, {"kind": pair[1], **second}
