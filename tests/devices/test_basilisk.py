"""The rig in a Basilisk simulation rebounds as it does in the loop, but for half a step of delay."""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path

import pytest

from hiltestbed.scenario import load_scenario
from tests.running import run

pytest.importorskip("Basilisk")
EXAMPLE = Path(__file__).parents[2] / "examples" / "basilisk" / "docking.py"
STIFFNESS, MASS = 1.0e5, 400.0  # [N/m], [kg] reduced, of the scenario


def test_forces_held_over_a_step_are_half_a_step_late() -> None:
    spec = importlib.util.spec_from_file_location("docking", EXAMPLE)
    assert spec is not None
    assert spec.loader is not None
    docking = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(docking)
    scenario = load_scenario("03-bumper-delay-uncompensated", {"duration": 0.7})
    rows = docking.dock(scenario)
    cor = -rows[-1, 2] / rows[0, 2]
    # ln(e/e_ref) = (pi/2) w tau, the momentum of both bodies kept
    late = 0.5 * math.pi * math.sqrt(STIFFNESS / MASS) * 0.5 * scenario.tick
    assert math.log(cor / run(scenario).summary["cor"]) == pytest.approx(late, rel=0.1)
