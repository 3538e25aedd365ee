"""The compensation link is the loop's own compensation: run over the readings on record it gives the record's wrench."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hiltestbed.diagnosis.compensated import compensated, noise_gain, uncomputed

from hiltestbed import load_scenario, run

SCENARIO = Path(__file__).parents[2] / "scenarios" / "reference-bumper.yaml"
METHODS = [
    {"kind": "none"},
    {"kind": "phase_lead"},
    {"kind": "second_order_lead"},
    {"kind": "polynomial", "order": 2},
    {"kind": "dead_zone", "width": 5.0},
]


@pytest.mark.parametrize("method", METHODS, ids=lambda m: m["kind"])
def test_run_over_the_readings_it_gives_the_wrench_on_record(method: dict) -> None:
    scenario = load_scenario(SCENARIO, set={"duration": 0.7, "sensor.noise": 0.3, "compensation.force": method})
    trace = run(scenario).trace
    assert trace is not None
    assert np.abs(trace["wrench_comp"]).max() > 50.0
    np.testing.assert_allclose(compensated(scenario, trace["wrench_meas"]), trace["wrench_comp"], rtol=1e-12, atol=1e-12)


def test_noise_is_raised_as_the_weights_of_the_extrapolation_say() -> None:
    """4 F_0 - 6 F_1 + 4 F_2 - F_3: the root of 16 + 36 + 16 + 1."""
    scenario = load_scenario(SCENARIO, set={"compensation.force": {"kind": "polynomial", "order": 3}})
    assert noise_gain(scenario) == pytest.approx(np.sqrt(69.0), rel=1e-9)


def test_a_method_that_knows_more_than_the_record_is_refused() -> None:
    reason = uncomputed([load_scenario(SCENARIO, set={"compensation.force": {"kind": "resynchronised"}})])
    assert reason is not None
    assert "resynchronised" in reason
    assert uncomputed([load_scenario(SCENARIO)]) is None
