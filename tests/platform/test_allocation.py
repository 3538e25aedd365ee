"""Nine axes: smooth, at rest before the touch, within every limit, and the relative pose exact."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from hiltestbed.contact.sides import sides_of
from hiltestbed.contact.touch import Meeting
from hiltestbed.frames import Array, quat_from_attitude_deg
from hiltestbed.platform.facilities.prs3 import (
    BLEND,
    DOCKING,
    HEAVE,
    LONGEST,
    MOST_BENT,
    TILT,
    Upper,
    lower_pose,
    place,
    upper_coordinates,
)
from hiltestbed.platform.facilities.tree import between
from hiltestbed.platform.nine_axes import SETTLE
from tests.platform.halls import apart
from tests.platform.rigs import scenario


def poses(
    gap: Array,
    attitude_deg: tuple[float, float, float] = (0.0, 0.0, 0.0),
    x: float = 0.0,
    y: float = 0.0,
) -> Array:
    """``(n, 7)`` relative poses with the gaps ``(n,)``."""
    out = np.tile(
        np.concatenate([[x, y, 0.0], quat_from_attitude_deg(attitude_deg)]), (len(gap), 1)
    )
    out[:, 2] = -gap
    return out


def test_near_the_touch_the_upper_platform_is_at_home_and_the_lower_does_what_it_did() -> None:
    relative = poses(np.linspace(-0.05, DOCKING, 50), (4.0, -3.0, 5.0), 0.1, -0.05)
    assert not upper_coordinates(relative).any()
    np.testing.assert_array_equal(lower_pose(relative), relative)


def test_the_relative_pose_is_realised_exactly() -> None:
    rng = np.random.default_rng(1)
    relative = poses(rng.uniform(-0.02, LONGEST, 200), (3.0, -2.0, 4.0), 0.05, 0.03)
    pose_WP = np.empty(7)
    for goal, x, lower in zip(
        relative, upper_coordinates(relative), lower_pose(relative), strict=True
    ):
        place(Upper.load().shape, x, pose_WP)
        assert max(apart(between(pose_WP, lower), goal)) < 1e-14


def test_the_lower_platform_stays_in_its_workspace_over_the_whole_approach() -> None:
    """+-0.25 m and +-10 deg, for tilts of 4 deg and 70 mm off the axis."""
    relative = poses(np.linspace(0.0, LONGEST, 400), (4.0, -2.0, 3.0), 0.05, -0.05)
    lower = lower_pose(relative)
    assert np.abs(lower[:, :3]).max() < 0.25
    assert np.degrees(np.abs(Rotation.from_quat(lower[:, 3:]).as_euler("xyz"))).max() < 10.0
    # no touch while the upper platform is away
    assert (lower[:, 2] <= np.maximum(relative[:, 2], -DOCKING) + 1e-3).all()


def test_nothing_touches_before_the_upper_platform_is_clamped() -> None:
    """Neither tip nor rod reaches cone, rim or its outside from as far away as it takes to come to
    rest at 0.3 m/s.
    """
    rng = np.random.default_rng(2)
    contact = {"stiffness": 1e5}
    docking = scenario("ideal", mechanism={"kind": "probe_cone", "contact": contact})
    meeting = Meeting(sides_of(docking.mechanism))
    for _ in range(500):
        x, y = rng.uniform(-0.25, 0.25, 2)
        pose = poses(np.array([DOCKING - 0.3 * SETTLE]), tuple(rng.uniform(-10.0, 10.0, 3)), x, y)[
            0
        ]
        assert meeting.deepest(pose) < 0.0


def test_speed_and_acceleration_follow_without_a_step() -> None:
    """At a steady approach v the heave's speed is between 0 and v, its acceleration below 15/8
    v^2/BLEND, and continuous: from one sample to the next it changes by no more than the bound of
    its derivative, 10/sqrt(3) v^3/BLEND^2, allows.
    """
    v, h = 0.3, 1e-4
    t = np.arange(0.0, LONGEST / v, h)
    heave = upper_coordinates(poses(LONGEST - v * t))[:, 0]
    speed, acceleration = -np.diff(heave) / h, np.diff(heave, 2) / h**2
    assert speed.min() > -1e-9
    assert speed.max() < v * (1.0 + 1e-9)
    assert np.abs(acceleration).max() < MOST_BENT * v**2 / BLEND * (1.0 + 1e-3)
    jerk = 10.0 / np.sqrt(3.0) * v**3 / BLEND**2
    assert np.abs(np.diff(acceleration)).max() < 1.01 * jerk * h + 1e-6


def test_beyond_the_blend_the_lower_platform_waits_and_the_upper_keeps_its_limits() -> None:
    lower = lower_pose(poses(np.linspace(DOCKING + BLEND, LONGEST, 50)))
    np.testing.assert_allclose(lower[:, 2], -(DOCKING + 0.5 * BLEND), atol=1e-12)
    x = upper_coordinates(poses(np.linspace(-1.0, 5.0, 500), (9.0, 9.0, 0.0)))
    assert x[:, 0].min() == 0.0
    assert x[:, 0].max() <= HEAVE + 1e-12
    assert np.hypot(x[:, 1], x[:, 2]).max() <= TILT
    assert not upper_coordinates(np.full((1, 7), np.nan)).any()
