"""Foreign effects: deviations outside the vocabulary, each with its link of the loop.

Sizes are relative to the facility's contact, so that all are well above the noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from numpy.random import Generator

from tests.equipment.independent_rig.facility import Facility
from tests.equipment.independent_rig.hidden import bodies, compensator, contact, platform, sensor
from tests.equipment.independent_rig.links import Rig


class Foreign(NamedTuple):
    """A foreign effect: its link, its application to a rig, and parameters of moderate size for a
    facility (times `scale`).
    """

    link: str
    apply: Callable[[Rig, dict], Rig]
    draw: Callable[[Generator, Facility, float], dict]


def either(rng: Generator) -> float:
    """A sign."""
    return 1.0 if rng.random() < 0.5 else -1.0


FOREIGN: dict[str, Foreign] = {
    "unknown.unloading": Foreign(
        "contact",
        lambda rig, e: contact(rig, unloading=e["loss"]),
        lambda rng, f, s: {"loss": s * rng.uniform(0.08, 0.2)},
    ),
    "unknown.ageing": Foreign(
        "contact",
        lambda rig, e: contact(rig, ageing=e["rate"]),
        lambda rng, f, s: {"rate": s * either(rng) * rng.uniform(0.2, 0.4) / f.contact_time},
    ),
    "unknown.speeding": Foreign(
        "contact",
        lambda rig, e: contact(rig, speeding=e["slope"]),
        lambda rng, f, s: {"slope": s * rng.uniform(0.25, 0.6) / f.top_speed},
    ),
    "unknown.teeth": Foreign(
        "contact",
        lambda rig, e: contact(rig, ripple=e["force"], ripple_period=e["period"]),
        lambda rng, f, s: {
            "force": s * rng.uniform(0.03, 0.08) * f.peak,
            "period": rng.uniform(0.15, 0.35) * f.depth,
        },
    ),
    "unknown.side_load": Foreign(
        "contact",
        lambda rig, e: contact(rig, side=e["slope"]),
        lambda rng, f, s: {"slope": s * rng.uniform(0.03, 0.1) / f.depth},
    ),
    "unknown.warming": Foreign(
        "sensor",
        lambda rig, e: sensor(rig, warming=e["rate"]),
        lambda rng, f, s: {"rate": s * rng.uniform(0.15, 0.35) / f.contact_time},
    ),
    "unknown.lateral_gain": Foreign(
        "sensor",
        lambda rig, e: sensor(rig, slope=e["slope"]),
        lambda rng, f, s: {"slope": s * either(rng) * rng.uniform(0.15, 0.4) / f.side},
    ),
    "unknown.heavy_delay": Foreign(
        "sensor",
        lambda rig, e: sensor(rig, heavy=e["slope"]),
        lambda rng, f, s: {"slope": s * rng.uniform(0.08, 0.2) / f.frequency / f.top_peak},
    ),
    "unknown.force_play": Foreign(
        "sensor",
        lambda rig, e: sensor(rig, hysteresis=e["force"]),
        lambda rng, f, s: {"force": s * rng.uniform(0.02, 0.05) * f.peak},
    ),
    "unknown.coarse_converter": Foreign(
        "sensor",
        lambda rig, e: sensor(rig, quantum=e["step"]),
        lambda rng, f, s: {"step": s * rng.uniform(0.04, 0.1) * f.peak},
    ),
    "unknown.sample_hold": Foreign(
        "sensor",
        lambda rig, e: sensor(rig, repeat=e["time"]),
        lambda rng, f, s: {"time": s * rng.uniform(0.05, 0.1) * f.contact_time},
    ),
    "unknown.quantised_platform": Foreign(
        "platform",
        lambda rig, e: platform(rig, quantum=e["step"]),
        lambda rng, f, s: {"step": s * rng.uniform(0.03, 0.08) * f.depth},
    ),
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
        lambda rng, f, s: {
            "bandwidth_in": 3.0 * (b := f.frequency * rng.uniform(1.5, 3.0) / s),
            "bandwidth_out": b,
        },
    ),
    "unknown.platform_gives": Foreign(
        "platform",
        lambda rig, e: platform(rig, give=e["compliance"]),
        lambda rng, f, s: {"compliance": s * rng.uniform(0.03, 0.1) / f.stiffness},
    ),
    "unknown.acceleration_limit": Foreign(
        "platform",
        lambda rig, e: platform(rig, acceleration=e["limit"]),
        lambda rng, f, s: {"limit": rng.uniform(0.5, 0.8) / s * f.top_peak / f.reduced_mass},
    ),
    "unknown.slow_pole": Foreign(
        "compensation",
        lambda rig, e: compensator(rig, t2=e["t2"]),
        lambda rng, f, s: {"t2": s * rng.uniform(0.005, 0.015) / f.frequency + 5e-4},
    ),
    "unknown.lead_gain": Foreign(
        "compensation",
        lambda rig, e: compensator(rig, gain=e["factor"]),
        lambda rng, f, s: {"factor": 1.0 + s * either(rng) * rng.uniform(0.04, 0.12)},
    ),
    "unknown.lead_slew": Foreign(
        "compensation",
        lambda rig, e: compensator(rig, slew=e["rate"]),
        lambda rng, f, s: {
            "rate": rng.uniform(0.4, 0.7) / s * f.top_peak * 2.0 * math.pi * f.frequency
        },
    ),
    "unknown.drag": Foreign(
        "dynamics",
        lambda rig, e: bodies(rig, drag=e["coefficient"]),
        lambda rng, f, s: {
            "coefficient": s * rng.uniform(0.04, 0.15) * f.reduced_mass / f.contact_time
        },
    ),
    "unknown.thrust": Foreign(
        "dynamics",
        lambda rig, e: bodies(rig, thrust=e["force"]),
        lambda rng, f, s: {"force": s * either(rng) * rng.uniform(0.01, 0.03) * f.peak},
    ),
    "unknown.tether": Foreign(
        "dynamics",
        lambda rig, e: bodies(rig, tether=e["stiffness"]),
        lambda rng, f, s: {"stiffness": s * rng.uniform(0.01, 0.04) * f.stiffness},
    ),
    "unknown.fuel_flow": Foreign(
        "dynamics",
        lambda rig, e: bodies(rig, mass_rate=e["rate"]),
        lambda rng, f, s: {"rate": s * either(rng) * rng.uniform(0.1, 0.3) / f.contact_time},
    ),
    "unknown.clock_stretch": Foreign(
        "log",
        lambda rig, e: sensor(rig, stretch=e["ratio"]),
        lambda rng, f, s: {
            "ratio": s * rng.uniform(0.05, 0.15) / f.frequency / (f.touch_time + f.contact_time)
        },
    ),
    "unknown.frozen_record": Foreign(
        "log",
        lambda rig, e: sensor(rig, freeze=e["time"]),
        lambda rng, f, s: {"time": s * rng.uniform(0.01, 0.03)},
    ),
}
