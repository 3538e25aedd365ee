"""Moderate sizes of effects in a docking, where those of `sizes` do not fit: a docking is longer,
deeper and starts farther away.

`SIZES[kind](rng, facility, scale)` as in `sizes`; `ACTING[design]` lists the effects that act in a
design.
"""

from __future__ import annotations

import math

from numpy.random import Generator

from tests.equipment.independent_rig.docking_facility import DockingFacility
from tests.equipment.independent_rig.facility import rounded, sign
from tests.equipment.independent_rig.sizes import SIZES as AXIAL
from tests.equipment.independent_rig.sizes import Draw, either_body, factor

HELD_ONLY = {"contact.backlash"}
NOT_HELD = {
    "contact.surface_friction",
    "contact.adhesion",
    "contact.hard_stop",
    "contact.touch_offset",
    "contact.misalignment",
}
AXES = ("x", "y", "z")


def _axis(rng: Generator) -> str:
    return str(rng.choice(AXES))


def _lateness(rng: Generator, f: DockingFacility, s: float) -> float:
    """A time [s] that is a small phase of the oscillation against a wall, but not too short to be
    observable in the loop.
    """
    return rounded(
        s * min(max(rng.uniform(0.03, 0.08) / (2.0 * math.pi * f.frequency), 1.2e-3), 6e-3)
    )


def _port_offset(rng: Generator, f: DockingFacility, s: float) -> dict:
    return {
        "offset": [*(rounded(s * sign(rng) * rng.uniform(0.02, 0.06), 3) for _ in "xy"), 0.0],
        "body": either_body(rng),
    }


def _bias(rng: Generator, f: DockingFacility, s: float) -> dict:
    force = [rounded(s * sign(rng) * rng.uniform(6.0, 12.0) * f.noise, 3) for _ in range(3)]
    torque = [rounded(s * sign(rng) * rng.uniform(6.0, 12.0) * f.torque_noise, 3) for _ in range(3)]
    return {"force": force, "torque": torque}


def _crosstalk(rng: Generator, f: DockingFacility, s: float) -> dict:
    source, axis = (str(v) for v in rng.choice(AXES, 2, replace=False))
    return {
        "ratio": rounded(s * sign(rng) * rng.uniform(0.03, 0.08)),
        "source": source,
        "axis": axis,
    }


def _frame_mode(rng: Generator, f: DockingFacility, s: float) -> dict:
    static = rng.uniform(3.0, 10.0) * f.stiffness / s
    frequency = rng.uniform(12.0, 35.0)
    return {"frequency": rounded(frequency), "damping_ratio": rounded(rng.uniform(0.03, 0.1)),
            "mass": rounded(static / (2.0 * math.pi * frequency) ** 2)}  # fmt: skip


SIZES: dict[str, Draw] = AXIAL | {
    "sensor.delay": lambda rng, f, s: {"delay": _lateness(rng, f, s)},
    "sensor.lag": lambda rng, f, s: {"time_constant": _lateness(rng, f, s)},
    "sensor.highpass": lambda rng, f, s: {
        "time_constant": rounded(f.span * rng.uniform(1.0, 4.0) / s)
    },
    "sensor.bias": _bias,
    "sensor.gain": lambda rng, f, s: {"factor": factor(rng, s, 0.05, 0.15), "axis": _axis(rng)},
    "sensor.crosstalk": _crosstalk,
    "sensor.deadzone": lambda rng, f, s: {
        "width": rounded(s * max(rng.uniform(0.02, 0.06) * f.peak, 6.0 * f.noise))
    },
    "sensor.saturation": lambda rng, f, s: {
        "limit": rounded(f.peak * (1.0 - min(s * rng.uniform(0.3, 0.5), 0.9)))
    },
    "sensor.jitter": lambda rng, f, s: {
        "sigma": rounded(s * rng.uniform(0.1, 0.25) * f.scenario["sensor"]["delay"])
    },
    "contact.hunt_crossley": lambda rng, f, s: {
        "alpha": rounded(
            s * rng.uniform(0.5, 1.0) * f.damping / (f.stiffness * f.depth * rng.uniform(0.3, 0.6))
        )
    },
    "contact.relaxation": lambda rng, f, s: {
        "stiffness": rounded(s * rng.uniform(0.15, 0.4) * f.stiffness),
        "time_constant": rounded(rng.uniform(0.02, 0.15)),
    },
    "contact.adhesion": lambda rng, f, s: {"force": rounded(s * rng.uniform(0.15, 0.4) * f.peak)},
    "contact.touch_offset": lambda rng, f, s: {
        "offset": rounded(s * sign(rng) * rng.uniform(0.05, 0.2) * f.depth)
    },
    "frame.mode": _frame_mode,
    "platform.delay": lambda rng, f, s: {"delay": _lateness(rng, f, s)},
    "platform.lag": lambda rng, f, s: {
        "bandwidth": rounded(1.4 / (2.0 * math.pi * _lateness(rng, f, s)))
    },
    # A position that sticks changes the contact force by damping times its step over a tick: the
    # step must be small.
    "platform.friction": lambda rng, f, s: {
        "stick": rounded(s * rng.uniform(10.0, 25.0) * f.pose_noise)
    },
    "platform.mode": lambda rng, f, s: {
        "frequency": rounded(rng.uniform(8.0, 25.0) / math.sqrt(s)),
        "damping_ratio": rounded(rng.uniform(0.03, 0.1)),
    },
    "platform.scale": lambda rng, f, s: {
        "factor": factor(rng, s, 0.005, 0.02),
        "axis": _axis(rng),
    },
    "platform.speed_limit": lambda rng, f, s: {
        "speed": rounded(f.top_speed * (1.0 - min(s * rng.uniform(0.1, 0.3), 0.9)))
    },
    "contact.misalignment": lambda rng, f, s: {
        "angles_deg": [rounded(s * sign(rng) * rng.uniform(0.3, 1.5), 3) for _ in range(2)]
    },
    "dynamics.mass": lambda rng, f, s: {
        "factor": factor(rng, s, 0.05, 0.2),
        "body": either_body(rng),
    },
    "dynamics.inertia": lambda rng, f, s: {
        "factor": factor(rng, s, 0.1, 0.3),
        "body": either_body(rng),
    },
    "dynamics.port_offset": _port_offset,
    "dynamics.appendage": lambda rng, f, s: {
        "mass_ratio": rounded(min(s * rng.uniform(0.08, 0.2), 0.5)),
        "frequency": rounded(rng.uniform(0.6, 3.0)),
        "damping_ratio": rounded(rng.uniform(0.01, 0.06)),
        "body": "chaser",
    },
    "log.skew": lambda rng, f, s: {"delay": _lateness(rng, f, s)},
}

ACTING: dict[str, tuple[str, ...]] = {
    "docking": tuple(name for name in SIZES if name not in HELD_ONLY),
    "mounted": tuple(name for name in SIZES if name not in HELD_ONLY),
    "held": tuple(name for name in SIZES if name not in NOT_HELD),
}
