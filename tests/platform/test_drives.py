"""What all drives share: starts without a transient, states that can be saved, runs of a batch that
do not know of each other.
"""

from __future__ import annotations

import numpy as np
import pytest

from hiltestbed.frames import Array
from hiltestbed.platform.facilities.limits import Watch
from hiltestbed.platform.facilities.measure import workspace
from hiltestbed.platform.facilities.stand import Stand
from tests.platform.halls import UPRIGHT, arm, arms, poses, stewart

KINDS = {
    "hydraulic": stewart,
    "electric": lambda: stewart("electric"),
    "serial_arm": lambda: arm({"controller_rate": 250.0, "delay_cycles": 2}),
    "two_arms": lambda: arms({"controller_rate": 250.0, "delay_cycles": 2}),
}
STILL = np.zeros((1, 6))


@pytest.fixture(params=KINDS)
def kind(request) -> str:
    return request.param


def moved(stand: Stand, ticks: int, scale: Array) -> Array:
    """Poses under a motion that differs run by run."""
    n = len(stand.pose)
    pose, twist, accel = np.tile(UPRIGHT, (n, 1)), np.zeros((n, 6)), np.zeros((n, 6))
    for k in range(1, ticks + 1):
        t = k * stand.tick
        pose[:, 2], twist[:, 2], accel[:, 2] = (
            scale * np.sin(8 * t),
            8 * scale * np.cos(8 * t),
            -64 * scale * np.sin(8 * t),
        )
        stand.advance(pose, twist, accel)
    return stand.pose.copy()


def test_it_stands_still_where_it_was_put(kind: str) -> None:
    """Weight, leakage and gears are in balance from the start: no transient above the encoder's and
    the integrator's steps.
    """
    stand = Stand(KINDS[kind]())
    start = UPRIGHT[None].copy()
    start[0, :3] = [0.05, -0.04, -0.03]
    stand.reset(start, STILL)
    for _ in range(400):
        stand.advance(start, STILL, STILL)
    np.testing.assert_allclose(stand.pose[0, :3], start[0, :3], atol=5e-6)
    assert np.abs(stand.twist).max() < 1e-4


def test_runs_of_a_batch_may_differ_in_the_drives_numbers() -> None:
    slow, fast = stewart("electric", bandwidth=10.0), stewart("electric", bandwidth=30.0)
    assert slow.alike() == fast.alike()
    stand = Stand(slow, 2, settings=[slow.settings, fast.settings])
    stand.reset(np.tile(UPRIGHT, (2, 1)), np.zeros((2, 6)))
    reached = moved(stand, 100, np.array([0.004, 0.004]))
    goal = 0.004 * np.sin(8 * 100 * stand.tick)
    assert abs(reached[0, 2] - goal) > 2 * abs(reached[1, 2] - goal)


def test_a_command_out_of_reach_is_told_and_leaves_the_rig_in_the_finite_numbers() -> None:
    stand = Stand(stewart("electric"))
    stand.reset(UPRIGHT[None], STILL)
    far = UPRIGHT[None].copy()
    far[0, :3] = np.nan
    stand.advance(far, STILL, STILL)
    assert not stand.drives.missed[0] < 1e-6
    watch = Watch(stand.facility.axes, stand.drives.kinematics.joints_home, 1, stand.tick)
    drives = stand.drives
    assert watch.passed(drives.joints, drives.joint_rates, stand.ctrl, drives.missed)
    assert "out of the facility's reach" in (watch.reason(0) or "")


@pytest.mark.parametrize(
    ("place", "speed", "said"),
    [
        (0.0, 0.0, None),
        (86.0, 0.0, "joint a2 is at -4 deg; its travel is -140 to -5 deg"),
        (0.0, 116.0, "joint a2 moves at 116 deg/s; its limit is 115 deg/s"),
    ],
)
def test_the_watch_names_the_joint_and_its_limit(place, speed, said) -> None:
    home, joints, rates, still = np.zeros(6), np.zeros((1, 6)), np.zeros((1, 6)), np.zeros((1, 6))
    home[1], joints[0, 1], rates[0, 1] = np.radians([-90.0, place, speed])
    watch = Watch(arm().axes, home, 1, 1e-3)
    assert watch.passed(joints, rates, still, np.zeros(1)) == (said is not None)
    assert watch.reason(0) == said


def test_the_workspace_ends_where_a_joint_does() -> None:
    reach = {found.axis: found for found in workspace(stewart())}
    # 0.52 m of a leg, over the cosine of its lean on the way up
    assert reach["z"].high == pytest.approx(0.57, abs=0.01)
    assert "leg_0" in reach["z"].stops[1]
    # the platform is the same on both sides of y-z
    assert reach["x"].high == pytest.approx(-reach["x"].low, abs=1e-3)


def test_every_pose_of_the_nominal_workspace_is_reached(kind: str) -> None:
    facility = KINDS[kind]()
    for goal in poses(6, 0.15, 6.0):
        assert facility.complaints(goal) == []
