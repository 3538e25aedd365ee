"""Further foreign effects, outside the vocabulary, and the sizes of all foreign effects in a
docking.

`FURTHER` for any design in which they act, `IN_DOCKING` for dockings; `WHERE[name]` lists the
designs. An effect that changes from run to run gets the run's number as `run` in its parameters.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.random import Generator

from tests.equipment.independent_rig.facility import Facility
from tests.equipment.independent_rig.foreign import FOREIGN, Foreign, either
from tests.equipment.independent_rig.hidden import contact, sensor
from tests.equipment.independent_rig.links import Rig

KNOTS = 6
LINE = 23.0  # Hz
BUMPER, CONES, HELD = "bumper", ("docking", "mounted"), "held"
EVERYWHERE = (BUMPER, *CONES, HELD)


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
    "unknown.oval_cone": Foreign(
        "contact", _oval, lambda rng, f, s: {"ratio": s * either(rng) * rng.uniform(0.01, 0.03)}
    ),
    "unknown.depth_gain": Foreign(
        "sensor",
        lambda rig, e: sensor(rig, depth_slope=e["slope"]),
        lambda rng, f, s: {"slope": s * either(rng) * rng.uniform(0.1, 0.25) / _depth_range(f)},
    ),
}


def _depth_range(f: Facility) -> float:
    """Range of the contact along the insertion [m]."""
    return max(f.side, f.depth) if "six axes" in f.design else f.depth


RESIZED = {
    # A compliant platform reacts one tick later with a velocity: beyond a compliance of 1/(c rate)
    # it becomes unstable.
    "unknown.platform_gives": lambda rng, f, s: {
        "compliance": s
        * min(rng.uniform(0.03, 0.1) / f.stiffness, rng.uniform(0.1, 0.2) * f.tick / f.damping)
    },
    "unknown.ageing": lambda rng, f, s: {"rate": s * either(rng) * rng.uniform(0.15, 0.4) / f.span},
    "unknown.warming": lambda rng, f, s: {"rate": s * rng.uniform(0.08, 0.2) / f.span},
    "unknown.sample_hold": lambda rng, f, s: {"time": s * rng.uniform(0.006, 0.012)},
    "unknown.lateral_gain": lambda rng, f, s: {
        "slope": s * either(rng) * rng.uniform(0.15, 0.4) / f.side
    },
    "unknown.heavy_delay": lambda rng, f, s: {"slope": s * rng.uniform(0.006, 0.012) / f.top_peak},
    "unknown.one_way_lag": lambda rng, f, s: {
        "bandwidth_in": 3.0 * (b := rng.uniform(10.0, 25.0) / s),
        "bandwidth_out": b,
    },
    "unknown.acceleration_limit": lambda rng, f, s: {
        "limit": rng.uniform(2.5, 4.0) / s * f.peak / f.reduced_mass
    },
    "unknown.drag": lambda rng, f, s: {
        "coefficient": s * rng.uniform(0.02, 0.06) * f.reduced_mass / f.span
    },
    "unknown.tether": lambda rng, f, s: {
        "stiffness": s * rng.uniform(0.02, 0.06) * f.peak / max(f.side, 0.01)
    },
    "unknown.fuel_flow": lambda rng, f, s: {
        "rate": s * either(rng) * rng.uniform(0.05, 0.15) / f.span
    },
    "unknown.clock_stretch": lambda rng, f, s: {"ratio": s * rng.uniform(0.004, 0.01)},
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
WHERE: dict[str, tuple[str, ...]] = {name: ELSEWHERE.get(name, EVERYWHERE) for name in IN_DOCKING}


def foreign_in(design: str) -> dict[str, Foreign]:
    """The foreign effects that act in a design, with sizes for it."""
    table = FOREIGN | FURTHER if design == BUMPER else IN_DOCKING
    return {name: table[name] for name in table if design in WHERE[name]}
