"""The simulation and a second rig that was written independently: the same closed loop, on an axis and
with all six axes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML

from hiltestbed import load_scenario
from hiltestbed.effects import EFFECTS
from hiltestbed.scenario import resolved
from hiltestbed.simulation import simulate as simulated_here
from tests.equipment.independent_rig import (
    docking_rig,
    draw_effects,
    draw_facility,
    nominal_rig,
    overridden,
    silence,
    with_effect,
)
from tests.equipment.independent_rig import simulate as simulated_there

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
    trace = simulated_here([scenario], trace=True).trace
    rig = nominal_rig(overridden(facility.scenario, changes))
    rig = with_effect(rig._replace(contact=rig.contact._replace(lever=0.5)), effects[0])
    records = simulated_there(rig, silence(rig.ticks))
    depth = records.pose_act[:, 2].max()
    peak = np.abs(records.physical[:, 2]).max()
    # What is left is sub-steps: one rig has 2 or 4 a tick, the other 20. A reading between two
    # ticks and just after the touch is interpolated over a sub-step by the one and exact in the
    # other: c v over half a sub-step of 0.25 ms, of a contact of 100 ms.
    assert np.abs(trace["pose_cmd"][:, 0, :3] - records.pose_cmd[:, :3]).max() < 5e-3 * depth
    assert np.abs(trace["pose_act"][1:, 0, :3] - records.pose_act[1:, :3]).max() < 5e-3 * depth
    difference = np.abs(trace["wrench_meas"][:, 0, :3] - records.wrench_meas[:, :3])
    assert np.sqrt(np.mean(difference**2)) < 3e-3 * peak


DOCKING = "09-docking"
QUIET = {
    "rig.platform.tracking": "ideal",
    "compensation.motion": {"kind": "none"},
    "compensation.force": {"kind": "none"},
    "sensor.delay": 0.0,
    "sensor.noise": 0.0,
    "sensor.torque_noise": 0.0,
    "rate": 1000,
    "physics_rate": 20000,
    "duration": 4.0,
}
NO_LATCH: dict[str, Any] = {"mechanism.latch": None, "duration": 2.0}
MOUNT = {"stiffness": [3e5, 3e5, 8e5, 3e4, 3e4, 2e4], "damping": [500, 500, 900, 60, 60, 40]}
LATE = {"sensor.delay": 0.0023}
# [m], of the peak: here the cone is a mesh, whose vertices are single precision numbers
POSE, WRENCH = 1e-8, 1e-5


def _both(changes: dict, effects: tuple[dict, ...] = ()) -> tuple[Any, Any]:
    scenario = load_scenario(DOCKING, set=QUIET | changes | {"effects": list(effects)})
    trace = simulated_here([scenario], trace=True).trace
    rig = docking_rig(resolved(scenario))
    for effect in effects:
        rig = with_effect(rig, effect)
    return trace, simulated_there(rig, silence(rig.ticks))


def _agree(trace: Any, records: Any, pose: float, force: float) -> None:
    """Positions within `pose` [m], attitudes [rad] too, forces within `force` of the peak."""
    here = trace["wrench_true"][:, 0]
    peak = np.abs(here[:, :3]).max()
    assert peak > 50.0
    for channel in ("pose_cmd", "pose_act"):
        assert np.abs(trace[channel][:, 0] - getattr(records, channel)).max() < pose
    assert np.abs(here - records.physical)[:, :3].max() < force * peak
    assert np.abs(here - records.physical)[:, 3:].max() < force * peak  # at an arm of a metre
    assert np.abs(trace["wrench_meas"][:, 0] - records.wrench_meas).max() < force * peak


def test_a_healthy_docking_with_friction_tilt_spin_and_capture_is_the_same_in_both() -> None:
    trace, records = _both({})
    assert 0 < records.captured < 4000
    _agree(trace, records, POSE, WRENCH)
    np.testing.assert_array_equal(trace.contact[:, 0], records.touching)


def test_a_docking_on_a_compliant_mount_is_the_same_but_for_how_the_mount_is_integrated() -> None:
    trace, records = _both({"mechanism.mount": MOUNT})
    assert 0 < records.captured < 4000
    _agree(trace, records, 5e-6, 5e-3)


METHODS = [
    {"kind": "second_order_lead"},
    {"kind": "smith_predictor", "stiffness": 4e4, "damping": 3000.0, "lead_rest": True},
]


@pytest.mark.parametrize("method", METHODS, ids=lambda m: "-".join(map(str, m.values())))
def test_a_compensation_method_drives_both_alike(method: dict) -> None:
    trace, records = _both(
        LATE | {"compensation.force": method, "physics_rate": 10000, "duration": 3.6}
    )
    _agree(trace, records, POSE, WRENCH)
    # [N] 20 nm of the stiffness
    assert np.abs(trace["wrench_comp"][:, 0] - records.wrench_comp).max() < 1e-3


IN_DOCKING = [
    {"kind": "contact.surface_friction", "coefficient": 0.25},
    {"kind": "contact.misalignment", "angles_deg": [1.5, -1.0]},
    {"kind": "sensor.lag", "time_constant": 0.003},
    {"kind": "platform.lag", "bandwidth": 30.0},
    {"kind": "dynamics.inertia", "factor": 1.3, "body": "chaser"},
]


@pytest.mark.parametrize("effect", IN_DOCKING, ids=str)
def test_an_effect_in_a_docking_does_the_same_in_both(effect: dict) -> None:
    changes = LATE | {"compensation.force": {"kind": "phase_lead"}, "physics_rate": 10000}
    if effect["kind"] == "sensor.lag":  # the other rig's filter sees the force once a tick
        changes |= {"sensor.delay": 0.002, "physics_rate": 1000}
    trace, records = _both(NO_LATCH | changes, (effect,))
    _agree(trace, records, 1e-7, 1e-6)


def test_a_bumper_met_with_tilt_and_spin_and_a_latch_from_the_start_are_the_same_in_both() -> None:
    tilted = {
        "mechanism.latch": None,
        "approach.gap": 0.01,
        "approach.offset": [0.05, 0.02],
        "duration": 0.8,
    }
    far = {"approach.offset": [0.21, 0.21]}  # 0.3 m off the axis
    for kind, more in (("bumper", {}), ("bumper", far), ("latched", {})):
        changes = tilted | {"mechanism.kind": kind, "mechanism.contact.friction": 0.1} | more
        if kind == "latched":
            changes |= {
                "approach.gap": -0.002,
                "approach.offset": [0.001, -0.002],
                "approach.velocity": [0.0, 0.01, 0.02],
            }
        trace, records = _both(changes)
        _agree(trace, records, POSE, WRENCH)
