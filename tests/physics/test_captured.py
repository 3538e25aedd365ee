"""A captured pair that rings down on one axis at a time: stiffness and damping of that axis, and
nothing on the others.
"""

from __future__ import annotations

import numpy as np
import pytest

from hiltestbed import load_scenario
from hiltestbed.signals import AXES
from hiltestbed.simulation import simulate

SCENARIO = "13-ring-down"
DELAY_TICKS = 10  # 5 ms at 2 kHz


def test_each_axis_is_found_through_the_delay_and_does_not_show_on_another() -> None:
    """Six runs, one an axis; with the ports at the centres no lever arm turns a push. The force
    across, as a stiffness over the geometric mean of both axes' own.
    """
    scenarios = []
    for axis in range(6):
        speed = np.zeros(6)
        speed[axis] = 0.006 if axis < 3 else 1.0  # m/s, deg/s
        changes = {
            "approach.velocity": speed[:3].tolist(),
            "approach.rate_deg": speed[3:].tolist(),
            "seed": axis,
            "spacecraft.chaser.port.position": [0, 0, 0],
            "spacecraft.target.port.position": [0, 0, 0],
            "rig.platform.tracking": "ideal",
            "compensation.force": {"kind": "phase_lead"},
        }
        scenarios.append(load_scenario(SCENARIO, set=changes))
    batch = simulate(scenarios, trace=True)
    assert not batch.trouble
    assert batch.trace is not None
    late, now = slice(DELAY_TICKS, None), slice(None, -DELAY_TICKS)
    for i, (axis, identified) in enumerate(zip(AXES, batch.identification, strict=True)):
        found = identified[axis]
        assert found["stiffness"] == pytest.approx(found["stiffness_true"], rel=1e-2), axis
        assert found["damping"] == pytest.approx(found["damping_true"], rel=5e-2), axis
        true = np.array([identified[name]["stiffness_true"] for name in AXES])
        motion = (1.0 if i < 3 else 2.0) * batch.trace["pose_act"][now, i, i]
        rate = batch.trace["twist_act"][now, i, i]
        columns = np.column_stack([motion, rate, np.ones(len(motion))])
        stiffness = np.linalg.lstsq(columns, batch.trace["wrench_meas"][late, i], rcond=None)[0][0]
        assert np.abs(np.delete(stiffness / np.sqrt(true * true[i]), i)).max() < 1e-2, axis
