"""Inverse against forward kinematics of every facility over its workspace, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed.frames import Array, pose_step
from hiltestbed.platform.facilities.facility import MOUNT, MOUNT_HOME, Facility, compiled
from hiltestbed.platform.facilities.tree import between, compose
from hiltestbed.platform.facilities.two_arms import share_out
from tests.platform.halls import GANTRY, apart, arm, arms, mujoco_pose, own, poses, stewart

NEAR = 1e-6  # [m], [rad]
LIFT = np.array([*MOUNT_HOME[:3], 0.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def gantry(tmp_path_factory):
    path = tmp_path_factory.mktemp("rig") / "gantry.xml"
    path.write_text(GANTRY)
    return own(path)


@pytest.fixture(params=["stewart", "serial_arm", "mjcf"])
def facility(request, gantry) -> Facility:
    return {"stewart": stewart, "serial_arm": arm, "mjcf": lambda: gantry}[request.param]()


def test_home_is_where_every_facility_has_it(facility: Facility) -> None:
    kinematics = facility.kinematics(compiled(facility.spec()))
    assert max(apart(kinematics.home_poses[0], MOUNT_HOME)) < 1e-7
    assert kinematics.complaints(kinematics.home_poses) == []


def test_inverse_and_forward_kinematics_agree_over_the_workspace(facility: Facility) -> None:
    """Joints from the pose, pose from the joints: by MuJoCo's kinematics, and by closing the loops
    for the driven joints alone.
    """
    m = compiled(facility.spec())
    kinematics = facility.kinematics(m)
    goals = poses(40, 0.25, 10.0)
    goals[:, :3] += MOUNT_HOME[:3]
    for goal in goals:
        q, left = kinematics.solve(goal)
        assert left < 1e-9
        assert max(apart(mujoco_pose(m, q, MOUNT), goal)) < NEAR
        np.testing.assert_allclose(kinematics.closed(q), q, atol=NEAR)


def test_legs_have_the_length_between_their_ends() -> None:
    """Closed form of a Stewart platform: |p + R a_j - b_j| - L."""
    facility = stewart()
    m = compiled(facility.spec())
    kinematics = facility.kinematics(m)
    base = np.array([m.body(f"cylinder_{j}").pos for j in range(6)])
    anchor = np.array([m.site(f"anchor_{j}").pos for j in range(6)])
    home = np.array(m.body("platform").pos)
    length = np.linalg.norm(home + anchor - base, axis=1)
    for goal in poses(40, 0.3, 12.0, seed=5):
        centre = (
            goal[:3] + MOUNT_HOME[:3] + Rotation.from_quat(goal[3:]).apply(home - MOUNT_HOME[:3])
        )
        ends = centre + Rotation.from_quat(goal[3:]).apply(anchor)
        legs = np.linalg.norm(ends - base, axis=1) - length
        np.testing.assert_allclose(kinematics.solve(goal + LIFT)[0][kinematics.q], legs, atol=1e-9)


def wrist_solution(flange: Array, base: Array) -> Array:
    """Joints of the arm by its spherical wrist (elbow up), a1 to a3 from the wrist's centre, a4 to
    a6 from the attitude left.
    """
    at = between(base, flange)
    turn = Rotation.from_quat(at[3:]).as_matrix()
    wrist = at[:3] - 0.215 * turn[:, 2]
    a1 = -math.atan2(wrist[1], wrist[0])
    r, h, forearm = math.hypot(wrist[0], wrist[1]) - 0.35, wrist[2] - 0.675, math.hypot(1.2, 0.041)
    reach = math.hypot(r, h)
    shoulder = math.acos((1.15**2 + reach**2 - forearm**2) / (2 * 1.15 * reach))
    elbow = math.acos((1.15**2 + forearm**2 - reach**2) / (2 * 1.15 * forearm))
    a2 = -(math.atan2(h, r) + shoulder)
    a3 = math.pi - elbow - math.atan2(0.041, 1.2)
    left = (
        Rotation.from_euler("z", -a1) * Rotation.from_euler("y", a2 + a3)
    ).inv() * Rotation.from_matrix(turn @ Rotation.from_euler("y", -90, degrees=True).as_matrix())
    a4, a5, a6 = left.as_euler("XYX")
    return np.array([a1, a2, a3, -a4, a5, -a6])


def test_the_arm_solves_as_its_spherical_wrist_does() -> None:
    """The closed form of six axes with a spherical wrist (Pieper 1968), of which the arm's is the
    solution that home lies on.
    """
    facility = arm()
    m = compiled(facility.spec())
    kinematics = facility.kinematics(m)
    base = np.concatenate([m.body("base").pos, np.array(m.body("base").quat)[[1, 2, 3, 0]]])
    for goal in poses(30, 0.3, 15.0, seed=2):
        goal = goal + LIFT
        joints = kinematics.solve(goal)[0][kinematics.q]
        closed = wrist_solution(goal, base)
        closed[3:] = (
            closed[3:]
            if closed[4] * joints[4] > 0
            else [closed[3] + math.pi, -closed[4], closed[5] + math.pi]
        )
        difference = (joints - closed + math.pi) % (2 * math.pi) - math.pi
        assert np.abs(difference).max() < 1e-8


def test_rates_are_the_slopes_of_the_joints(facility: Facility) -> None:
    kinematics = facility.kinematics(compiled(facility.spec()))
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
    facility = arms(share=0.3)
    m = compiled(facility.spec())
    kinematics = facility.kinematics(m)
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
    facility = arm()
    kinematics = facility.kinematics(compiled(facility.spec()))
    q = kinematics.home.copy()
    assert kinematics.lost_motion(q) is None
    q[kinematics.q[4]] = 0.0
    lost = kinematics.lost_motion(q)
    assert lost is not None
    assert lost.startswith("no motion")
    found = kinematics.complaints(kinematics.poses(q))
    assert any(
        text.startswith("singular: no motion") and " m, rotated by " in text for text in found
    )


def test_a_platform_turned_by_a_right_angle_is_not_held() -> None:
    """Turned by 90 deg about its axis a symmetric Stewart platform gains a motion (Fichter, Int. J.
    Robotics Research 5(2), 1986).
    """
    facility = stewart()
    kinematics = facility.kinematics(compiled(facility.spec()))
    turned = np.array([*MOUNT_HOME[:3], *Rotation.from_euler("z", 89.9, degrees=True).as_quat()])
    q, left = kinematics.solve(turned)
    assert left < 1e-8
    assert "no stiffness" in (kinematics.lost_motion(q) or "")
