"""The same effect in the simulation and in a second rig that was written independently: the same
closed loop.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from hiltestbed import load_scenario
from hiltestbed.effects import EFFECTS
from hiltestbed.simulation import simulate as simulated
from tests.equipment.independent_rig import (
    draw_effects,
    draw_facility,
    nominal_rig,
    overridden,
    silence,
    simulate,
    with_effect,
)

# drawn at random, given by a table, or of more axes than that rig has
ELSEWHERE = {
    "sensor.jitter",
    "sensor.map",
    "sensor.rotation",
    "contact.map",
    "contact.backlash",
    "contact.misalignment",
    "platform.friction",
    "platform.drive",
    "platform.response",
    "dynamics.force",
}


@pytest.mark.parametrize("name", [kind for kind in EFFECTS if kind not in ELSEWHERE])
def test_two_rigs_run_alike_under_the_same_effect(name: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(21)
    facility = draw_facility(rng, frozenset({"slide"}))
    facility.scenario["sensor"]["noise"] = 0.0
    effects = draw_effects(rng, (name,), facility)
    changes = facility.runs[3]
    with (tmp_path / "nominal.yaml").open("w", encoding="utf-8") as file:
        YAML(typ="safe").dump(facility.scenario, file)
    scenario = load_scenario(tmp_path / "nominal.yaml", set={**changes, "effects": effects})
    trace = simulated([scenario], trace=True).trace
    assert trace is not None
    rig = nominal_rig(overridden(facility.scenario, changes))
    rig = with_effect(rig._replace(contact=rig.contact._replace(lever=0.5)), effects[0])
    records = simulate(rig, silence(rig.ticks))
    depth = records.pose_act[:, 2].max()
    peak = np.abs(records.physical[:, 2]).max()
    # What is left is sub-steps: one rig has 2 or 4 a tick, the other 20. A reading between two
    # ticks and just after the touch is interpolated over a sub-step by the one and exact in the
    # other: c v over half a sub-step of 0.25 ms, of a contact of 100 ms.
    assert np.abs(trace["pose_cmd"][:, 0, :3] - records.pose_cmd[:, :3]).max() < 5e-3 * depth
    assert np.abs(trace["pose_act"][1:, 0, :3] - records.pose_act[1:, :3]).max() < 5e-3 * depth
    difference = np.abs(trace["wrench_meas"][:, 0, :3] - records.wrench_meas[:, :3])
    assert np.sqrt(np.mean(difference**2)) < 3e-3 * peak
