"""A campaign of short contacts: two methods, any delay, any stiffness within a decade."""

from __future__ import annotations

from pathlib import Path

import pytest

from hiltestbed.campaign.schema import LoadedCampaign, load_campaign

SCENARIO = """\
name: short-contact
duration: 0.3
rate: 1000
physics_rate: 1000
spacecraft:
  chaser: {mass: 50.0, inertia: [20.0, 18.0, 15.0]}
  target: {mass: 200.0, inertia: [90.0, 90.0, 70.0]}
approach: {gap: 0.001, velocity: [0, 0, 0.03]}
mechanism: {contact: {stiffness: 2.0e4, damping: 20.0}}
rig: {platform: {tracking: ideal}}
sensor: {noise: 0.05}
compensation: {force: {kind: none}}
"""
CAMPAIGN = """\
scenario: scenario.yaml
vary:
  sensor.delay: {uniform: [0.0, 0.01]}
  compensation.force.kind: {values: [none, phase_lead]}
  mechanism.contact.stiffness: {log_uniform: [1.0e4, 1.0e5]}
design: {kind: sobol, cases: 96, seed: 3}
"""


def written(folder: Path) -> Path:
    """The campaign's file in a folder, beside its scenario."""
    (folder / "scenario.yaml").write_text(SCENARIO)
    path = folder / "campaign.yaml"
    path.write_text(CAMPAIGN)
    return path


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return written(tmp_path)


@pytest.fixture
def campaign(file: Path) -> LoadedCampaign:
    return load_campaign(file)


@pytest.fixture
def small(file: Path) -> LoadedCampaign:
    """The first eight cases, for what does not depend on their number."""
    return load_campaign(file, {"design.cases": 8})
