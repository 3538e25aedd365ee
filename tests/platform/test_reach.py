"""Inverse against forward kinematics of every facility over its workspace, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed.frames import pose_step
from hiltestbed.platform.facilities.arms import share_out
from hiltestbed.platform.facilities.facility import MOUNT, MOUNT_HOME, Facility, compiled
from hiltestbed.platform.facilities.tree import between, compose
from tests.platform.halls import TABLE, apart, arm, arms, facility, mujoco_pose, poses, stewart

NEAR = 1e-6  # [m], [rad]
LIFT = np.array([*MOUNT_HOME[:3], 0.0, 0.0, 0.0, 0.0])


@pytest.fixture(params=["stewart", "serial_arm", "mjcf", "overhead_gantry"])
def rig(request) -> Facility:
    return facility(request.param, **({"model": TABLE} if request.param == "mjcf" else {}))


def test_home_is_where_every_facility_has_it(rig: Facility) -> None:
    kinematics = rig.kinematics(compiled(rig.spec()))
    assert max(apart(kinematics.home_poses[0], MOUNT_HOME)) < 1e-7
    assert kinematics.complaints(kinematics.home_poses) == []


def test_inverse_and_forward_kinematics_agree_over_the_workspace(rig: Facility) -> None:
    """Joints from the pose, pose from the joints: by MuJoCo's kinematics, and by closing the loops
    for the driven joints alone.
    """
    m = compiled(rig.spec())
    kinematics = rig.kinematics(m)
    goals = poses(40, 0.25, 10.0)
    goals[:, :3] += MOUNT_HOME[:3]
    for goal in goals:
        q, left = kinematics.solve(goal)
        assert left < 1e-9
        assert max(apart(mujoco_pose(m, q, MOUNT), goal)) < NEAR
        np.testing.assert_allclose(kinematics.closed(q), q, atol=NEAR)


def test_an_arm_stays_on_the_branch_of_its_home() -> None:
    """Of the eight solutions of six axes with a spherical wrist, that with the elbow and the wrist
    as at home.
    """
    rig = arm()
    kinematics = rig.kinematics(compiled(rig.spec()))
    for goal in poses(30, 0.3, 15.0, seed=2):
        joints = kinematics.solve(goal + LIFT)[0][kinematics.q]
        assert np.abs(joints - kinematics.joints_home).max() < 0.5 * np.pi


def test_rates_are_the_slopes_of_the_joints(rig: Facility) -> None:
    kinematics = rig.kinematics(compiled(rig.spec()))
    goal = poses(1, 0.15, 6.0)[0] + LIFT
    twist, h = np.array([0.3, -0.2, 0.1, 0.2, 0.1, -0.3]), 1e-4
    q, _ = kinematics.solve(goal)
    ends = np.empty((2, 7))
    for end, step in zip(ends, (-h, h), strict=True):
        pose_step(goal, twist, step, end)
    before, after = (kinematics.solve(end, start=q)[0][kinematics.q] for end in ends)
    np.testing.assert_allclose(
        kinematics.rates(q, twist)[kinematics.v], (after - before) / (2 * h), atol=1e-6
    )


def test_two_arms_share_the_relative_pose() -> None:
    """Whatever the share, A in P is what was asked for; near the touch the arms move in the given
    ratio, far away the rail alone.
    """
    rig = arms(share=0.3)
    m = compiled(rig.spec())
    kinematics = rig.kinematics(m)
    goals = poses(20, 0.2, 8.0)
    goals[10:, 2] -= np.linspace(0.1, 20.0, 10)
    for goal in goals:
        active, passive = np.empty(7), np.empty(7)
        rail = share_out(goal, 0.3, active, passive)
        assert max(apart(between(passive, active), goal)) < 1e-12
        mount = compose(active, np.array([0.0, 0.0, -0.6, 0.0, 0.0, 0.0, 1.0]))
        q, left = kinematics.solve(np.array([mount, passive]), np.array([rail]))
        assert left < 1e-9
        back = [mujoco_pose(m, q, site) for site in kinematics.tools]
        assert max(apart(back[0], mount)) < NEAR
        assert max(apart(back[1], passive)) < NEAR
    near, active, passive = np.array([0.1, 0.0, 0.02, 0.0, 0.0, 0.0, 1.0]), np.empty(7), np.empty(7)
    assert share_out(near, 0.3, active, passive) == 0.0
    np.testing.assert_allclose([active[0], passive[0]], [0.07, -0.03], atol=1e-12)


def test_what_cannot_be_reached_is_said_with_its_place() -> None:
    far = np.array([3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    assert "out of reach" in arm().complaints(far)[0]
    assert "(3.000, 0.000, -0.600) m" in arm().complaints(far)[0]
    low = np.array([0.0, 0.0, -0.93, 0.0, 0.0, 0.0, 1.0])
    assert any(
        "joint a5" in found and "-125 to 125 deg" in found for found in arm().complaints(low)
    )
    assert any(
        "leg_0" in found
        for found in stewart().complaints(np.array([0.0, 0.0, 0.7, 0.0, 0.0, 0.0, 1.0]))
    )


def test_a_stretched_wrist_is_a_singularity_with_its_place() -> None:
    """With a5 = 0 the axes of a4 and a6 coincide: the flange loses a rotation across both."""
    rig = arm()
    kinematics = rig.kinematics(compiled(rig.spec()))
    q = kinematics.home.copy()
    assert kinematics.lost_motion(q) is None
    q[kinematics.q[4]] = 0.0
    lost = kinematics.lost_motion(q)
    assert lost.startswith("no motion")
    found = kinematics.complaints(kinematics.poses(q))
    assert any(
        text.startswith("singular: no motion") and " m, rotated by " in text for text in found
    )


def test_a_platform_turned_by_a_right_angle_is_not_held() -> None:
    """Turned by 90 deg about its axis a symmetric Stewart platform gains a motion (Fichter, Int. J.
    Robotics Research 5(2), 1986).
    """
    rig = stewart()
    kinematics = rig.kinematics(compiled(rig.spec()))
    turned = np.array([*MOUNT_HOME[:3], *Rotation.from_euler("z", 89.9, degrees=True).as_quat()])
    q, left = kinematics.solve(turned)
    assert left < 1e-8
    assert "no stiffness" in (kinematics.lost_motion(q) or "")
