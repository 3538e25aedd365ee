"""Stiffness of a pair that is held in phases: the sum over its springs against what MuJoCo's wrench
makes of small steps.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed import load_scenario
from hiltestbed.contact.sides import sides_of
from hiltestbed.loop import Loop
from hiltestbed.platform.plant import Plant
from hiltestbed.signals import AXES
from tests.running import run
from tests.slow import slow

STEP = 1e-7  # [m], [rad]


def held(name: str, until: float) -> tuple[Plant, np.ndarray, np.ndarray]:
    """A docking under ideal tracking after its hard capture, its pose, the latched place in A."""
    s = load_scenario(
        name, {"rig.platform.tracking": "ideal", "sensor.delay": 0.0, "duration": until}
    )
    loop = Loop([s])
    while loop.k < s.ticks:
        loop.step()
    plant = loop.plant
    assert isinstance(plant, Plant)
    assert plant.phases.begun[0] == len(s.mechanism.phases())
    close = s.mechanism.phases()[-1].close
    return plant, plant.pose_act[0].copy(), sides_of(s.mechanism).sites["A", close.active][1][:3]


def measured(
    plant: Plant, start: np.ndarray, lever: np.ndarray, ticks: int
) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and damping (6, 6) by steps of each axis either way, after so many ticks."""
    place = start[:3] + Rotation.from_quat(start[3:]).apply(lever)
    tick = 5e-4

    def wrench_at(offset: np.ndarray, after: int) -> np.ndarray:
        turned = Rotation.from_rotvec(offset[3:]) * Rotation.from_quat(start[3:])
        pose = np.concatenate([place + offset[:3] - turned.apply(lever), turned.as_quat()])
        for _ in range(after):
            plant.advance(pose[None], np.zeros((1, 6)), np.zeros((1, 6)))
        wrench = plant.wrench_sub[0, -1].copy()
        wrench[3:] -= np.cross(place + offset[:3], wrench[:3])
        return wrench

    stiffness, damping = np.zeros((6, 6)), np.zeros((6, 6))
    for axis, offset in enumerate(STEP * np.eye(6)):
        wrench_at(-offset, 1)
        before = wrench_at(-offset, ticks)
        moving = wrench_at(offset, 1)
        after = wrench_at(offset, ticks)
        stiffness[:, axis] = (after - before) / (2.0 * STEP)
        damping[:, axis] = (moving - after) * tick / (2.0 * STEP)
    return stiffness, damping


@pytest.mark.parametrize(
    ("name", "until", "loads"),
    [
        slow("16-probe-drogue", 13.0, 2e-3),
        slow("17-gripper", 8.0, 5e-2),
    ],
)
def test_the_sum_over_the_springs_is_what_the_wrench_says(
    name: str, until: float, loads: float
) -> None:
    """``loads``: part that the loads add, a force over a radius: 12 ends of jaws with 270 N on 10
    mm are 0.32 of 7.3 MN/m.

    The jaws come to rest in 300 ticks (3000 N s/m on 1e5 N/m). Along z the rod of the drogue
    trembles at its stop. Friction has no stiffness, and is a damper across the surfaces: along
    their normals damping is compared too.
    """
    plant, start, lever = held(name, until)
    found = plant.held_pair(0)
    stiffness, damping = measured(plant, start, lever, 300)
    scale = np.sqrt(np.outer(np.diag(found[0]), np.diag(found[0])))
    axes = [0, 1, 3, 4, 5] if name == "16-probe-drogue" else list(range(6))
    np.testing.assert_allclose(
        (stiffness / scale)[np.ix_(axes, axes)], (found[0] / scale)[np.ix_(axes, axes)], atol=loads
    )
    assert stiffness[2, 2] == pytest.approx(found[0][2, 2], rel=max(loads, 0.03))
    normal = [2, 3, 4]
    np.testing.assert_allclose(
        np.diag(damping)[normal], np.diag(found[1])[normal], rtol=max(loads, 0.02)
    )


def test_the_summary_has_the_truth_of_every_axis_once_it_is_held() -> None:
    """Weld of 1e6 N/m on 0.4 m, a ball joint of 1e5 N/m 0.17 m behind it, twelve pads of 2e5 N/m on
    0.4 m; the rod is at its end.

    Identified are rx and ry, within four standard deviations of 0.11 and 0.4 %, although the joint
    couples them with y and x by 17 kN.
    """
    told = run(load_scenario("16-probe-drogue", {"duration": 13.0})).summary["identification"]
    by_hand = [
        1.1e6,
        1.1e6,
        1e6 + 1e5 + 12 * 2e5,
        *[0.16e6 + 1e5 * 0.17**2 + 6 * 2e5 * 0.16] * 2,
        0.16e6,
    ]
    for axis, true in zip(AXES, by_hand, strict=True):
        assert told[axis]["stiffness_true"] == pytest.approx(true, rel=2e-3), axis
    for axis in ("rx", "ry"):
        assert told[axis]["stiffness"] == pytest.approx(
            told[axis]["stiffness_true"], rel=4.0 * 0.0011
        ), axis
        assert told[axis]["damping"] == pytest.approx(
            told[axis]["damping_true"], rel=4.0 * 0.004
        ), axis
