"""Docking in the closed loop: capture, rebound and miss, symmetry about the axis, six springs found
in a ring-down.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed.scenario import Scenario, load_scenario
from hiltestbed.simulation import run, simulate
from tests.slow import SLOW

SCENARIOS = Path(__file__).parents[1] / "scenarios"


def docking(name: str, **changes: object) -> Scenario:
    return load_scenario(
        SCENARIOS / f"{name}.yaml",
        set={key.replace("__", "."): value for key, value in changes.items()},
    )


@pytest.mark.parametrize(
    ("name", "outcome", "contacts"),
    [
        ("09-docking", "captured", 2),
        ("10-glancing", "captured", 2),
        ("11-rim-bounce", "rebound", 1),
        ("12-miss", "miss", 0),
    ],
)
def test_what_becomes_of_a_docking(name: str, outcome: str, contacts: int) -> None:
    batch = simulate([docking(name)], trace=True)
    told = batch.outcomes[0]
    assert told["outcome"] == outcome
    assert len(told["contact_events"]) == contacts
    assert (told["captured_at"] is not None) == (outcome == "captured")
    assert batch.trace is not None
    total = sum(np.array(e["impulse"]) for e in told["contact_events"]) if contacts else np.zeros(3)
    np.testing.assert_allclose(
        total, batch.trace.data["wrench_true"][:, 0, :3].sum(axis=0) / 2000.0, atol=1e-6
    )


def test_a_capture_pulls_as_well_as_pushes_and_comes_to_rest() -> None:
    batch = simulate([docking("09-docking")], trace=True)
    assert batch.trace is not None
    closed = int(batch.outcomes[0]["captured_at"] * 2000)
    force = batch.trace.data["wrench_true"][:, 0, 2]
    assert force[:closed].min() > -1e-6
    assert force[closed:].min() < -10.0
    # no jump at the closing
    assert abs(force[closed + 1] - force[closed - 1]) < 0.25 * abs(force[closed - 1]) + 5.0
    speed = np.linalg.norm(batch.trace.data["twist_act"][:, 0, :3], axis=1)
    assert speed[-400:].max() < 0.05 * speed[closed - 200 : closed].max()


@pytest.mark.parametrize("turn_deg", [37.0, -151.0])
def test_a_docking_turned_about_the_axis_is_the_same_docking(turn_deg: float) -> None:
    """Bodies of revolution, ideal tracking, no noise: within 1e-6 of the axial history."""
    still = {
        "rig__platform__tracking": "ideal",
        "sensor__noise": 0.0,
        "sensor__torque_noise": 0.0,
        "duration": 4.0,
    }
    turn = Rotation.from_euler("z", turn_deg, degrees=True)
    base = docking("09-docking", **still)
    offset = turn.apply([*base.approach.offset, 0.0])[:2]
    attitude = (
        turn * Rotation.from_euler("xyz", base.approach.attitude_deg, degrees=True) * turn.inv()
    )
    turned = docking(
        "09-docking",
        approach__offset=[float(v) for v in offset],
        approach__attitude_deg=[float(v) for v in attitude.as_euler("xyz", degrees=True)],
        **still,
    )
    batch = simulate([base, turned], trace=True)
    assert batch.trace is not None
    depth, force = batch.trace.data["pose_act"][:, :, 2], batch.trace.data["wrench_true"][:, :, 2]
    assert np.abs(depth[:, 0] - depth[:, 1]).max() < 1e-6 * np.abs(depth).max()
    assert np.abs(force[:, 0] - force[:, 1]).max() < 1e-6 * force.max()
    assert batch.outcomes[0]["captured_at"] == batch.outcomes[1]["captured_at"]


@SLOW
def test_a_ring_down_gives_stiffness_and_damping_of_all_six_axes() -> None:
    """Captured, 5 ms delay, noise: k within 1 %, c within 5 %. That one axis does not load another
    is tests/contact/test_mount.py's.
    """
    result = run(docking("13-ring-down"))
    for axis, found in result.summary["identification"].items():
        assert found["stiffness"] == pytest.approx(found["stiffness_true"], rel=1e-2), axis
        assert found["damping"] == pytest.approx(found["damping_true"], rel=5e-2), axis


@pytest.mark.parametrize(
    "path", sorted((SCENARIOS / "envelope").glob("*.yaml")), ids=lambda p: p.stem
)
def test_the_edges_of_the_envelope(path: Path) -> None:
    """Each edge alone ends in a capture; all of them at once do not."""
    outcome = simulate([load_scenario(path, set={"duration": 4.0})]).outcomes[0]["outcome"]
    assert outcome == ("rebound" if path.stem == "all-at-once" else "captured")
