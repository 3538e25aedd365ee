"""Builds the five links of this rig from a scenario."""

from __future__ import annotations

from copy import deepcopy

import numpy as np

from tests.equipment.independent_rig import bodies
from tests.equipment.independent_rig.compensation import METHODS, Compensator
from tests.equipment.independent_rig.cone import Surfaces
from tests.equipment.independent_rig.contact import Contact
from tests.equipment.independent_rig.docking import Docking
from tests.equipment.independent_rig.links import Rig
from tests.equipment.independent_rig.mount import Mount, mount_of, no_mount
from tests.equipment.independent_rig.platform import Platform
from tests.equipment.independent_rig.sensor import Sensor

LEAD_T2 = 0.0005  # s, unless the scenario sets it
MIDDLE = 0.5  # lever of a healthy docking: the force acts in the middle of the overlap
BUMPER_TIP = 0.02  # m, radius


def overridden(scenario: dict, changes: dict) -> dict:
    """A copy of the scenario with dotted keys set."""
    out = deepcopy(scenario)
    for key, value in changes.items():
        *path, last = key.split(".")
        place = out
        for part in path:
            place = place[int(part)] if isinstance(place, list) else place[part]
        if isinstance(place, list):
            place[int(last)] = value
        else:
            place[last] = value
    return out


def nominal_rig(scenario: dict) -> Rig:
    """The nominal rig of a scenario: a point that meets a plane, or is latched and free to turn."""
    numbers = scenario["mechanism"]["contact"]
    stiffness, damping, friction = (numbers[n] for n in ("stiffness", "damping", "friction"))
    contact = Contact(float(stiffness), float(damping), float(friction))
    latched = scenario["mechanism"]["kind"] == "latched"
    point = Docking(Surfaces(tip=0.0, flat=True), contact, no_mount(), from_start=latched, ring=0.0)
    delay = float(scenario["sensor"]["delay"])
    rate = float(scenario["rate"])
    rig = Rig(
        bodies.from_scenario(scenario["spacecraft"]),
        Platform(np.ones(3)),
        contact,
        Sensor(np.ones(6), np.zeros((6, 6)), np.zeros(3), np.zeros(6), np.zeros(3), delay),
        compensator_of(scenario),
        scenario["approach"],
        rate,
        round(float(scenario["duration"]) * rate),
        point,
    )
    return with_held(rig)


def compensator_of(scenario: dict) -> Compensator:
    """The compensator of a scenario's `compensation.force`, any of `METHODS`."""
    force = scenario["compensation"]["force"]
    delay = float(scenario["sensor"]["delay"])
    t2 = float(force.get("lag", LEAD_T2))
    lead = force.get("lead")
    return Compensator(
        delay + t2 if lead is None else float(lead),
        t2,
        method=METHODS[force["kind"]],
        delay=delay,
        stiffness=float(force.get("stiffness", 0.0)),
        damping=float(force.get("damping", 0.0)),
        lead_rest=bool(force.get("lead_rest", False)),
    )


def docking_rig(scenario: dict) -> Rig:
    """The rig of a scenario with all six axes: probe and cone, bumper or latched."""
    rig = nominal_rig(scenario)
    contact = rig.contact._replace(lever=MIDDLE)
    docking = _docking(scenario["mechanism"], contact)
    return with_held(rig._replace(contact=contact, docking=docking))


def _docking(mechanism: dict, contact: Contact) -> Docking:
    kind, latch, mount = mechanism["kind"], mechanism.get("latch"), mechanism.get("mount")
    docking = Docking(
        Surfaces() if kind == "probe_cone" else Surfaces(tip=BUMPER_TIP, flat=True), contact,
        _mount(mount), from_start=kind == "latched",
    )  # fmt: skip
    if not latch:
        return docking
    cosine = float(np.cos(np.radians(latch["angle_deg"])))
    depth, speed = float(latch["depth"]), float(latch["speed"])
    return docking._replace(
        captures=True, latch_depth=depth, latch_cosine=cosine, latch_speed=speed
    )


def _mount(mount: dict | None) -> Mount:
    if mount is None:
        return no_mount()
    return mount_of(mount["stiffness"], mount.get("damping", np.zeros(6)))


def with_held(rig: Rig) -> Rig:
    """The rig with its contact law in its latch, which holds the pose at capture as it is."""
    law = rig.contact._replace(latched=True)
    if not rig.docking.from_start:
        law = law._replace(touch=0.0, preload=0.0, stop_stiffness=0.0)
    return rig._replace(docking=rig.docking._replace(held=law))
