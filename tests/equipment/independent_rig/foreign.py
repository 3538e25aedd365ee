"""Foreign effects: deviations outside the vocabulary, each with its link of the loop.

Sizes are relative to the facility's contact, so that all are well above the noise. `FOREIGN` and
`FURTHER` are for any design in which they act, `IN_DOCKING` has other sizes for dockings. An effect
that changes from run to run gets the run's number as `run` in its parameters.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from tests.equipment.independent_rig.facility import Facility, sign
from tests.equipment.independent_rig.hidden import compensator, contact, platform
from tests.equipment.independent_rig.links import Rig

KNOTS = 6
LINE = 23.0  # Hz
COMPENSATION, DYNAMICS = "compensation", "dynamics"
BUMPER, CONES, HELD = "bumper", ("docking", "mounted"), "held"

Apply = Callable[[Rig, dict], Rig]
Draw = Callable[[Generator, Facility, float], dict]
Scaled = Callable[[float, Facility], float]


class Foreign(NamedTuple):
    """A foreign effect: its link, its application to a rig, and parameters of moderate size for a
    facility (times `scale`).
    """

    link: str
    apply: Apply
    draw: Draw


def drawn(name: str, low: float, high: float, scaled: Scaled, signed: bool = False) -> Draw:
    """One parameter: a share between `low` and `high`, of either sign if `signed`, times the scale,
    as `scaled` makes it a size in a facility.
    """

    def draw(rng: Generator, f: Facility, s: float) -> dict:
        way = sign(rng) if signed else 1.0
        return {name: scaled(s * way * rng.uniform(low, high), f)}

    return draw


def sets(part: str, field: str, name: str) -> Apply:
    """Set one field of a part of the rig to the parameter `name`."""
    return lambda rig, e: rig._replace(**{part: getattr(rig, part)._replace(**{field: e[name]})})


def one(
    part: str,
    field: str,
    draw: tuple[str, float, float, Scaled],
    link: str = "",
    signed: bool = False,
) -> Foreign:
    """An effect with one parameter, which is a field of a part of the rig; ``link``: where it is
    named differently.
    """
    return Foreign(link or part, sets(part, field, draw[0]), drawn(*draw, signed=signed))


def _plain(v: float, f: Facility) -> float:
    return v


def _of_peak(v: float, f: Facility) -> float:
    return v * f.peak


def _of_depth(v: float, f: Facility) -> float:
    return v * f.depth


def _in_contact(v: float, f: Facility) -> float:
    return v / f.contact_time


def _curve(rng: Generator, f: Facility, s: float) -> dict:
    """A force-penetration curve of any shape: factors of the spring at evenly spaced depths, each
    within 25 % of 1.
    """
    factors = 1.0 + s * rng.uniform(-0.25, 0.25, KNOTS)
    return {"factors": [round(float(v), 4) for v in factors], "depth": 1.5 * f.depth}


def _oval(rig: Rig, e: dict) -> Rig:
    if rig.docking is None:
        return rig
    return rig._replace(
        docking=rig.docking._replace(surfaces=rig.docking.surfaces._replace(oval=e["ratio"]))
    )


def _depth_range(f: Facility) -> float:
    """Range of the contact along the insertion [m]."""
    return max(f.side, f.depth) if "six axes" in f.design else f.depth


FOREIGN: dict[str, Foreign] = {
    "unknown.unloading": one("contact", "unloading", ("loss", 0.08, 0.2, _plain)),
    "unknown.ageing": one("contact", "ageing", ("rate", 0.2, 0.4, _in_contact), signed=True),
    "unknown.speeding": one(
        "contact", "speeding", ("slope", 0.25, 0.6, lambda v, f: v / f.top_speed)
    ),
    "unknown.teeth": Foreign(
        "contact",
        lambda rig, e: contact(rig, ripple=e["force"], ripple_period=e["period"]),
        lambda rng, f, s: {
            "force": s * rng.uniform(0.03, 0.08) * f.peak,
            "period": rng.uniform(0.15, 0.35) * f.depth,
        },
    ),
    "unknown.side_load": one("contact", "side", ("slope", 0.03, 0.1, lambda v, f: v / f.depth)),
    "unknown.warming": one("sensor", "warming", ("rate", 0.15, 0.35, _in_contact)),
    "unknown.lateral_gain": one(
        "sensor", "slope", ("slope", 0.15, 0.4, lambda v, f: v / f.side), signed=True
    ),
    "unknown.heavy_delay": one(
        "sensor", "heavy", ("slope", 0.08, 0.2, lambda v, f: v / f.frequency / f.top_peak)
    ),
    "unknown.force_play": one("sensor", "hysteresis", ("force", 0.02, 0.05, _of_peak)),
    "unknown.coarse_converter": one("sensor", "quantum", ("step", 0.04, 0.1, _of_peak)),
    "unknown.sample_hold": one(
        "sensor", "repeat", ("time", 0.05, 0.1, lambda v, f: v * f.contact_time)
    ),
    "unknown.quantised_platform": one("platform", "quantum", ("step", 0.03, 0.08, _of_depth)),
    "unknown.screw_error": Foreign(
        "platform",
        lambda rig, e: platform(rig, ripple=e["amplitude"], ripple_period=e["period"]),
        lambda rng, f, s: {
            "amplitude": s * rng.uniform(0.01, 0.04) * f.depth,
            "period": rng.uniform(0.4, 1.2) * f.depth,
        },
    ),
    "unknown.one_way_lag": Foreign(
        "platform",
        lambda rig, e: platform(
            rig,
            lag_w=2.0 * math.pi * e["bandwidth_in"],
            lag_w_back=2.0 * math.pi * e["bandwidth_out"],
        ),
        lambda rng, f, s: _bandwidths(f.frequency * rng.uniform(1.5, 3.0) / s),
    ),
    "unknown.platform_gives": one(
        "platform", "give", ("compliance", 0.03, 0.1, lambda v, f: v / f.stiffness)
    ),
    "unknown.acceleration_limit": Foreign(
        "platform",
        sets("platform", "acceleration", "limit"),
        lambda rng, f, s: {"limit": rng.uniform(0.5, 0.8) / s * f.top_peak / f.reduced_mass},
    ),
    "unknown.slow_pole": one(
        "compensator", "t2", ("t2", 0.005, 0.015, lambda v, f: v / f.frequency + 5e-4), COMPENSATION
    ),
    "unknown.lead_gain": one(
        "compensator", "gain", ("factor", 0.04, 0.12, lambda v, f: 1.0 + v), COMPENSATION, True
    ),
    "unknown.lead_slew": Foreign(
        COMPENSATION,
        lambda rig, e: compensator(rig, slew=e["rate"]),
        lambda rng, f, s: {
            "rate": rng.uniform(0.4, 0.7) / s * f.top_peak * 2.0 * math.pi * f.frequency
        },
    ),
    "unknown.drag": one(
        "bodies",
        "drag",
        ("coefficient", 0.04, 0.15, lambda v, f: v * f.reduced_mass / f.contact_time),
        DYNAMICS,
    ),
    "unknown.thrust": one("bodies", "thrust", ("force", 0.01, 0.03, _of_peak), DYNAMICS, True),
    "unknown.tether": one(
        "bodies", "tether", ("stiffness", 0.01, 0.04, lambda v, f: v * f.stiffness), DYNAMICS
    ),
    "unknown.fuel_flow": one(
        "bodies", "mass_rate", ("rate", 0.1, 0.3, _in_contact), DYNAMICS, True
    ),
    "unknown.clock_stretch": one(
        "sensor",
        "stretch",
        ("ratio", 0.05, 0.15, lambda v, f: v / f.frequency / (f.touch_time + f.contact_time)),
        "log",
    ),
    "unknown.frozen_record": one("sensor", "freeze", ("time", 0.01, 0.03, _plain), "log"),
}

FURTHER: dict[str, Foreign] = {
    "unknown.curve": Foreign(
        "contact",
        lambda rig, e: contact(
            rig, curve=np.array(e["factors"], dtype=float), curve_depth=float(e["depth"])
        ),
        _curve,
    ),
    "unknown.line_in_contact": Foreign(
        "contact",
        lambda rig, e: contact(rig, line=e["part"], line_w=2.0 * math.pi * e["frequency"]),
        lambda rng, f, s: {"part": s * rng.uniform(0.04, 0.12), "frequency": LINE},
    ),
    "unknown.wear": Foreign(
        "contact",
        lambda rig, e: contact(rig, stiffness=rig.contact.stiffness * (1.0 + e["rate"] * e["run"])),
        lambda rng, f, s: {"rate": s * -rng.uniform(0.02, 0.05)},
    ),
    "unknown.loaded_friction": Foreign(
        "contact",
        lambda rig, e: contact(
            rig, friction=rig.contact.friction + e["added"], friction_load=e["slope"]
        ),
        lambda rng, f, s: {"added": 0.05 * s, "slope": s * rng.uniform(0.8, 2.0) / f.peak},
    ),
    "unknown.oval_cone": Foreign("contact", _oval, drawn("ratio", 0.01, 0.03, _plain, True)),
    "unknown.depth_gain": one(
        "sensor",
        "depth_slope",
        ("slope", 0.1, 0.25, lambda v, f: v / _depth_range(f)),
        signed=True,
    ),
}


def _bandwidths(back: float) -> dict:
    return {"bandwidth_in": 3.0 * back, "bandwidth_out": back}


def _over_span(v: float, f: Facility) -> float:
    return v / f.span  # type: ignore[attr-defined]


RESIZED: dict[str, Draw] = {
    # A compliant platform reacts one tick later with a velocity: beyond a compliance of 1/(c rate)
    # it becomes unstable.
    "unknown.platform_gives": lambda rng, f, s: {
        "compliance": s
        * min(rng.uniform(0.03, 0.1) / f.stiffness, rng.uniform(0.1, 0.2) * f.tick / f.damping)
    },
    "unknown.ageing": drawn("rate", 0.15, 0.4, _over_span, True),
    "unknown.warming": drawn("rate", 0.08, 0.2, _over_span),
    "unknown.sample_hold": drawn("time", 0.006, 0.012, _plain),
    "unknown.heavy_delay": drawn("slope", 0.006, 0.012, lambda v, f: v / f.top_peak),
    "unknown.one_way_lag": lambda rng, f, s: _bandwidths(rng.uniform(10.0, 25.0) / s),
    "unknown.acceleration_limit": lambda rng, f, s: {
        "limit": rng.uniform(2.5, 4.0) / s * f.peak / f.reduced_mass
    },
    "unknown.drag": drawn(
        "coefficient",
        0.02,
        0.06,
        lambda v, f: v * f.reduced_mass / f.span,  # type: ignore[attr-defined]
    ),
    "unknown.tether": drawn("stiffness", 0.02, 0.06, lambda v, f: v * f.peak / max(f.side, 0.01)),
    "unknown.fuel_flow": drawn("rate", 0.05, 0.15, _over_span, True),
    "unknown.clock_stretch": drawn("ratio", 0.004, 0.01, _plain),
}
LONGER = {name: FOREIGN[name]._replace(draw=draw) for name, draw in RESIZED.items()}

IN_DOCKING: dict[str, Foreign] = FOREIGN | FURTHER | LONGER
LEAD_ALONE = ("unknown.slow_pole",)  # effects that act only in a phase lead
ELSEWHERE = {
    "unknown.oval_cone": CONES,
    "unknown.loaded_friction": CONES,
    "unknown.side_load": (BUMPER, *CONES),
    "unknown.lead_slew": (BUMPER, *CONES),
    # A position step within a tick, times the damping of a docking, is more than the docking's own
    # force.
    "unknown.quantised_platform": (BUMPER,),
    "unknown.acceleration_limit": (BUMPER, *CONES),
}


def foreign_in(design: str) -> dict[str, Foreign]:
    """The foreign effects that act in a design, with sizes for it."""
    table = FOREIGN | FURTHER if design == BUMPER else IN_DOCKING
    everywhere = (BUMPER, *CONES, HELD)
    return {n: e for n, e in table.items() if design in ELSEWHERE.get(n, everywhere)}
