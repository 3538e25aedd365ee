"""Each safety limit, passed on purpose, ends the run in the tick in which it is passed."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest

from hiltestbed.scenario import Scenario
from hiltestbed.signals import RunTrace
from hiltestbed.supervision.safety import LIMITS
from tests.running import run, shipped

RATE = 2000.0
UNWATCHED: dict[str, Any] = {f"safety.{limit}": None for limit in LIMITS}
OFF_AXIS = {"approach.offset": [0.1, 0.0]}


def _bumper(changes: dict[str, Any]) -> Scenario:
    return shipped("03-bumper-delay-uncompensated", UNWATCHED | {"sensor.noise": 0.0} | changes)


def _stopped_at(limit: str, value: float, changes: dict[str, Any]) -> int:
    result = run(_bumper(changes | {f"safety.{limit}": value}))
    assert result.summary["status"] == "stopped"
    assert f"safety.{limit}" in result.summary["stop_reason"]
    return len(result.trace.t) - 1


@cache
def _free(off_axis: bool) -> RunTrace:
    """The run that nothing stops: a limit's tick is where this one passes it."""
    result = run(_bumper(OFF_AXIS if off_axis else {}))
    assert result.summary["status"] == "completed"
    assert result.trace is not None
    return result.trace


def _wrench(part: slice) -> Callable[[RunTrace], np.ndarray]:
    return lambda trace: np.linalg.norm(trace["wrench_true"][:, part], axis=1)


def _sliders(order: int) -> Callable[[RunTrace], np.ndarray]:
    """The largest of them, or of their difference quotients, at each tick."""

    def largest(trace: RunTrace) -> np.ndarray:
        quotients = np.diff(trace["slider_act"], order, axis=0) * RATE**order
        return np.concatenate([np.zeros(order), np.abs(quotients).max(axis=1)])

    return largest


@pytest.mark.parametrize(
    ("limit", "value", "quantity", "slack"),
    [
        ("force", 150.0, _wrench(slice(3)), 1),
        ("torque", 15.0, _wrench(slice(3, 6)), 1),  # at 0.1 m: 150 N
        ("stroke", 0.012, _sliders(0), 0),
        # between approach (0.0300 m/s) and rebound (0.0308 m/s) of the uncompensated bumper
        ("speed", 0.0305, _sliders(1), 0),
        ("acceleration", 0.3, _sliders(2), 0),  # the peak is 190 N/400 kg = 0.48 m/s^2
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_the_run_ends_where_it_passes(
    limit: str, value: float, quantity: Callable[[RunTrace], np.ndarray], slack: int
) -> None:
    off_axis = limit == "torque"
    passed = quantity(_free(off_axis)) > value
    assert passed.any()
    tick = int(np.argmax(passed))
    assert tick > 100
    assert abs(_stopped_at(limit, value, OFF_AXIS if off_axis else {}) - tick) <= slack


def test_tracking_error() -> None:
    """Without feed-forward the platform trails behind."""
    assert _stopped_at("tracking_error", 1e-5, {"compensation.motion": {"kind": "none"}}) < 400


def test_limb_angle() -> None:
    """A sideways drift x leans vertical links of L = 1.1 m: sin(angle) = x/L."""
    drift = {"approach.gap": 0.01, "approach.velocity": [0.2, 0.0, 0.0]}
    tick = _stopped_at("limb_angle_deg", 8.0, drift)
    assert 0.2 * tick / RATE == pytest.approx(1.1 * np.sin(np.radians(8.0)), abs=1e-3)


def test_energy() -> None:
    """5 ms make (pi/2) w tau times twice the kinetic energy, 0.18 J, in all: some 0.05 J."""
    touch = int(np.argmax(_free(False).contact))
    assert touch < _stopped_at("energy", 0.02, {}) < touch + 400


def test_a_diverging_docking_is_stopped_by_its_energy_before_its_force() -> None:
    """A stiff contact and 20 ms: w tau = 1. The energy limit is a tenth of the kinetic energy, the
    force limit the undelayed peak.
    """
    kinetic, peak = 0.5 * 400.0 * 0.03**2, 0.03 * np.sqrt(400.0 * 1.0e6)
    stiff = {"mechanism.contact.stiffness": 1.0e6, "sensor.delay": 0.02}
    assert run(_bumper(stiff)).summary["peak_force"] > 1.3 * peak
    _stopped_at("energy", 0.1 * kinetic, stiff | {"safety.force": peak})
