"""The ledger's sum against what each delay does to a bounce."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from hiltestbed import load_scenario
from hiltestbed.analysis.ledger import delay_ledger, predicted_log_error
from hiltestbed.simulation import simulate

SCENARIO = Path(__file__).parents[1] / "scenarios" / "02-bumper.yaml"
W = math.sqrt(1.0e5 / 400.0)


@cache
def undelayed(rate: float, physics_rate: float) -> float:
    """Restitution of the same bounce without any delay."""
    found = (
        simulate([load_scenario(SCENARIO, set={"rate": rate, "physics_rate": physics_rate})])
        .figures[0]
        .cor
    )
    assert found is not None
    return found


@pytest.mark.parametrize(
    "changes",
    [
        {"sensor.delay": 0.01},
        {"sensor.lowpass": 25.0},
        {"sensor.delay": 0.004, "sensor.lowpass": 40.0},
        {"sensor.delay": 0.004, "effects": [{"kind": "sensor.delay", "delay": 0.004}]},
        {"effects": [{"kind": "sensor.lag", "time_constant": 0.006}]},
        {"effects": [{"kind": "platform.delay", "delay": 0.008}]},
        {"effects": [{"kind": "dynamics.step_delay", "ticks": 40}]},
        {"rate": 1000, "physics_rate": 4000, "effects": [{"kind": "dynamics.integrator"}]},
        {"sensor.delay": 0.008, "compensation.force": {"kind": "phase_lead", "lead": 0.004}},
        {"sensor.delay": 0.008, "compensation.force": {"kind": "second_order_lead"}},
        {"sensor.delay": 0.008, "compensation.force": {"kind": "resynchronised"}},
        {
            "sensor.delay": 0.008,
            "compensation.force": {"kind": "virtual_contact", "damping": 500.0},
        },
        {
            "sensor.delay": 0.008,
            "compensation.force": {"kind": "smith_predictor", "stiffness": 0.5e5, "damping": 200.0},
        },
        {
            "compensation.force": {"kind": "resynchronised"},
            "effects": [{"kind": "platform.delay", "delay": 0.008}],
        },
        {
            "sensor.delay": 0.004,
            "compensation.force": {"kind": "resynchronised", "delay": "estimate"},
            "effects": [{"kind": "sensor.delay", "delay": 0.004}],
        },
    ],
    ids=lambda c: " ".join(str(v) for v in c.values()),
)
def test_every_delay_is_in_the_ledger(changes: dict[str, Any]) -> None:
    """ln(e/e_ref) within 0.01 while w tau <= 0.25; a first-order lag leaves 3 % of it by its
    gain.
    """
    scenario = load_scenario(SCENARIO, set=changes)
    reference, figures = (
        undelayed(scenario.rate, scenario.physics_rate),
        simulate([scenario]).figures[0],
    )
    assert figures.cor is not None
    ledger = delay_ledger(scenario, figures)
    assert abs(W * ledger[-1].delay) <= 0.25
    assert ledger[-1].delay == pytest.approx(sum(entry.delay for entry in ledger[:-1]))
    assert predicted_log_error(scenario, ledger) == pytest.approx(
        math.log(figures.cor / reference), abs=0.015
    )
