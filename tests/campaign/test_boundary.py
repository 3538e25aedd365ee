"""Closed forms of the stability boundary, against each other and against the loop."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hiltestbed.analysis.spring_damper import SpringDamper
from hiltestbed.campaign.figures import boundary_applies as applies
from hiltestbed.campaign.figures import boundary_margin as margin
from hiltestbed.scenario import Scenario, scenario_from
from hiltestbed.simulation import run_batch
from tests.slow import SLOW


@pytest.mark.parametrize(
    ("w_tau", "e"), [(0.063, 1.104), (0.126, 1.217), (0.251, 1.474), (0.503, 2.102), (1.005, 3.743)]
)
def test_without_damping_it_is_the_table_of_independent_simulations(w_tau: float, e: float) -> None:
    """Made with steps of 10 us; w tau is given to three digits, which is 1e-3 of e."""
    assert SpringDamper(1.0, 0.0, 1.0).late_cor(w_tau) == pytest.approx(e, rel=1e-3)


@pytest.mark.parametrize("zeta", [0.02, 0.05, 0.1])
def test_a_bounce_that_cannot_pull_is_neutral_earlier_by_the_missing_pull(zeta: float) -> None:
    """Leaving at v0, the force would pull from x = c v0/k to 0, an impulse of c^2 v0/(2 k): 2
    zeta^2 in e, so 4 zeta^2/pi in w tau.
    """
    contact = SpringDamper(1.0, 2 * zeta, 1.0)
    earlier = contact.critical_delay - contact.neutral_delay
    assert earlier == pytest.approx(4 * zeta**2 / math.pi, rel=0.1)


def scenario(delay: float, damping: float) -> Scenario:
    body = {"mass": 100.0, "inertia": [10.0, 10.0, 10.0]}
    return scenario_from(
        {
            "name": "boundary",
            "duration": 0.6,
            "rate": 8000,
            "physics_rate": 8000,
            "spacecraft": {"chaser": body, "target": body},
            "approach": {"gap": 0.001, "velocity": [0, 0, 0.05]},
            "mechanism": {"contact": {"stiffness": 5.0e3, "damping": damping}},
            "rig": {"platform": {"tracking": "ideal"}},
            "sensor": {"delay": delay},
            "compensation": {"force": {"kind": "none"}},
            "identification": {"kind": "none"},
        }
    )


def test_the_loop_returns_the_speed_it_came_with_on_the_boundary() -> None:
    """mu = 50 kg and k = 5 kN/m: w = 10 rad/s. A delay off by 2 % would show as 0.02 (pi/2) w tau
    in ln e; a fifth of it is asked.
    """
    zetas = np.array([0.05, 0.1, 0.2])
    dampings = 2 * zetas * math.sqrt(5.0e3 * 50.0)
    delays = [SpringDamper(5.0e3, damping, 50.0).neutral_delay for damping in dampings]
    runs = run_batch(
        [scenario(delay, damping) for delay, damping in zip(delays, dampings, strict=True)]
    )
    for run, delay in zip(runs, delays, strict=True):
        assert abs(math.log(run.summary["cor"])) < 0.004 * 0.5 * math.pi * 10.0 * delay


@SLOW
def test_a_contact_that_stays_closed_grows_past_its_boundary_and_dies_before_it() -> None:
    """Latched, so that it pulls too: 1 % of delay on either side tells, up to w tau = 0.5."""
    zeta = 0.25
    damping = 2 * zeta * math.sqrt(5.0e3 * 50.0)
    delay = SpringDamper(5.0e3, damping, 50.0).critical_delay
    closed = {
        "mechanism.kind": "latched",
        "approach.gap": 0.0,
        "duration": 8.0,
        "rate": 4000,
        "physics_rate": 4000,
    }
    runs = run_batch(
        [
            scenario_from(scenario(f * delay, damping).model_dump(mode="json"), closed)
            for f in (0.99, 1.01)
        ],
        trace=True,
    )
    growth = []
    for run in runs:
        assert run.trace is not None
        force = np.abs(run.trace["wrench_true"][:, 2])
        first, last = force[4000:12000].max(), force[-8000:].max()  # two seconds hold three periods
        growth.append(math.log(last / first))
    assert growth[0] < 0.0 < growth[1]
    # the boundary lies midway between the two
    assert growth[0] == pytest.approx(-growth[1], rel=0.2)


def test_margins_are_delays_beyond_the_boundaries_and_only_where_they_apply() -> None:
    damping = 2 * 0.1 * math.sqrt(5.0e3 * 50.0)
    on_it = scenario(SpringDamper(5.0e3, damping, 50.0).neutral_delay, damping)
    closed, bounce = margin(on_it)
    assert bounce == pytest.approx(0.0, abs=1e-12)
    assert closed < 0.0
    later = scenario_from(
        on_it.model_dump(mode="json"), {"effects": [{"kind": "sensor.delay", "delay": 0.002}]}
    )
    assert margin(later)[1] == pytest.approx(0.002, abs=1e-12)
    assert applies(later)
    assert not applies(scenario_from(on_it.model_dump(mode="json"), {"sensor.lowpass": 100.0}))
    assert not applies(
        scenario_from(on_it.model_dump(mode="json"), {"compensation.force": {"kind": "phase_lead"}})
    )
