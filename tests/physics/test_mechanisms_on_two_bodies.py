"""The shipped mechanisms in the loop, without delay, against two free bodies that carry them in MuJoCo alone."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from hiltestbed.scenario import scenario_from
from hiltestbed.simulation import simulate
from tests.models.rig import Rig

RATE = 2000.0


def whole(rig: Rig, side: str) -> tuple[float, list[float], list[float]]:
    """Mass [kg], centre in the port's frame [m] and inertia (3,) about it [kg m^2] of a bus with all that it carries."""
    model, data = rig.batch.get_model(0), rig.batch.get_data(0)
    mujoco.mj_forward(model, data)
    root = model.body(f"{side}_bus").id
    bodies = [b for b in range(model.nbody) if model.body_rootid[b] == root]
    mass = model.body_mass[bodies]
    centre = mass @ data.xipos[bodies] / mass.sum()
    port = data.site(f"{side}_{'A' if side == 'active' else 'P'}")
    inertia = np.zeros((3, 3))
    for b, m in zip(bodies, mass, strict=True):
        axes, arm = data.ximat[b].reshape(3, 3), data.xipos[b] - centre
        inertia += axes @ np.diag(model.body_inertia[b]) @ axes.T + m * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    turn = port.xmat.reshape(3, 3)
    return float(mass.sum()), list(turn.T @ (centre - port.xpos)), list(np.diag(turn.T @ inertia @ turn))


def vehicle(rig: Rig, side: str) -> dict:
    mass, centre, inertia = whole(rig, side)
    return {"mass": mass, "inertia": inertia, "port": {"position": [-c for c in centre], "attitude_deg": [0.0, 0.0, 0.0]}}


CASES = [
    ("probe_drogue", 0.15, (0.0, 0.0, 0.1), (0.1, 0.05), (2.0, -2.0, 0.0), 3.0),
    ("marman_gripper", 0.005, (0.0, 0.0, 0.02), (0.003, -0.002), (0.2, -0.1, 0.5), 3.0),
]


@pytest.mark.parametrize(("name", "gap", "velocity", "offset", "attitude", "duration"), CASES)
def test_soft_capture_comes_when_two_free_bodies_say_so(name, gap, velocity, offset, attitude, duration) -> None:
    """Time of the first phase within 2 %, and where A is then within 2 mm: the loop counts the moving part's mass to the rig."""
    rig = Rig(name)
    rig.start(gap, velocity, offset, attitude)
    bodies = {"chaser": vehicle(rig, "active"), "target": vehicle(rig, "passive")}
    elapsed = 0.0
    while not rig.done and elapsed < duration:
        rig.run(0.01)
        elapsed += 0.01
    assert rig.done
    path = rig.site("active_A") - rig.site("passive_P")
    scenario = scenario_from(
        {
            "name": name, "duration": duration, "rate": RATE, "physics_rate": 2.0 * RATE, "spacecraft": bodies,
            "approach": {"gap": gap, "velocity": list(velocity), "offset": list(offset), "attitude_deg": list(attitude)},
            "mechanism": {"kind": name}, "compensation": {"force": {"kind": "none"}}, "identification": {"kind": "none"},
            "rig": {"platform": {"tracking": "ideal"}},
        }
    )  # fmt: skip
    found = simulate([scenario], trace=True)
    first = found.outcomes[0]["phases"][0]
    assert first["at"] == pytest.approx(elapsed, rel=0.02, abs=0.01)
    assert found.trace is not None
    trace = found.trace.run(0)
    np.testing.assert_allclose(trace["pose_act"][round(elapsed * RATE), :3], path, atol=2e-3)
