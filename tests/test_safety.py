"""Each safety limit, passed on purpose, ends the run in the tick in which it is passed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hiltestbed.platform.pss33.kinematics import inverse, shipped_limbs
from hiltestbed.scenario import Scenario
from hiltestbed.supervision.safety import LIMITS
from tests.running import run, shipped

UNWATCHED: dict[str, Any] = {f"safety.{limit}": None for limit in LIMITS}


def _bumper(**changes: Any) -> Scenario:
    changes = {key.replace("__", "."): value for key, value in changes.items()}
    return shipped("03-bumper-delay-uncompensated", UNWATCHED | {"sensor.noise": 0.0} | changes)


def _stopped_at(scenario: Scenario, quantity: str) -> int:
    result = run(scenario)
    assert result.summary["status"] == "stopped"
    assert f"safety.{quantity}" in result.summary["stop_reason"]
    assert result.trace is not None
    return len(result.trace.t) - 1


def _first(passed: np.ndarray) -> int:
    assert passed.any()
    return int(np.argmax(passed))


@pytest.fixture(scope="module")
def free_run():
    """The run that nothing stops: a limit's tick is where this one passes it."""
    result = run(_bumper())
    assert result.summary["status"] == "completed"
    assert result.trace is not None
    return result.trace


def test_force(free_run) -> None:
    tick = _first(np.linalg.norm(free_run["wrench_true"][:, :3], axis=1) > 150.0)
    assert abs(_stopped_at(_bumper(safety__force=150.0), "force") - tick) <= 1


def test_torque() -> None:
    centred = _bumper(approach__offset=[0.1, 0.0], safety__torque=15.0)  # 15 N m at 0.1 m: 150 N
    free = run(_bumper(approach__offset=[0.1, 0.0])).trace
    assert free is not None
    tick = _first(np.linalg.norm(free["wrench_true"][:, 3:], axis=1) > 15.0)
    assert abs(_stopped_at(centred, "torque") - tick) <= 1


def test_stroke(free_run) -> None:
    tick = _first(np.abs(free_run["slider_act"]).max(axis=1) > 0.012)
    assert tick > 100
    assert _stopped_at(_bumper(safety__stroke=0.012), "stroke") == tick


def test_speed(free_run) -> None:
    # between the approach (0.0300 m/s) and the rebound (0.0308 m/s) of the uncompensated bumper
    limit = 0.0305
    speed = np.abs(np.diff(free_run["slider_act"], axis=0)).max(axis=1) * 2000.0
    assert _stopped_at(_bumper(safety__speed=limit), "speed") == _first(speed > limit) + 1


def test_acceleration(free_run) -> None:
    limit = 0.3  # the peak is 190 N/400 kg = 0.48 m/s^2
    acceleration = np.abs(np.diff(free_run["slider_act"], 2, axis=0)).max(axis=1) * 2000.0**2
    assert (
        _stopped_at(_bumper(safety__acceleration=limit), "acceleration")
        == _first(acceleration > limit) + 2
    )


def test_tracking_error() -> None:
    """Without feed-forward the platform trails behind."""
    scenario = _bumper(safety__tracking_error=1e-5, compensation__motion={"kind": "none"})
    assert _stopped_at(scenario, "tracking_error") < 400


def test_limb_angle() -> None:
    """A sideways drift x leans vertical links of L = 1.1 m: sin(angle) = x/L."""
    scenario = _bumper(
        approach__gap=0.01, approach__velocity=[0.2, 0.0, 0.0], safety__limb_angle_deg=8.0
    )
    tick = _stopped_at(scenario, "limb_angle_deg")
    assert 0.2 * tick / 2000.0 == pytest.approx(1.1 * np.sin(np.radians(8.0)), abs=1e-3)


def test_energy(free_run) -> None:
    """5 ms make (pi/2) w tau times twice the kinetic energy, 0.18 J, in all: some 0.05 J."""
    tick = _stopped_at(_bumper(safety__energy=0.02), "energy")
    stopped = _bumper(safety__energy=0.02)
    assert stopped.ticks > tick
    touch = _first(free_run.contact)
    assert touch < tick < touch + 400


def test_a_diverging_docking_is_stopped_by_its_energy_before_its_force() -> None:
    """A stiff contact and 20 ms: w tau = 1. The energy limit is a tenth of the kinetic energy, the
    force limit the undelayed peak.
    """
    kinetic, w = 0.5 * 400.0 * 0.03**2, np.sqrt(1.0e6 / 400.0)
    stiff = {"mechanism__contact__stiffness": 1.0e6, "sensor__delay": 0.02}
    peak = 400.0 * 0.03 * w
    scenario = _bumper(safety__energy=0.1 * kinetic, safety__force=peak, **stiff)
    assert run(_bumper(**stiff)).summary["peak_force"] > 1.3 * peak
    result = run(scenario)
    assert result.summary["status"] == "stopped"
    assert "safety.energy" in result.summary["stop_reason"]


def test_the_kinematics_of_the_watch_are_those_of_the_platform() -> None:
    sliders = np.zeros((1, 6))
    home = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    inverse(shipped_limbs(), home, sliders)
    np.testing.assert_allclose(sliders, 0.0, atol=1e-9)
