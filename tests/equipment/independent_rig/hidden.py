"""The vocabulary of effects, each as a change of a link of this rig, written from its definition.

`EFFECTS[kind](rig, parameters)` returns the rig with that effect in it.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from tests.equipment.independent_rig.bodies import CHASER, TARGET
from tests.equipment.independent_rig.links import Rig
from tests.equipment.independent_rig.rotation import from_attitude, matrix

AXES = {"x": 0, "y": 1, "z": 2, "rx": 3, "ry": 4, "rz": 5}
BODIES = {"chaser": CHASER, "target": TARGET}


def sensor(rig: Rig, **changes) -> Rig:
    """The rig with another sensor."""
    return rig._replace(sensor=rig.sensor._replace(**changes))


def contact(rig: Rig, **changes) -> Rig:
    """The rig with another contact."""
    return rig._replace(contact=rig.contact._replace(**changes))


def platform(rig: Rig, **changes) -> Rig:
    """The rig with another platform."""
    return rig._replace(platform=rig.platform._replace(**changes))


def bodies(rig: Rig, **changes) -> Rig:
    """The rig with another numerical model."""
    return rig._replace(bodies=rig.bodies._replace(**changes))


def compensator(rig: Rig, **changes) -> Rig:
    """The rig with another compensator."""
    return rig._replace(compensator=rig.compensator._replace(**changes))


def _changed(array: np.ndarray, index: int | tuple[int, int], value) -> np.ndarray:
    out = array.copy()
    out[index] = value
    return out


def _gain(rig: Rig, e: dict) -> Rig:
    a = AXES[e["axis"]]
    return sensor(rig, gain=_changed(rig.sensor.gain, a, rig.sensor.gain[a] * e["factor"]))


def _hum(rig: Rig, e: dict) -> Rig:
    axis = e.get("axis", "z")
    which = np.array([float(axis in ("all", a)) for a in "xyz"])
    return sensor(
        rig, hum=which * e["amplitude"], hum_frequency=e["frequency"], hum_phase=e.get("phase", 0.0)
    )


def _misalignment(rig: Rig, e: dict) -> Rig:
    tilt = from_attitude([*e["angles_deg"], 0.0])
    return contact(rig, normal=np.ascontiguousarray(matrix(tilt)[:, 2]), tilt=tilt)


def _frame_mode(rig: Rig, e: dict) -> Rig:
    w = 2.0 * math.pi * e["frequency"]
    return contact(rig, mode_w=w, mode_zeta=e["damping_ratio"], mode_mass=e["mass"])


def _mass(rig: Rig, e: dict) -> Rig:
    b = BODIES[e["body"]]
    return bodies(rig, mass=_changed(rig.bodies.mass, b, rig.bodies.mass[b] * e["factor"]))


def _inertia(rig: Rig, e: dict) -> Rig:
    b = BODIES[e["body"]]
    inertia = _changed(rig.bodies.inertia, b, rig.bodies.inertia[b] * e["factor"])
    return bodies(rig, inertia=inertia, compliance=np.linalg.inv(inertia))


def _port(rig: Rig, e: dict) -> Rig:
    b = BODIES[e["body"]]
    return bodies(
        rig,
        port_position=_changed(
            rig.bodies.port_position, b, rig.bodies.port_position[b] + np.array(e["offset"])
        ),
    )


def _appendage(rig: Rig, e: dict) -> Rig:
    return bodies(
        rig, appendage_body=BODIES[e["body"]], appendage_ratio=e["mass_ratio"],
        appendage_w=2.0 * math.pi * e["frequency"], appendage_zeta=e["damping_ratio"],
    )  # fmt: skip


EFFECTS: dict[str, Callable[[Rig, dict], Rig]] = {
    "sensor.delay": lambda rig, e: sensor(rig, delay=rig.sensor.delay + e["delay"]),
    "sensor.lag": lambda rig, e: sensor(rig, lag=e["time_constant"]),
    "sensor.highpass": lambda rig, e: sensor(rig, highpass=e["time_constant"]),
    "sensor.drift": lambda rig, e: sensor(
        rig, drift=_changed(rig.sensor.drift, AXES[e["axis"]], e["rate"])
    ),
    "sensor.bias": lambda rig, e: sensor(
        rig, bias=np.array([*e["force"], *e["torque"]], dtype=float)
    ),
    "sensor.gain": _gain,
    "sensor.crosstalk": lambda rig, e: sensor(
        rig, cross=_changed(rig.sensor.cross, (AXES[e["axis"]], AXES[e["source"]]), e["ratio"])
    ),
    "sensor.deadzone": lambda rig, e: sensor(rig, deadzone=e["width"]),
    "sensor.saturation": lambda rig, e: sensor(rig, limit=e["limit"]),
    "sensor.hum": _hum,
    "sensor.jitter": lambda rig, e: sensor(rig, jitter=e["sigma"]),
    "contact.stiffness": lambda rig, e: contact(rig, stiffness=rig.contact.stiffness * e["factor"]),
    "contact.damping": lambda rig, e: contact(rig, damping=rig.contact.damping * e["factor"]),
    "contact.power_law": lambda rig, e: contact(rig, exponent=e["exponent"], power=e["stiffness"]),
    "contact.hunt_crossley": lambda rig, e: contact(rig, hunt=e["alpha"]),
    "contact.dry_friction": lambda rig, e: contact(
        rig, dry=e["force"], dry_stiffness=e.get("stiffness", 0.0)
    ),
    "contact.preload": lambda rig, e: contact(rig, preload=e["force"]),
    "contact.hard_stop": lambda rig, e: contact(
        rig, stop_at=e["position"], stop_stiffness=e["stiffness"]
    ),
    "contact.relaxation": lambda rig, e: contact(
        rig, branch_stiffness=e["stiffness"], branch_time=e["time_constant"]
    ),
    "contact.adhesion": lambda rig, e: contact(rig, adhesion=e["force"]),
    "contact.surface_friction": lambda rig, e: contact(rig, friction=e["coefficient"]),
    "contact.touch_offset": lambda rig, e: contact(rig, touch=e["offset"]),
    "contact.backlash": lambda rig, e: contact(rig, play=e["width"]),
    "contact.misalignment": _misalignment,
    "frame.compliance": lambda rig, e: contact(rig, frame_stiffness=e["stiffness"]),
    "frame.mode": _frame_mode,
    "platform.delay": lambda rig, e: platform(rig, delay=e["delay"]),
    "platform.lag": lambda rig, e: platform(rig, lag_w=2.0 * math.pi * e["bandwidth"]),
    "platform.backlash": lambda rig, e: platform(rig, play=e["width"]),
    "platform.friction": lambda rig, e: platform(rig, stick=e["stick"]),
    "platform.mode": lambda rig, e: platform(
        rig, mode_w=2.0 * math.pi * e["frequency"], mode_zeta=e["damping_ratio"]
    ),
    "platform.scale": lambda rig, e: platform(
        rig, scale=_changed(rig.platform.scale, AXES[e["axis"]], e["factor"])
    ),
    "platform.speed_limit": lambda rig, e: platform(rig, speed=e["speed"]),
    "dynamics.mass": _mass,
    "dynamics.inertia": _inertia,
    "dynamics.port_offset": _port,
    "dynamics.appendage": _appendage,
    "dynamics.step_delay": lambda rig, e: bodies(rig, late=int(e["ticks"])),
    "dynamics.integrator": lambda rig, e: bodies(rig, explicit=True),
    "loop.deadzone": lambda rig, e: compensator(rig, deadzone=e["width"]),
    "log.skew": lambda rig, e: sensor(rig, skew=e["delay"]),
}
