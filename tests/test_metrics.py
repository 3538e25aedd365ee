"""The rebound: of the last speed, whatever the compensation does afterwards, and beside a reference that
makes no energy."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from hiltestbed.loop import Loop
from hiltestbed.scenario import load_scenario
from hiltestbed.simulation import run_batch
from tests.running import run


@pytest.mark.parametrize(
    "force",
    [
        {"kind": "none"},
        {"kind": "polynomial"},
        {"kind": "kalman"},
    ],
    ids=str,
)
@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_the_coefficient_of_restitution_is_that_of_the_last_speed(
    force: dict[str, Any], noise: float
) -> None:
    """An extrapolation through three delays of 20 ms goes on for 60 ms after a contact of 65 ms,
    and still adds a tenth of the speed. It amplifies noise of 0.3 N to some 10 N at most, so that
    up to 20 N may pass for noise: in the last 6 ms, 1 % of the 12 N s that 400 kg have at 0.03 m/s.
    """
    scenario = load_scenario(
        "02-bumper",
        {"sensor.delay": 0.02, "sensor.noise": noise, "compensation.force": force},
    )
    result = run(scenario)
    last = -float(result.trace.data["twist_cmd"][-1].ravel()[2]) / scenario.approach.velocity[2]
    assert result.summary["cor"] == pytest.approx(last, abs=1e-2 if noise else 2e-3)


def test_a_run_has_rebounded_once_its_speed_no_longer_changes() -> None:
    changes = {
        "sensor.delay": 0.02,
        "sensor.noise": 0.0,
        "compensation.force": {"kind": "polynomial"},
    }
    loop = Loop([load_scenario("02-bumper", changes)])
    while not loop.tally.parted(loop.alive):
        loop.step(None)
    before = loop.tally.figures(0).cor
    for _ in range(500):
        loop.step(None)
    assert loop.tally.figures(0).cor == before


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
