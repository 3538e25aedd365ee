"""The page of a run: it says what the figures say, and stands alone."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

import hiltestbed
from hiltestbed import load_scenario
from hiltestbed.analysis.assessment import ACTIVE, NEUTRAL, assess, is_active
from hiltestbed.analysis.metrics import energy_generated
from hiltestbed.numerical_model.bodies import approach_state, effective_mass, mobility
from hiltestbed.report.run import run_report
from tests.running import run as simulated

SHORT = {"duration": 0.6, "approach.gap": 0.002, "rig.platform.tracking": "ideal"}


@pytest.fixture(scope="module")
def late() -> hiltestbed.Run:
    return hiltestbed.run(load_scenario("03-bumper-delay-uncompensated", SHORT))


def test_a_head_on_hit_has_one_restitution_and_one_energy(late: hiltestbed.Run) -> None:
    """The energy as a sum over the trace and as the loop keeps it tick by tick."""
    for name in ("cor_normal", "cor_normal_reference"):
        same = late.summary[name.replace("_normal", "")]
        assert late.summary[name] == pytest.approx(same, rel=1e-6)
    assert late.trace is not None
    made = energy_generated(late.trace, approach_state(late.scenario.approach), late.scenario.tick)
    assert made[-1] == pytest.approx(late.summary["energy_generated"], rel=1e-9)


def test_the_page_warns_and_advises(late: hiltestbed.Run, tmp_path: Path) -> None:
    hiltestbed.write_run(late, tmp_path / "r", rerun=False)
    page = (tmp_path / "r" / "report.html").read_text()
    assert "http" not in page
    for words in (
        "faster than the approach",
        "Is the loop passive?",
        "The loop in this contact is unstable",
        "What to do next",
        "compensation.force=",
    ):
        assert words in page
    assert page.count("data:image/png") == 2
    assert json.loads((tmp_path / "r" / "summary.json").read_text())["cor"] == late.summary["cor"]


def test_a_miss_and_a_run_without_trace_have_a_page() -> None:
    miss = simulated(load_scenario("12-miss", {"duration": 0.05}))
    page = run_report(miss).html()
    assert "the question does not arise" in page
    assert "did not touch" in page
    assert "data:image" not in run_report(hiltestbed.Run(miss.scenario, miss.summary)).html()


@pytest.fixture(scope="module")
def glancing() -> hiltestbed.Run:
    """A probe that meets its cone off the axis and goes on inwards: along z it has no rebound."""
    keys = {
        "approach": {"gap": 0.07, "offset": [0.06, -0.02], "velocity": [0.0, 0.0, 0.08]},
        "duration": 1.0,
        "mechanism.latch": None,
        "mechanism.contact": {"stiffness": 5.0e4, "damping": 800.0, "friction": 0.0},
        "sensor": {"delay": 0.006},
        "compensation.force.kind": "none",
    }
    return simulated(load_scenario("09-docking", keys))


def test_restitution_along_the_impulse_is_that_of_the_energy(glancing: hiltestbed.Run) -> None:
    """1 - e^2 is the part of the kinetic energy along the impulse that the contact took from the
    numerical model: J (v + v')/2.
    """
    trace, summary = glancing.trace, glancing.summary
    assert summary["cor"] is None
    first = int(np.argmax(trace.contact))
    last = first + int(np.argmin(trace.contact[first:])) + 40
    rows = slice(first - 1, last)
    wrench, twist = trace["wrench_comp"][rows], trace["twist_cmd"]
    # where A was when the wrench acted; its twist goes with the moment about it
    lever = trace["pose_cmd"][first - 2 : last - 1, :3]
    wrench = np.hstack([wrench[:, :3], wrench[:, 3:] - np.cross(lever, wrench[:, :3])])
    change = (
        -float(np.sum(wrench * 0.5 * (twist[rows] + twist[first - 2 : last - 1])))
        / glancing.scenario.rate
    )
    impulse = wrench.sum(axis=0)
    # m u^2/2 along it
    energy = (
        0.5
        * (impulse @ twist[first - 1]) ** 2
        / (impulse @ mobility(glancing.scenario.spacecraft) @ impulse)
    )
    assert summary["cor_normal"] == pytest.approx(math.sqrt(1.0 + change / energy), rel=0.01)
    assert summary["cor_normal"] > summary["cor_normal_reference"] * 1.02
    assert summary["cor_normal_log_error"] == pytest.approx(
        math.log(summary["cor_normal"] / summary["cor_normal_reference"])
    )


def test_the_page_of_a_cone_says_what_was_identified_along_the_normal(
    glancing: hiltestbed.Run,
) -> None:
    page = run_report(glancing).html()
    normal = glancing.summary["identification_normal"]
    assert normal["stiffness"] == pytest.approx(5.0e4, rel=0.01)
    assert f"<td>normal</td><td>{normal['stiffness']:.6g} ± " in page
    assert "Neither stiffness nor damping was identified" not in page
    assert "along the impulse" in page
    assert "ended at" in assess(glancing.summary).headline
    assert any("along its impulse" in warning for warning in assess(glancing.summary).warnings)


def _made(share: float, **figures: object) -> dict:
    """Of a run in which the rig made that share of the energy, with no other warning."""
    run = {
        "status": "completed",
        "outcome": "rebound",
        "cor": 0.9,
        "cor_reference": 0.9,
        "cor_log_error": 0.0,
        "contact_duration": 0.1,
    }
    run |= {
        "identification": {},
        "delay_ledger": [],
        "energy_reference": 2.0,
        "energy_generated": 2.0 * share,
        "energy_resolution": 0.0,
    }
    return run | figures


def test_activity_is_warned_of_from_where_it_shows_in_the_rebound() -> None:
    """e^2 (exp(0.04) - 1) of the energy makes a rebound 2 % too fast; less is told without a
    warning, and so is what a tick blurs.
    """
    limit = 0.81 * ACTIVE
    assert math.sqrt(0.81 + limit) / 0.9 == pytest.approx(math.exp(0.02))
    for summary, warned in (
        (_made(1.01 * limit), True),
        (_made(0.99 * limit), False),
        (_made(1.01 * limit, energy_resolution=4.0 * limit), False),
        (_made(2.0 * NEUTRAL, cor_reference=0.1), True),
        (_made(0.9 * NEUTRAL, cor_reference=0.1), False),
    ):
        assert is_active(summary) is warned
        assert any("active" in warning for warning in assess(summary).warnings) is warned
    assert "active" in assess(_made(0.99 * limit)).energy


RESYNCHRONISED = {"sensor.delay": 5.0, "compensation.resynchronised": -5.0}


@pytest.mark.parametrize(
    ("ledger", "largest", "advised"),
    [
        ({"sensor.delay": 5.0}, "sensor.delay (5 ms)", "{kind: resynchronised}"),
        (
            RESYNCHRONISED
            | {
                "effects.sensor.delay": 2.0,
                "platform.servo": 4.0,
                "compensation.platform": -4.0,
            },
            "effects.sensor.delay (2 ms)",
            "delay: estimate",
        ),
        (
            {"sensor.delay": 2.0, "platform.servo": 15.0},
            "platform.servo (15 ms)",
            "compensation.motion={kind: feedforward}",
        ),
        (RESYNCHRONISED | {"coupling": 6.0}, "coupling (6 ms)", "no further compensation"),
    ],
)
def test_what_is_advised_takes_out_the_largest_delay_that_no_compensation_takes_out(
    ledger: dict[str, float], largest: str, advised: str
) -> None:
    entries = [{"source": name, "delay": 1e-3 * delay} for name, delay in ledger.items()]
    total = {"source": "total", "delay": 1e-3 * sum(ledger.values())}
    (first, *_) = assess(_made(0.2, delay_ledger=[*entries, total])).advice
    assert advised in first
    assert f"the largest is {largest}" in first


@pytest.mark.parametrize(("made", "advised"), [(0.2, True), (0.001, False)])
def test_a_lag_that_counts_on_later_touches_is_advised_on(made, advised) -> None:
    ways = [{"direction": "along the normal of a later touch", "rig_energy": made}]
    total = {"source": "total", "delay": 0.0, "equivalent_damping": 0.0}
    run = _made(
        0.1,
        stability={"stable": True, "verdict": "stable", "directions": ways},
        delay_ledger=[total],
    )
    assert any("feedforward" in advice for advice in assess(run).advice) is advised


def test_what_holds_from_the_start_is_measured_by_what_its_spring_stores() -> None:
    """A ring-down has next to no energy of approach: what the rig makes is set against F^2/(2 k) at
    the peak, or against the approach.
    """
    run = simulated(load_scenario("13-ring-down", {"duration": 0.3}))
    contact, mount = run.scenario.mechanism.contact, run.scenario.mechanism.mount
    compliance = 1.0 / contact.stiffness + 1.0 / mount.stiffness[2]
    stored = 0.5 * compliance * run.summary["peak_force"] ** 2
    speed = math.dist(run.scenario.approach.velocity, (0.0, 0.0, 0.0))
    assert run.summary["energy_reference"] == pytest.approx(
        max(stored, 0.5 * effective_mass(run.scenario.spacecraft) * speed**2)
    )
