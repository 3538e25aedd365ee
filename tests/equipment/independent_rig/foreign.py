"""Foreign effects: deviations outside the vocabulary, each with its link of the loop.

Sizes are relative to the facility's contact, so that all are well above the noise. `FOREIGN` and
`FURTHER` are for any design in which they act, `IN_DOCKING` has other sizes for dockings. An effect
that changes from run to run gets the run's number as `run` in its parameters.
"""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from tests.equipment.independent_rig.facility import Facility
from tests.equipment.independent_rig.hidden import Apply, angular, changed, sets
from tests.equipment.independent_rig.sizes import (
    Draw,
    Number,
    Size,
    between,
    factor,
    inverse,
    of_contact_time,
    of_depth,
    of_peak,
    of_stiffness,
    plain,
    scaled,
)

KNOTS = 6
LINE = 23.0  # Hz
BUMPER, CONES, HELD = "bumper", ("docking", "mounted"), "held"


class Foreign(NamedTuple):
    """A foreign effect: its link, its application to a rig, and its parameters (see `sizes`)."""

    link: str
    apply: Apply
    draw: Draw


def _over(name: str) -> Size:
    """A share over a size of the facility."""
    return lambda v, f: v / getattr(f, name)


def _curve(rng: Generator, f: Facility, s: float) -> dict:
    """A curve of any shape: factors of the spring at even depths, each within 25 % of 1."""
    factors = 1.0 + s * rng.uniform(-0.25, 0.25, KNOTS)
    return {"factors": [round(float(v), 4) for v in factors], "depth": 1.5 * f.depth}


def _bandwidths(back: float) -> dict:
    return {"bandwidth_in": 3.0 * back, "bandwidth_out": back}


def _one(part: str, link: str = "", **fields: tuple[str, Number]) -> Foreign:
    """An effect of fields of one part of the rig; ``link``: if that has another name."""
    apply = sets(part, **{field: name for field, (name, _) in fields.items()})
    return Foreign(link or part, apply, dict(fields.values()))


_contact, _sensor, _platform = (partial(_one, part) for part in ("contact", "sensor", "platform"))
_lead, _bodies = partial(_one, "compensator", "compensation"), partial(_one, "bodies", "dynamics")
_log = partial(_one, "sensor", "log")

FOREIGN: dict[str, Foreign] = {
    "unknown.unloading": _contact(unloading=("loss", scaled(0.08, 0.2))),
    "unknown.ageing": _contact(ageing=("rate", scaled(0.2, 0.4, _over("contact_time"), True))),
    "unknown.speeding": _contact(speeding=("slope", scaled(0.25, 0.6, _over("top_speed")))),
    "unknown.teeth": _contact(
        ripple=("force", scaled(0.03, 0.08, of_peak)),
        ripple_period=("period", between(0.15, 0.35, of_depth)),
    ),
    "unknown.side_load": _contact(side=("slope", scaled(0.03, 0.1, _over("depth")))),
    "unknown.warming": _sensor(warming=("rate", scaled(0.15, 0.35, _over("contact_time")))),
    "unknown.lateral_gain": _sensor(slope=("slope", scaled(0.15, 0.4, _over("side"), True))),
    "unknown.heavy_delay": _sensor(
        heavy=("slope", scaled(0.08, 0.2, lambda v, f: v / f.frequency / f.top_peak))
    ),
    "unknown.force_play": _sensor(hysteresis=("force", scaled(0.02, 0.05, of_peak))),
    "unknown.coarse_converter": _sensor(quantum=("step", scaled(0.04, 0.1, of_peak))),
    "unknown.sample_hold": _sensor(repeat=("time", scaled(0.05, 0.1, of_contact_time))),
    "unknown.quantised_platform": _platform(quantum=("step", scaled(0.03, 0.08, of_depth))),
    "unknown.screw_error": _platform(
        ripple=("amplitude", scaled(0.01, 0.04, of_depth)),
        ripple_period=("period", between(0.4, 1.2, of_depth)),
    ),
    "unknown.one_way_lag": Foreign(
        "platform",
        sets("platform", lag_w=angular("bandwidth_in"), lag_w_back=angular("bandwidth_out")),
        lambda rng, f, s: _bandwidths(f.frequency * rng.uniform(1.5, 3.0) / s),
    ),
    "unknown.platform_gives": _platform(give=("compliance", scaled(0.03, 0.1, _over("stiffness")))),
    "unknown.acceleration_limit": _platform(
        acceleration=("limit", inverse(0.5, 0.8, lambda v, f: v * f.top_peak / f.reduced_mass))
    ),
    "unknown.slow_pole": _lead(
        t2=("t2", scaled(0.005, 0.015, lambda v, f: v / f.frequency + 5e-4))
    ),
    "unknown.lead_gain": _lead(gain=("factor", factor(0.04, 0.12))),
    "unknown.lead_slew": _lead(
        slew=("rate", inverse(0.4, 0.7, lambda v, f: v * f.top_peak * 2.0 * math.pi * f.frequency))
    ),
    "unknown.drag": _bodies(
        drag=("coefficient", scaled(0.04, 0.15, lambda v, f: v * f.reduced_mass / f.contact_time))
    ),
    "unknown.thrust": _bodies(thrust=("force", scaled(0.01, 0.03, of_peak, True))),
    "unknown.tether": _bodies(tether=("stiffness", scaled(0.01, 0.04, of_stiffness))),
    "unknown.fuel_flow": _bodies(mass_rate=("rate", scaled(0.1, 0.3, _over("contact_time"), True))),
    "unknown.clock_stretch": _log(
        stretch=(
            "ratio",
            scaled(0.05, 0.15, lambda v, f: v / f.frequency / (f.touch_time + f.contact_time)),
        )
    ),
    "unknown.frozen_record": _log(freeze=("time", scaled(0.01, 0.03))),
}

FURTHER: dict[str, Foreign] = {
    "unknown.curve": Foreign(
        "contact",
        sets(
            "contact",
            curve=lambda e: np.array(e["factors"], dtype=float),
            curve_depth=lambda e: float(e["depth"]),
        ),
        _curve,
    ),
    "unknown.line_in_contact": Foreign(
        "contact",
        sets("contact", line="part", line_w=angular("frequency")),
        {"part": scaled(0.04, 0.12), "frequency": LINE},
    ),
    "unknown.wear": Foreign(
        "contact",
        lambda rig, e: changed(
            rig, "contact", stiffness=rig.contact.stiffness * (1.0 + e["rate"] * e["run"])
        ),
        {"rate": scaled(0.02, 0.05, lambda v, f: -v)},
    ),
    "unknown.loaded_friction": Foreign(
        "contact",
        lambda rig, e: changed(
            rig, "contact", friction=rig.contact.friction + e["added"], friction_load=e["slope"]
        ),
        {
            "added": lambda rng, f, s: 0.05 * s,
            "slope": scaled(0.8, 2.0, _over("peak")),
        },
    ),
    "unknown.oval_cone": Foreign(
        "contact",
        lambda rig, e: changed(
            rig, "docking", surfaces=rig.docking.surfaces._replace(oval=e["ratio"])
        ),
        {"ratio": scaled(0.01, 0.03, plain, True)},
    ),
    "unknown.depth_gain": _sensor(  # over the range of the contact along the insertion
        depth_slope=(
            "slope",
            scaled(
                0.1,
                0.25,
                lambda v, f: v / (max(f.side, f.depth) if "six axes" in f.design else f.depth),
                True,
            ),
        )
    ),
}

RESIZED: dict[str, Draw] = {
    # A compliant platform reacts one tick later with a velocity: beyond a compliance of 1/(c rate)
    # it becomes unstable.
    "unknown.platform_gives": lambda rng, f, s: {
        "compliance": s
        * min(rng.uniform(0.03, 0.1) / f.stiffness, rng.uniform(0.1, 0.2) * f.tick / f.damping)
    },
    "unknown.ageing": {"rate": scaled(0.15, 0.4, _over("span"), True)},
    "unknown.warming": {"rate": scaled(0.08, 0.2, _over("span"))},
    "unknown.sample_hold": {"time": scaled(0.006, 0.012)},
    "unknown.heavy_delay": {"slope": scaled(0.006, 0.012, _over("top_peak"))},
    "unknown.one_way_lag": lambda rng, f, s: _bandwidths(rng.uniform(10.0, 25.0) / s),
    "unknown.acceleration_limit": {
        "limit": inverse(2.5, 4.0, lambda v, f: v * f.peak / f.reduced_mass)
    },
    "unknown.drag": {
        "coefficient": scaled(
            0.02,
            0.06,
            lambda v, f: v * f.reduced_mass / f.span,  # type: ignore[attr-defined]
        )
    },
    "unknown.tether": {
        "stiffness": scaled(0.02, 0.06, lambda v, f: v * f.peak / max(f.side, 0.01))
    },
    "unknown.fuel_flow": {"rate": scaled(0.05, 0.15, _over("span"), True)},
    "unknown.clock_stretch": {"ratio": scaled(0.004, 0.01)},
}
LONGER = {name: FOREIGN[name]._replace(draw=draw) for name, draw in RESIZED.items()}

IN_DOCKING: dict[str, Foreign] = FOREIGN | FURTHER | LONGER
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
