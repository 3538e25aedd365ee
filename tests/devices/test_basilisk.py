"""The rig in a Basilisk simulation, and two Basilisk spacecraft as the numerical model of a run."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from hiltestbed import plugins
from hiltestbed.scenario import Scenario, load_scenario
from hiltestbed.signals import GROUPS
from tests.physics.closed_forms import pair_momentum
from tests.running import run

pytest.importorskip("Basilisk", reason="needs pip install 'hiltestbed[basilisk]'")
EXAMPLE = Path(__file__).parents[2] / "examples" / "basilisk" / "docking.py"
STIFFNESS, MASS = 1.0e5, 400.0  # [N/m], [kg] reduced, of the scenario
BUMPER, SHORT = "03-bumper-delay-uncompensated", {"duration": 0.7}
MODEL = {"numerical_model.kind": "basilisk"}
TURNING: dict[str, Any] = {
    "duration": 0.8,
    "physics_rate": 8000,
    "approach.rate_deg": [0.5, -0.3, 1.0],
    "rig.platform.tracking": "ideal",
    "compensation.force": {"kind": "none"},
    "identification": {"kind": "none"},
}


@pytest.fixture
def docking(tables_as_shipped: None) -> ModuleType:
    plugins.load([str(EXAMPLE)])
    return next(m for m in sys.modules.values() if getattr(m, "__file__", "") == str(EXAMPLE))


def ln_cor(scenario: Scenario) -> float:
    summary = run(scenario).summary
    return math.log(summary["cor"])


def test_forces_held_over_a_step_are_half_a_step_late(docking: ModuleType) -> None:
    scenario = load_scenario(BUMPER, SHORT)
    rows = docking.dock(scenario).rows
    # ln(e/e_ref) = (pi/2) w tau, the momentum of both bodies kept
    late = 0.5 * math.pi * math.sqrt(STIFFNESS / MASS) * 0.5 * scenario.tick
    own = ln_cor(scenario)
    assert math.log(-rows[-1][10] / rows[0][10]) - own == pytest.approx(late, rel=0.1)
    assert ln_cor(load_scenario(BUMPER, SHORT | MODEL)) - own == pytest.approx(late, rel=0.1)


def test_the_rig_in_basilisk_moves_as_basilisk_in_the_rig(docking: ModuleType) -> None:
    """Tick by tick, in six axes."""
    rows = np.array(docking.dock(load_scenario("05-off-centre", TURNING)).rows)
    inside = run(load_scenario("05-off-centre", TURNING | MODEL))
    poses = np.column_stack([inside.trace[name] for name in GROUPS["pose_cmd"].columns])
    np.testing.assert_allclose(rows[1 : len(poses) + 1, 1:8], poses, rtol=0.0, atol=1e-12)


def test_basilisk_keeps_the_momentum_of_both(docking: ModuleType) -> None:
    """The linear one to rounding; the angular one but for a term of first order in the step: force
    and torque are held at the place where the step began.
    """
    lost = []
    for rate in (2000, 4000):
        rig = docking.Rig(load_scenario("05-off-centre", TURNING | {"rate": rate}))
        of = rig.bodies
        before, start = pair_momentum(of.mass, of.inertia, of.q, of.v)[0], of.v.copy()
        rig.pair.step(round(TURNING["duration"] * rate))
        change = pair_momentum(of.mass, of.inertia, of.q, of.v)[0] - before
        exchanged = np.linalg.norm(of.mass[0, 0] * (of.v - start)[0, 0, :3])
        assert exchanged > 10.0  # [N s]
        assert np.abs(change[:3]).max() < 1e-12 * exchanged
        lost.append(np.linalg.norm(change[3:]))
    assert lost[0] == pytest.approx(2.0 * lost[1], rel=0.05)
