"""The bounce of a spring and a damper in closed form: against small steps, MuJoCo and the loop at its
stability boundary; `hiltestbed contact`, and an MJCF pair measured by a drop."""

from __future__ import annotations

import cmath
import json
import math
from pathlib import Path

import numpy as np
import pytest

from hiltestbed.analysis.mujoco_contact import (
    PairParameters,
    bounce_in_mujoco,
    mujoco_parameters,
    pair_in_mjcf,
    positive_solref,
    spring_damper_of,
)
from hiltestbed.analysis.other_engines import cor_in_drake, cor_in_newton
from hiltestbed.analysis.spring_damper import SpringDamper, reduced_mass, with_cor
from hiltestbed.campaign.figures import boundary_applies as applies
from hiltestbed.campaign.figures import boundary_margin as margin
from hiltestbed.scenario import Scenario, scenario_from
from hiltestbed.simulation import run_batch
from tests.slow import SLOW

SPEED = 0.03
DEFAULT_IMPEDANCE = (0.9, 0.9, 0.001, 0.5, 1.0)
PAIR = """<mujoco>
  <compiler angle="radian"/>
  <option gravity="0 0 -9.81" timestep="0.002"/>
  <default><geom solref="-4000 -20" solimp="0.5 0.5 0.001 0.5 1"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 0.1"/>
    <body pos="0 0 1" euler="0.3 0 0"><freejoint/>
      <geom name="ball" type="sphere" size="0.1" mass="3"/>
      <body pos="0.5 0 0"><geom name="tip" type="sphere" size="0.1" mass="2"/></body>
    </body>
    <body pos="1 0.5 1"><freejoint/><geom name="other" type="sphere" size="0.1" mass="20"/></body>
  </worldbody>
  <contact><pair geom1="ball" geom2="other" solref="-900 -3" solimp="0.5 0.5 0.001 0.5 1"/></contact>
</mujoco>
"""


@pytest.mark.parametrize("masses", [(1.0, 1.0), (1.0, 100.0), (5e4, 500.0), (10.0, math.inf)])
@pytest.mark.parametrize("cor", [0.1, 0.5, 0.9, 1.0])
@pytest.mark.parametrize("stiffness", [1e3, 1e5, 1e7])
def test_solref_is_the_spring_and_damper_that_a_drop_shows(
    stiffness: float, cor: float, masses: tuple[float, float]
) -> None:
    asked = with_cor(stiffness, cor, reduced_mass(*masses))
    positive = positive_solref(asked)
    forms = [mujoco_parameters(asked)]
    forms += [PairParameters(positive, DEFAULT_IMPEDANCE)] if positive else []
    for parameters in forms:
        drop = bounce_in_mujoco(parameters, masses, SPEED)
        assert drop.stiffness == pytest.approx(stiffness, rel=1e-3)
        assert drop.damping == pytest.approx(asked.damping, rel=1e-3, abs=1e-3)
        # 2,000 semi-implicit steps of a contact: half a step at the touch and at the parting
        assert drop.cor == pytest.approx(cor, abs=1e-3)
        assert drop.force.max() == pytest.approx(asked.peak_force(SPEED), rel=2e-3)
        # the touch falls anywhere within a step
        deepest = pytest.approx(asked.penetration(SPEED), rel=2e-3, abs=SPEED * drop.step)
        assert drop.penetration.max() == deepest
        back = spring_damper_of(parameters.solref, asked.mass)
        assert back.stiffness == pytest.approx(stiffness, rel=1e-9)
        assert back.damping == pytest.approx(asked.damping, rel=1e-9, abs=1e-9)


def test_a_heavy_body_on_a_soft_contact_does_not_fall_through_the_plate() -> None:
    """It goes 0.7 m deep, more than the ball's radius."""
    asked = with_cor(1e3, 1.0, 1e4)
    drop = bounce_in_mujoco(mujoco_parameters(asked), (2e4, 2e4), 0.2268)
    assert drop.penetration.max() == pytest.approx(asked.penetration(0.2268), rel=2e-3)
    assert drop.stiffness == pytest.approx(1e3, rel=1e-3)


@pytest.mark.parametrize("ratio", [0.05, 0.3, 0.8, 1.0, 3.0])
def test_the_bounce_in_closed_form_is_that_of_small_steps(ratio: float) -> None:
    contact = SpringDamper(1e5, ratio * 2.0 * math.sqrt(1e5 * 400.0), 400.0)
    step = contact.contact_time / 100_000
    x, v, forces, depth = 0.0, SPEED, [], []
    for k in range(1_000_000):
        force = contact.stiffness * x + contact.damping * v
        if k and force <= 0.0:
            break
        v -= force / contact.mass * step
        x += v * step
        forces.append(force)
        depth.append(x)
    assert -v / SPEED == pytest.approx(contact.cor, rel=1e-3)
    assert len(forces) * step == pytest.approx(contact.contact_time, rel=1e-3)
    assert max(forces) == pytest.approx(contact.peak_force(SPEED), rel=1e-3)
    assert max(depth) == pytest.approx(contact.penetration(SPEED), rel=1e-3)
    # at the limit of a latched contact the characteristic equation has a root on the imaginary axis
    k, c, m, late = contact.stiffness, contact.damping, contact.mass, contact.critical_delay
    w = math.sqrt((c * c + math.sqrt(c**4 + 4.0 * m * m * k * k)) / (2.0 * m * m))
    assert abs(-m * w * w + (k + 1j * c * w) * cmath.exp(-1j * w * late)) < 1e-9 * m * w * w
    assert contact.late_cor(contact.neutral_delay) == pytest.approx(1.0, abs=1e-3)


def test_the_largest_step_is_that_of_mujoco() -> None:
    contact = with_cor(1e5, 0.7, 400.0)
    step = contact.largest_step(0.01)
    assert contact.stepped_errors(step).max() == pytest.approx(0.01, rel=0.1)
    found = bounce_in_mujoco(mujoco_parameters(contact), (500.0, 2000.0), SPEED, step)
    # its touch falls somewhere within a step
    errors = contact.stepped_errors(step)
    assert errors.min() - 1e-3 <= abs(found.cor / contact.cor - 1.0) <= errors.max() + 1e-3


def test_other_engines_bounce_by_their_own_law() -> None:
    pytest.importorskip("pydrake")
    pytest.importorskip("newton")
    contact, masses = with_cor(1e5, 0.85, 400.0), (500.0, 2000.0)
    step = contact.contact_time / 1000
    assert cor_in_drake(contact, masses, SPEED, step) == pytest.approx(contact.cor, rel=5e-3)
    # damped until the deepest point only: half of ln e, to first order in the damping
    found = cor_in_newton(contact, masses, SPEED, step)
    assert math.log(found) == pytest.approx(0.5 * math.log(contact.cor), rel=0.05)


def test_a_pair_of_an_mjcf_is_measured_in_its_own_contact(tmp_path: Path) -> None:
    file = tmp_path / "pair.xml"
    file.write_text(PAIR)
    # by MuJoCo's definition K = -solref[0] mu; a child body moves with its parent
    for geoms, masses, solref in (
        (("tip", "floor"), (5.0, math.inf), (4000.0, 20.0)),
        (("other", "tip"), (20.0, 5.0), (4000.0, 20.0)),
        (("ball", "other"), (5.0, 20.0), (900.0, 3.0)),
    ):
        drop, found = pair_in_mjcf(file, geoms, None, SPEED)
        mass = reduced_mass(*masses)
        assert found == pytest.approx(masses)
        assert drop.stiffness == pytest.approx(solref[0] * mass, rel=1e-3)
        assert drop.damping == pytest.approx(solref[1] * mass, rel=1e-3)
        assert drop.misfit < 1e-3
    # the default solimp grows with the penetration: no spring and damper
    file.write_text(PAIR.replace('solimp="0.5 0.5 0.001 0.5 1"', 'solimp="0.5 0.95 0.001 0.5 1"'))
    assert pair_in_mjcf(file, ("tip", "floor"), None, SPEED)[0].misfit > 0.005


def test_the_command_prints_one_object_or_one_page(call, tmp_path: Path) -> None:
    numbers = ("contact", "--k", "1e5", "--cor", "0.85", "--masses", "500,2000")
    status, out, _ = call(*numbers, "--engine", "mujoco", "--json")
    found = json.loads(out)
    assert status == 0
    assert found["cor"] == pytest.approx(0.85)
    assert found["solref"] == pytest.approx([-250.0, -found["damping"] / 400.0])
    assert abs(found["engines"]["mujoco"]["cor_log_error"]) < 1.1e-3  # a step for 0.1 %
    status, out, _ = call(*numbers, "--out", str(tmp_path / "page"))
    assert status == 0
    assert "report.html" in out
    assert json.loads((tmp_path / "page" / "contact.json").read_text())["cor"] == found["cor"]
    assert (tmp_path / "page" / "report.html").read_text().count("<img") == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--k", "1e5", "--masses", "500,2000"), "--c or --cor"),
        (("--k", "1e5", "--cor", "1.2", "--masses", "1,1"), "at most 1"),
        (("--k", "-1", "--c", "1", "--masses", "1,1"), "--k: must be above 0"),
        (("--k", "1e5", "--c", "1", "--masses", "500"), "two numbers"),
        (("--k", "1e5", "--c", "1", "--masses", "inf,inf"), "one of them finite"),
        (("--solref", "0.02,-1", "--masses", "1,1"), "neither two positive"),
        (("--mjcf", "none.xml"), "go together"),
        (("--mjcf", "none.xml", "--geom", "a", "b"), "none.xml: does not compile"),
        (("--k", "1e5", "--c", "1", "--masses", "1,1", "--engine", "odd"), "allowed are"),
    ],
)
def test_what_cannot_be_is_said(call, arguments: tuple[str, ...], words: str) -> None:
    status, out, err = call("contact", *arguments)
    assert (status, out) == (2, "")
    assert words in err


def test_geoms_that_do_not_touch_and_names_are_said(call, tmp_path: Path) -> None:
    file = tmp_path / "pair.xml"
    file.write_text(PAIR)
    status, _, err = call("contact", "--mjcf", str(file), "--geom", "ball", "flor")
    assert status == 2
    assert "allowed are floor, ball, tip, other" in err
    assert np.isfinite(pair_in_mjcf(file, ("ball", "floor"), (1.0, math.inf), SPEED)[0].cor)


@pytest.mark.parametrize("zeta", [0.05, 0.1, 0.2, 0.4])
def test_without_delay_a_stepped_bounce_is_the_closed_form(zeta: float) -> None:
    contact = SpringDamper(1.0, 2 * zeta, 1.0)
    assert contact.late_cor(0.0) == pytest.approx(contact.cor, rel=1e-3)


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
