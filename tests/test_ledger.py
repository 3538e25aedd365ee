"""The ledger's sum against what each delay does to a bounce."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import pytest

from hiltestbed import load_scenario, run
from hiltestbed.analysis.ledger import delay_ledger, predicted_log_error
from hiltestbed.analysis.stability import stability
from hiltestbed.contact.directions import acting_along_z
from hiltestbed.numerical_model.bodies import effective_mass
from hiltestbed.simulation import simulate

SCENARIO = "02-bumper"
SLOWER = {"rate": 2000, "physics_rate": 4000}
W = math.sqrt(1.0e5 / 400.0)


@cache
def undelayed(rate: float, physics_rate: float) -> float:
    """Restitution of the same bounce without any delay."""
    s = load_scenario(SCENARIO, set={"rate": rate, "physics_rate": physics_rate})
    found = simulate([s]).figures[0].cor
    assert found is not None
    return found


@pytest.mark.parametrize(
    "changes",
    [
        {"sensor.lowpass": 25.0},
        {"sensor.delay": 0.004, "sensor.lowpass": 40.0},
        {"effects": [{"kind": "sensor.lag", "time_constant": 0.006}]},
        {"effects": [{"kind": "platform.delay", "delay": 0.008}]},
        {"effects": [{"kind": "dynamics.step_delay", "ticks": 10}]},
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
    """ln(e/e_ref) within 0.01 while w tau <= 0.25; a lag leaves 3 % of it by its gain."""
    scenario = load_scenario(SCENARIO, set=SLOWER | changes)
    reference = undelayed(scenario.rate, scenario.physics_rate)
    figures = simulate([scenario]).figures[0]
    ledger = delay_ledger(scenario, figures)
    assert abs(W * ledger[-1].delay) <= 0.25
    assert ledger[-1].delay == pytest.approx(sum(entry.delay for entry in ledger[:-1]))
    assert predicted_log_error(scenario, ledger) == pytest.approx(
        math.log(figures.cor / reference), abs=0.015
    )


K, C = 1.0e5, 400.0  # of the scenario
FRAME = 4.0e5


@pytest.mark.parametrize(
    ("effects", "stiffness", "damping"),
    [
        ([{"kind": "contact.stiffness", "factor": 0.5}], 0.5 * K, C),
        ([{"kind": "contact.damping", "factor": 3.0}], K, 3.0 * C),
        # F = k (x - F/k_frame) + c v
        (
            [{"kind": "frame.compliance", "stiffness": FRAME}],
            K * FRAME / (K + FRAME),
            C * FRAME / (K + FRAME),
        ),
        ([{"kind": "contact.power_law", "exponent": 1.0, "stiffness": 6.0e4}], 6.0e4, C),
        ([{"kind": "contact.touch_offset", "offset": 1e-3}], K, C),
    ],
    ids=lambda v: str(v) if isinstance(v, list) else "",
)
def test_effects_of_the_contact_count_as_the_same_numbers_of_the_mechanism(
    effects: list[dict[str, Any]], stiffness: float, damping: float
) -> None:
    late = SLOWER | {"sensor.delay": 0.004, "compensation.force": {"kind": "none"}}
    same = {"mechanism.contact": {"stiffness": stiffness, "damping": damping}}
    one = load_scenario(SCENARIO, set=late | {"effects": effects})
    other = load_scenario(SCENARIO, set=late | same)
    assert acting_along_z(one.impact) == pytest.approx((stiffness, damping), rel=1e-6)
    figures = simulate([other]).figures[0]
    ledgers = [delay_ledger(s, figures) for s in (one, other)]
    for entry, equal in zip(*ledgers, strict=True):
        assert entry.equivalent_damping == pytest.approx(equal.equivalent_damping, rel=1e-6)
    verdicts = [stability(s) for s in (one, other)]
    for name in ("net_damping", "frequency", "largest_delay", "largest_stiffness", "rebound"):
        values = [v[name] for v in verdicts if v is not None]
        assert values[0] == pytest.approx(values[1], rel=2e-3), name


def test_a_damper_that_grows_with_penetration_acts_as_that_of_its_describing_function() -> None:
    """F = k x (1 + alpha v) over a half sine: the part in phase with v is 4 alpha k X/(3 pi)."""
    alpha, speed = 4.0, 0.03
    effects = [{"kind": "contact.hunt_crossley", "alpha": alpha}]
    found = acting_along_z(load_scenario(SCENARIO, set={"effects": effects}).impact)
    assert found[0] == pytest.approx(K, rel=1e-4)
    assert found[1] == pytest.approx(4.0 * alpha * K * speed / W / (3.0 * math.pi), rel=1e-4)


@pytest.mark.parametrize(("damping", "rate"), [(350.0, 1000.0), (0.0, 500.0)])
def test_a_force_that_is_corrected_by_what_is_identified_is_predicted_as_it_runs(
    damping: float, rate: float
) -> None:
    """Until the contact is identified, the platform's lag acts: it cannot be taken as removed."""
    scenario = load_scenario(
        SCENARIO,
        set={
            "rate": rate,
            "physics_rate": 4000.0,
            "mechanism.contact.damping": damping,
            "rig.platform.tracking": "response",
            "rig.platform.response": {"bandwidth": 60.0, "damping_ratio": 0.7},
            "compensation.motion": {"kind": "contact_correction"},
            "compensation.force": {"kind": "none"},
        },
    )
    summary = run(scenario).summary
    assert summary["cor_log_error"] > 0.004
    # the force steps by c v at touch and parting, anywhere within a tick: c h/mu of the speed each
    instants = 2.0 * damping / (rate * effective_mass(scenario.spacecraft))
    predicted, found = summary["cor_log_error_predicted"], summary["cor_log_error"]
    assert predicted == pytest.approx(found, abs=1.5e-3 + instants)
    assert summary["stability"]["rebound"] == pytest.approx(summary["cor"], rel=2e-3 + instants)
