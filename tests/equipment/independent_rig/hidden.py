"""The vocabulary of effects, each as a change of a link of this rig, written from its definition.

`EFFECTS[kind](rig, parameters)` returns the rig with that effect in it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from tests.equipment.independent_rig.bodies import CHASER, TARGET
from tests.equipment.independent_rig.links import Rig
from tests.equipment.independent_rig.rotation import from_attitude

Apply = Callable[[Rig, dict], Rig]
AXES = {"x": 0, "y": 1, "z": 2, "rx": 3, "ry": 4, "rz": 5}
BODIES = {"chaser": CHASER, "target": TARGET}


def changed(rig: Rig, part: str, **changes: Any) -> Rig:
    """The rig with other values of one of its links."""
    return rig._replace(**{part: getattr(rig, part)._replace(**changes)})


def sets(part: str, **fields: str | Callable[[dict], Any]) -> Apply:
    """Sets fields of a link, each to a parameter by its name or to a value computed from all."""

    def apply(rig: Rig, e: dict) -> Rig:
        values = {k: v(e) if callable(v) else e[v] for k, v in fields.items()}
        return changed(rig, part, **values)

    return apply


def angular(name: str) -> Callable[[dict], float]:
    """A frequency [Hz] as an angular one [rad/s]."""
    return lambda e: 2.0 * math.pi * e[name]


def _item(part: str, field: str, at: Callable[[dict], Any], value: Callable[[Any, dict], Any]):
    """Sets an item of an array of a link, computed from the old one and the parameters."""

    def apply(rig: Rig, e: dict) -> Rig:
        array = getattr(getattr(rig, part), field).copy()
        array[at(e)] = value(array[at(e)], e)
        return changed(rig, part, **{field: array})

    return apply


def _axis(e: dict) -> int:
    return AXES[e["axis"]]


def _body(e: dict) -> int:
    return BODIES[e["body"]]


def _times(old: Any, e: dict) -> Any:
    return old * e["factor"]


def _inertia(rig: Rig, e: dict) -> Rig:
    rig = _item("bodies", "inertia", _body, _times)(rig, e)
    return changed(rig, "bodies", compliance=np.linalg.inv(rig.bodies.inertia))


EFFECTS: dict[str, Apply] = {
    "sensor.delay": lambda rig, e: changed(rig, "sensor", delay=rig.sensor.delay + e["delay"]),
    "sensor.lag": sets("sensor", lag="time_constant"),
    "sensor.highpass": sets("sensor", highpass="time_constant"),
    "sensor.drift": _item("sensor", "drift", _axis, lambda old, e: e["rate"]),
    "sensor.bias": sets(
        "sensor", bias=lambda e: np.array([*e["force"], *e["torque"]], dtype=float)
    ),
    "sensor.gain": _item("sensor", "gain", _axis, _times),
    "sensor.crosstalk": _item(
        "sensor", "cross", lambda e: (_axis(e), AXES[e["source"]]), lambda old, e: e["ratio"]
    ),
    "sensor.deadzone": sets("sensor", deadzone="width"),
    "sensor.saturation": sets("sensor", limit="limit"),
    "sensor.hum": sets(
        "sensor",
        hum=lambda e: (
            e["amplitude"] * np.array([float(e.get("axis", "z") in ("all", a)) for a in "xyz"])
        ),
        hum_frequency="frequency",
        hum_phase=lambda e: e.get("phase", 0.0),
    ),
    "sensor.jitter": sets("sensor", jitter="sigma"),
    "contact.stiffness": lambda rig, e: changed(
        rig, "contact", stiffness=rig.contact.stiffness * e["factor"]
    ),
    "contact.damping": lambda rig, e: changed(
        rig, "contact", damping=rig.contact.damping * e["factor"]
    ),
    "contact.power_law": sets("contact", exponent="exponent", power="stiffness"),
    "contact.hunt_crossley": sets("contact", hunt="alpha"),
    "contact.dry_friction": sets(
        "contact", dry="force", dry_stiffness=lambda e: e.get("stiffness", 0.0)
    ),
    "contact.preload": sets("contact", preload="force"),
    "contact.hard_stop": sets("contact", stop_at="position", stop_stiffness="stiffness"),
    "contact.relaxation": sets(
        "contact", branch_stiffness="stiffness", branch_time="time_constant"
    ),
    "contact.adhesion": sets("contact", adhesion="force"),
    "contact.surface_friction": sets("contact", friction="coefficient"),
    "contact.touch_offset": sets("contact", touch="offset"),
    "contact.backlash": sets("contact", play="width"),
    "contact.misalignment": sets("contact", tilt=lambda e: from_attitude([*e["angles_deg"], 0.0])),
    "frame.compliance": sets("contact", frame_stiffness="stiffness"),
    "frame.mode": sets(
        "contact", mode_w=angular("frequency"), mode_zeta="damping_ratio", mode_mass="mass"
    ),
    "platform.delay": sets("platform", delay="delay"),
    "platform.lag": sets("platform", lag_w=angular("bandwidth")),
    "platform.backlash": sets("platform", play="width"),
    "platform.friction": sets("platform", stick="stick"),
    "platform.mode": sets("platform", mode_w=angular("frequency"), mode_zeta="damping_ratio"),
    "platform.scale": _item("platform", "scale", _axis, lambda old, e: e["factor"]),
    "platform.speed_limit": sets("platform", speed="speed"),
    "dynamics.mass": _item("bodies", "mass", _body, _times),
    "dynamics.inertia": _inertia,
    "dynamics.port_offset": _item(
        "bodies", "port_position", _body, lambda old, e: old + np.array(e["offset"])
    ),
    "dynamics.appendage": sets(
        "bodies",
        appendage_body=_body,
        appendage_ratio="mass_ratio",
        appendage_w=angular("frequency"),
        appendage_zeta="damping_ratio",
    ),
    "dynamics.step_delay": sets("bodies", late=lambda e: int(e["ticks"])),
    "dynamics.integrator": sets("bodies", explicit=lambda e: True),
    "loop.deadzone": sets("compensator", deadzone="width"),
    "log.skew": sets("sensor", skew="delay"),
}
