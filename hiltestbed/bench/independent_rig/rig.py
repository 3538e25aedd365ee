"""From the numbers of a scenario to the five links of this rig."""

from __future__ import annotations

from copy import deepcopy

import numpy as np

from hiltestbed.bench.independent_rig import bodies
from hiltestbed.bench.independent_rig.closed_loop import Rig
from hiltestbed.bench.independent_rig.contact import Contact
from hiltestbed.bench.independent_rig.platform import Platform
from hiltestbed.bench.independent_rig.sensor import Compensator, Sensor

LEAD_T2 = 0.0005  # s, unless the scenario sets it


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
    """The rig as the scenario (a mapping with every key that is read here) believes it: bumper or latched, ideal tracking."""
    contact = scenario["mechanism"]["contact"]
    delay = float(scenario["sensor"]["delay"])
    force = scenario["compensation"]["force"]
    rate = float(scenario["rate"])
    t2 = float(force.get("t2", LEAD_T2))
    return Rig(
        bodies.from_scenario(scenario["spacecraft"]),
        Platform(np.ones(3)),
        Contact(
            np.array([0.0, 0.0, 1.0]), float(contact["stiffness"]), float(contact["damping"]), float(contact["friction"]),
            scenario["mechanism"]["kind"] == "latched",
        ),
        Sensor(np.ones(6), np.zeros((6, 6)), np.zeros(3), np.zeros(6), np.zeros(3), delay),
        Compensator(delay + t2, t2, force["kind"] == "phase_lead"),
        scenario["approach"],
        rate,
        round(float(scenario["duration"]) * rate),
    )  # fmt: skip
