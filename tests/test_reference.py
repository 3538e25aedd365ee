"""The reference is a contact of a passive mechanism: one that makes energy is none."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hiltestbed.scenario import load_scenario
from hiltestbed.simulation import run_batch

IDEAL = {
    "duration": 0.7,
    "rig.platform.tracking": "ideal",
    "compensation.force": {"kind": "none"},
    "sensor": {},
    "mechanism.contact": {"stiffness": 1.0e5, "damping": 0.0},
}


def pushing(rate: float) -> list[dict[str, object]]:
    """A law whose force grows by ``rate`` N per m/s while the sides part."""
    return [{"kind": "contact.map", "rate": [[-1.0, rate], [0.0, 0.0], [1.0, -rate]]}]


@pytest.mark.parametrize("rate", [100.0, 300.0])
def test_a_reference_that_makes_energy_is_an_error(call, tmp_path: Path, rate: float) -> None:
    changes = {**IDEAL, "effects": pushing(rate)}
    sets = [word for k, v in changes.items() for word in ("--set", f"{k}={json.dumps(v)}")]
    status, _, said = call("run", "02-bumper", *sets, "--no-rerun", "--out", str(tmp_path / "run"))
    assert status == 3
    assert "the reference" in said
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["status"] == "no_reference"
    assert summary["cor_reference"] > 1.01
    assert "makes" in summary["stop_reason"]


@pytest.mark.parametrize("rate", [250.0, 1000.0])
@pytest.mark.parametrize("gap", [0.005, 0.00507])
def test_an_undamped_contact_in_few_ticks_makes_none(rate: float, gap: float) -> None:
    """A spring appears and vanishes within a tick: an error of the steps, not of the mechanism."""
    changes = {
        **IDEAL,
        "rate": rate,
        "physics_rate": 2.0 * rate,
        "mechanism.contact.stiffness": 1.0e7,
        "approach.gap": gap,
        "safety.force": None,
    }
    (run,) = run_batch([load_scenario("02-bumper", changes)])
    assert run.summary["status"] == "completed"
