"""The rebound speed is that of parting, whatever the compensation does afterwards."""

from __future__ import annotations

from typing import Any

import pytest

from hiltestbed import load_scenario
from hiltestbed.loop import Loop
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
    assert result.trace is not None
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
