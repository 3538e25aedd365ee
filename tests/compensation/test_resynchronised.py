"""Resynchronised prediction: the numerical model moves as it would without a delay."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hiltestbed import load_scenario, run
from hiltestbed.bench.contacts import BenchContact, bounce, grid
from hiltestbed.bench.hildock.methods import shipped
from hiltestbed.bench.hildock.problem import DRIFT, TICK, cases, play
from hiltestbed.numerical_model.model import NumericalModel
from hiltestbed.scenario import Scenario
from hiltestbed.simulation import log_error, reference_scenario, simulate


def _known(contact: BenchContact) -> dict[str, object]:
    return {
        "kind": "resynchronised",
        "contact": {"stiffness": contact.stiffness, "damping": contact.damping},
    }


def _errors(scenarios: list[Scenario]) -> np.ndarray:
    result, reference = bounce(scenarios), bounce([reference_scenario(s) for s in scenarios])
    errors = [
        log_error(a.cor, b.cor) for a, b in zip(result.figures, reference.figures, strict=True)
    ]
    assert None not in errors
    return np.abs(np.array(errors, dtype=float))


CONTACTS = {
    # 1 to 8 Hz, 2 to 20 ms, damping ratio 0.02 to 0.2, noise 0.2 % of the peak force
    "of the measured wrench alone": (grid(), 0.003),
    "under a servo": (
        grid((1.0, 4.0, 8.0), (0.002, 0.02), damping_ratios=(0.05,), tracking="servo"), 0.01
    ),
    # a fiftieth of a tick of delay left would show as (pi/2) w h/50 = 4e-4
    "between two ticks": (
        [BenchContact(4.0, delay, 0.05, noise=0.0) for delay in (0.00001, 0.00537, 0.01713)], 4e-4
    ),
    # 2.7 ms more: (pi/2) w 2.7 ms = 0.10
    "behind a low-pass": ([BenchContact(4.0, 0.005, 0.05, changes={"sensor.lowpass": 60.0})], 0.01),
}  # fmt: skip


@pytest.mark.parametrize("what", CONTACTS)
def test_a_first_contact_rebounds_as_without_delay(what: str) -> None:
    contacts, within = CONTACTS[what]
    assert _errors([c.scenario({"kind": "resynchronised"}) for c in contacts]).max() < within


def test_a_known_contact_rebounds_as_without_delay() -> None:
    contacts = grid(damping_ratios=(0.05,))
    assert _errors([c.scenario(_known(c)) for c in contacts]).max() < 0.003


def test_a_platform_that_lags_by_8_ms_does_not_matter() -> None:
    """Position loop of 40 Hz: uncorrected it would leave (pi/2) w 8 ms = 0.31 at 4 Hz."""
    contacts = [BenchContact(f, 0.005, 0.05, tracking="servo") for f in (1.0, 2.0, 4.0)]
    scenarios = [c.scenario({"kind": "resynchronised"}, motion="none") for c in contacts]
    assert _errors(scenarios).max() < 0.01


def test_a_delay_that_is_off_is_found() -> None:
    """Between two steps of the physics the force may set in at any instant: the delay is known to
    half such a step, which leaves (pi/2) w h/4 and the noise; the lead is left with the 20 %.
    """
    contacts = grid((2.0, 8.0), (0.01, 0.02), damping_ratios=(0.05,), delay_knowledge="off")
    ours = _errors([c.scenario({"kind": "resynchronised"}) for c in contacts])
    lead = _errors([c.scenario({"kind": "phase_lead"}) for c in contacts])
    limits = np.array([0.5 * math.pi * c.w * 0.000125 + 0.005 for c in contacts])
    assert (ours < limits).all()
    assert (ours < 0.1 * lead).all()


def test_a_low_pass_that_nobody_told_of_is_found() -> None:
    """2 ms at 4 Hz would leave (pi/2) w 2 ms = 0.08; with the delay and the filter as told it
    does.
    """
    effect = {"kind": "sensor.lag", "time_constant": 0.002}
    contact = BenchContact(4.0, 0.01, 0.05, changes={"effects": [effect]})
    found, told = (
        _errors([contact.scenario({"kind": "resynchronised", "delay": delay})])[0]
        for delay in ("estimate", "known")
    )
    assert found < 0.01 < 0.03 < told


@pytest.mark.parametrize("off", [1.2, 2.0])
def test_the_interval_of_a_delay_holds_the_true_one(off: float) -> None:
    """Told is 1/off of the true delay; the contact refuses it, and the run says so."""
    true = 0.0102
    effect = {"kind": "sensor.delay", "delay": true * (1.0 - 1.0 / off)}
    contact = BenchContact(
        4.0, true, 0.05, changes={"sensor.delay": true / off, "effects": [effect]}
    )
    found = run(contact.scenario({"kind": "resynchronised"}))
    late = found.summary["force_delay"]
    assert late["told"] == pytest.approx(true / off)
    assert abs(late["estimated"] - true) < late["half_width"] + 1e-5  # [s] a search's resolution
    assert late["half_width"] < 0.0005
    assert any("the contact refused them" in warning for warning in found.assessment.warnings)


def test_the_interval_of_a_delay_holds_a_drift_that_was_not_worth_an_unknown() -> None:
    """HILDOCK's drifts of 20 ms at 2 Hz: at the end of the contact the delay is 1.2 ms longer than
    told; half of it is found at the touch.
    """
    entrant = next(e for e in shipped() if e.name == "shipped resynchronised")
    mine = [
        c
        for c in cases()
        if (c.track, c.frequency, c.delay) == ("drift", 2.0, 0.02) and c.damping_ratio < 0.1
    ]
    assert len(mine) == 2
    for case in mine:
        course = play(case, entrant)
        end = max(k for k, force in enumerate(course.force) if force > 0.0) + case.delay / TICK
        true = case.delay * (1.0 + DRIFT * end / case.ticks)
        drive = entrant._drive
        assert 0.0004 < true - drive.delay[0] < drive.delay_half_width[0] < 0.002


def test_a_known_contact_need_not_touch_at_zero() -> None:
    """Told where it touches, a millimetre early, the fit refuses neither that nor the delay."""
    early = {"kind": "contact.touch_offset", "offset": 0.001}
    contact = BenchContact(4.0, 0.01, 0.05, changes={"effects": [early]})
    known = {"stiffness": contact.stiffness, "damping": contact.damping, "touch": 0.001}
    found = run(contact.scenario({"kind": "resynchronised", "contact": known})).summary
    assert found["force_delay"] == {"told": 0.01, "estimated": 0.01, "half_width": 0.0}
    assert abs(found["cor_log_error"]) < 0.003  # of a known contact that touches at zero


def test_a_delay_that_is_right_stands_to_the_byte() -> None:
    """What the contact does not refuse is not touched: as if the delay were known."""
    contacts = grid((2.0, 8.0), (0.005, 0.02), damping_ratios=(0.05,))
    traces = []
    for delay in ("known", "estimate"):
        scenarios = [c.scenario({"kind": "resynchronised", "delay": delay}) for c in contacts]
        trace = simulate(scenarios, trace=True).trace
        traces.append(trace["pose_cmd"])
    assert np.array_equal(*traces, equal_nan=True)


@pytest.mark.parametrize("friction", [0.0, 0.2])
def test_beside_the_axis_both_bodies_leave_as_without_delay(friction: float) -> None:
    """Tilted, turning, sliding at w tau = 0.48: 1 % of each velocity's change is wrong at most."""
    changes = {
        "sensor.delay": 0.03,
        "mechanism.contact.friction": friction,
        "compensation.force.kind": "resynchronised",
    }
    scenario = load_scenario("05-off-centre", set=changes | {"rig.platform.tracking": "ideal"})
    result, reference = bounce([scenario]), bounce([reference_scenario(scenario)])
    assert result.figures[0].cor is not None
    change = np.linalg.norm((reference.velocity - reference.start).reshape(4, 3), axis=1)
    error = np.linalg.norm((result.velocity - reference.velocity).reshape(4, 3), axis=1)
    assert (error < 0.01 * change).all()


def test_the_wrench_that_is_recorded_explains_the_commanded_motion() -> None:
    """wrench_comp through a numerical model of its own gives pose_cmd, to the bit."""
    scenario = load_scenario(
        "05-off-centre", set={"compensation.force.kind": "resynchronised", "duration": 0.6}
    )
    trace = simulate([scenario], trace=True).trace
    craft = NumericalModel([scenario])
    for k in range(scenario.ticks):
        craft.advance(trace["wrench_comp"][k])
        assert np.array_equal(craft.pose, trace["pose_cmd"][k])


def test_free_flight_is_undisturbed_by_noise() -> None:
    """Out of contact the noise does not push the numerical model: not a bit of it."""
    changes = {
        "rig.platform.tracking": "ideal",
        "duration": 0.5,
        "compensation.force.kind": "resynchronised",
    }
    quiet, noisy = (
        simulate(
            [load_scenario("01-free-flight", set=changes | {"sensor.noise": noise})], trace=True
        ).trace
        for noise in (0.0, 1.0)
    )
    assert noisy["wrench_meas"].std() > 0.1
    assert np.array_equal(quiet["pose_cmd"], noisy["pose_cmd"])
