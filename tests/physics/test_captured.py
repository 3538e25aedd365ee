"""A captured pair that rings down on one axis at a time: stiffness and damping of that axis, and
nothing on the others.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from hiltestbed import load_scenario
from hiltestbed.signals import AXES
from hiltestbed.simulation import Batch, simulate
from tests.slow import slow

SCENARIO = "13-ring-down"
DELAY_TICKS = 10  # 5 ms at 2 kHz


@cache
def _ring_downs(tracking: str, compensation: str) -> Batch:
    """Six runs, one per axis; with the ports at the centres no lever arm turns a push."""
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
            "rig.platform.tracking": tracking,
            "compensation.force": {"kind": compensation},
        }
        scenarios.append(load_scenario(SCENARIO, set=changes))
    return simulate(scenarios, trace=True)


@pytest.mark.parametrize(
    ("tracking", "compensation"),
    [
        ("ideal", "phase_lead"),
        slow("servo", "phase_lead"),
        slow("ideal", "resynchronised"),
        slow("servo", "resynchronised"),
    ],
)
def test_each_axis_is_found_through_the_delay(tracking: str, compensation: str) -> None:
    batch = _ring_downs(tracking, compensation)
    assert not batch.trouble
    for axis, identified in zip(AXES, batch.identification, strict=True):
        found = identified[axis]
        assert found["stiffness"] == pytest.approx(found["stiffness_true"], rel=1e-2), axis
        assert found["damping"] == pytest.approx(found["damping_true"], rel=5e-2), axis


def test_an_axis_does_not_show_on_another() -> None:
    """The force across, as a stiffness over the geometric mean of both axes' own."""
    batch = _ring_downs("ideal", "phase_lead")
    assert batch.trace is not None
    for i, axis in enumerate(AXES):
        true = [batch.identification[i][name]["stiffness_true"] for name in AXES]
        motion = (
            batch.trace["pose_act"][:-DELAY_TICKS, i, i]
            if i < 3
            else 2.0 * batch.trace["pose_act"][:-DELAY_TICKS, i, i]
        )
        regressors = np.column_stack(
            [motion, batch.trace["twist_act"][:-DELAY_TICKS, i, i], np.ones(len(motion))]
        )
        stiffness = np.linalg.lstsq(
            regressors, batch.trace["wrench_meas"][DELAY_TICKS:, i], rcond=None
        )[0][0]
        across = np.abs(np.delete(stiffness / np.sqrt(np.array(true) * true[i]), i))
        assert across.max() < 1e-2, axis
