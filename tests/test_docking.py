"""Docking in the closed loop: capture, rebound and miss, symmetry about the axis."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed.scenario import load_scenario
from hiltestbed.simulation import simulate
from tests.running import SCENARIOS, shipped


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
    batch = simulate([shipped(name)], trace=True)
    told = batch.outcomes[0]
    assert told["outcome"] == outcome
    assert len(told["contact_events"]) == contacts
    assert (told["captured_at"] is not None) == (outcome == "captured")
    total = sum(np.array(e["impulse"]) for e in told["contact_events"]) if contacts else np.zeros(3)
    force = batch.trace["wrench_true"][:, 0, :3]
    np.testing.assert_allclose(total, force.sum(axis=0) / 2000.0, atol=1e-6)
    if name == "09-docking":  # a capture pulls as well as pushes and comes to rest
        closed, along = int(told["captured_at"] * 2000), force[:, 2]
        assert along[:closed].min() > -1e-6
        assert along[closed:].min() < -10.0
        # no jump at the closing
        assert abs(along[closed + 1] - along[closed - 1]) < 0.25 * abs(along[closed - 1]) + 5.0
        speed = np.linalg.norm(batch.trace["twist_act"][:, 0, :3], axis=1)
        assert speed[-400:].max() < 0.05 * speed[closed - 200 : closed].max()


def test_a_docking_turned_about_the_axis_is_the_same_docking() -> None:
    """Bodies of revolution, ideal tracking, no noise: within 1e-6 of the axial history."""
    still = {
        "rig.platform.tracking": "ideal",
        "sensor.noise": 0.0,
        "sensor.torque_noise": 0.0,
        "duration": 4.0,
    }
    turn = Rotation.from_euler("z", -151.0, degrees=True)
    base = shipped("09-docking", still)
    offset = turn.apply([*base.approach.offset, 0.0])[:2]
    attitude = (
        turn * Rotation.from_euler("xyz", base.approach.attitude_deg, degrees=True) * turn.inv()
    )
    keys = {
        "approach.offset": offset.tolist(),
        "approach.attitude_deg": attitude.as_euler("xyz", degrees=True).tolist(),
    }
    turned = shipped("09-docking", still | keys)
    batch = simulate([base, turned], trace=True)
    depth, force = batch.trace.data["pose_act"][:, :, 2], batch.trace.data["wrench_true"][:, :, 2]
    assert np.abs(depth[:, 0] - depth[:, 1]).max() < 1e-6 * np.abs(depth).max()
    assert np.abs(force[:, 0] - force[:, 1]).max() < 1e-6 * force.max()
    assert batch.outcomes[0]["captured_at"] == batch.outcomes[1]["captured_at"]


@pytest.mark.parametrize(
    "path", sorted((SCENARIOS / "envelope").glob("*.yaml")), ids=lambda p: p.stem
)
def test_the_edges_of_the_envelope(path: Path) -> None:
    """Each edge alone ends in a capture; all of them at once do not."""
    outcome = simulate([load_scenario(path, set={"duration": 4.0})]).outcomes[0]["outcome"]
    assert outcome == ("rebound" if path.stem == "all-at-once" else "captured")
