"""From the numerical model's motion to the platform."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hiltestbed import load_scenario, run
from hiltestbed.bench.contacts import BenchContact, bounce
from hiltestbed.compiled.state import arrays_of
from hiltestbed.scenario import Scenario
from hiltestbed.simulation import log_error, reference_scenario

BARE = {"kind": "none"}


def _with(
    contact: BenchContact, motion: dict[str, object], force: dict[str, object] | None = None
) -> Scenario:
    return replace(contact, changes={"compensation.motion": motion}).scenario(force or BARE)


def _error(scenario: Scenario) -> float:
    error = log_error(
        bounce([scenario]).figures[0].cor, bounce([reference_scenario(scenario)]).figures[0].cor
    )
    assert error is not None
    return error


@pytest.mark.parametrize(
    "motion",
    [
        {"kind": "feedforward"},
        {"kind": "inverse_model", "order": 1},
        {"kind": "inverse_model", "order": 2},
        {"kind": "adaptive_time_series"},
    ],
)
def test_the_lag_of_the_platform_is_taken_out(motion: dict[str, object]) -> None:
    """2 zeta/w of the position loop, 8 ms, would leave (pi/2) w 8 ms = 0.16 at 2 Hz."""
    contact = BenchContact(2.0, 0.0, 0.05, tracking="servo")
    bare = _error(_with(contact, {"kind": "none"}))
    assert bare == pytest.approx(0.5 * math.pi * contact.w * 2.0 / (2.0 * math.pi * 40.0), rel=0.05)
    assert abs(_error(_with(contact, motion))) < 0.02 * bare


def test_correcting_the_force_makes_up_for_a_lagging_platform() -> None:
    contact = BenchContact(2.0, 0.0, 0.05, tracking="servo")
    assert abs(_error(_with(contact, {"kind": "contact_correction"}))) < 0.1 * _error(
        _with(contact, {"kind": "none"})
    )


def test_after_a_contact_noise_is_not_corrected_for_the_lag() -> None:
    """Half of all noise reads as a push: times k and a lag of 1 mm it pulled the vehicles by up to
    90 N, long after they had parted.
    """
    result = run(load_scenario("26-force-compensation"))
    # 20 ms: the delay of 5 ms, and the memory of the lead
    apart = np.flatnonzero(result.trace.contact.ravel())[-1] + 40
    used = result.trace.data["wrench_comp"].reshape(-1, 6)[apart:, 2]
    assert len(used) > 500
    assert np.abs(used).max() < 15.0, "the lead of the noise of 0.38 N, and nothing else"
    last = -float(result.trace.data["twist_cmd"][-1].ravel()[2]) / 0.03
    assert result.summary["cor"] == pytest.approx(last, abs=2e-3)


def test_the_adaptive_series_finds_the_platforms_response() -> None:
    """A position loop 1/(1 + s/w)^2 at 40 Hz: a0 = 1, a1 = 2/w = 8.0 ms, from a start of 4 ms."""
    contact = BenchContact(
        2.0,
        0.0,
        0.05,
        tracking="servo",
        changes={"compensation.motion": {"kind": "adaptive_time_series", "delay": 0.004}},
    )
    result = bounce([contact.scenario(BARE)])
    found = arrays_of(result.loop.motion)["_method.coefficients"][0]
    assert found[0] == pytest.approx(1.0, abs=0.01)
    assert found[1] == pytest.approx(2.0 / (2.0 * math.pi * 40.0), rel=0.05)


@pytest.mark.parametrize("tracking", ["ideal", "servo"])
@pytest.mark.parametrize("kind", ["phase_lead", "resynchronised"])
def test_a_compliant_platform_holds_the_peak_force(tracking: str, kind: str) -> None:
    contact = BenchContact(4.0, 0.005, 0.05, tracking=tracking)
    limit = 0.6 * contact.peak
    free = bounce([contact.scenario({"kind": kind})]).figures[0]
    yielding = {"kind": "admittance", "limit": limit}
    held = bounce([_with(contact, yielding, {"kind": kind})]).figures[0]
    assert free.peak_force > 1.5 * limit
    assert 0.85 * limit < held.peak_force <= limit


def test_the_numerical_model_need_not_notice_that_the_platform_yields() -> None:
    """The force is corrected for the platform's place: the rebound is that without a limit."""
    contact = BenchContact(4.0, 0.005, 0.05)
    yielding = {"kind": "admittance", "limit": 0.6 * contact.peak}
    assert abs(_error(_with(contact, yielding, {"kind": "resynchronised"}))) < 0.003


def test_feed_forward_tells_the_velocity_of_the_tick() -> None:
    result = bounce([BenchContact(4.0, 0.0, 0.05, tracking="servo").scenario(BARE)], trace=True)
    told, reached = (result.trace[name][: result.loop.k, 0, 2] for name in ("pose_cmd", "pose_act"))
    assert np.abs(told[:-1] - reached[1:]).max() < 0.02 * np.abs(told).max()
