"""Kinematics of the upper platform against MuJoCo's own, and the constraints of its three legs."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from hiltestbed.frames import Array, twist_between
from hiltestbed.platform.facilities.limbs import jacobian, slider
from hiltestbed.platform.facilities.prs3 import (
    HEAVE,
    TILT,
    Upper,
    motion,
    place,
    upper_kinematics,
)
from hiltestbed.platform.facilities.upper_drives import upper_model
from tests.platform.rigs import scenario

UPPER = Upper.load()


def coordinates(n: int, tilt: float = TILT) -> Array:
    """``(n, 3)`` over the whole heave and tilts up to ``tilt`` [rad] in any direction."""
    rng = np.random.default_rng(4)
    size, towards = tilt * np.sqrt(rng.uniform(size=n)), rng.uniform(0.0, 2.0 * np.pi, n)
    return np.column_stack(
        [rng.uniform(0.0, HEAVE, n), size * np.cos(towards), size * np.sin(towards)]
    )


def placed(x: Array) -> Array:
    pose = np.empty(7)
    place(UPPER.shape, x, pose)
    return pose


def sliders_at(pose: Array) -> Array:
    return np.array([slider(limb, pose, np.empty(3)) for limb in UPPER.limbs])


@pytest.mark.parametrize("tilt", [TILT, 0.2])
def test_every_link_ends_on_its_anchor_with_the_platform_where_it_was_placed(tilt: float) -> None:
    """Sliders alone are given: were the parasitic motion wrong, the anchors would leave the planes
    in which the links swing, and the loops would close elsewhere.
    """
    m = upper_model(scenario().mechanism, 1e-3)
    kinematics, data, none = upper_kinematics(m), mujoco.MjData(m), np.empty(0)
    rng, ways, jac = np.random.default_rng(5), np.empty((6, 3)), np.zeros((6, m.nv))
    for x in coordinates(50, tilt):
        pose, speed = placed(x), rng.normal(size=3)
        motion(UPPER.shape, x, ways)
        data.qpos[:], data.qvel[:] = kinematics.motion(pose, ways @ speed, none, none)
        mujoco.mj_forward(m, data)
        np.testing.assert_allclose(data.qpos[kinematics.q], sliders_at(pose), atol=1e-12)
        np.testing.assert_allclose(data.site("P_nominal").xpos, pose[:3], atol=1e-11)
        quat = data.joint("platform").qpos[[4, 5, 6, 3]]
        np.testing.assert_allclose(quat, pose[3:], atol=1e-11)
        mujoco.mj_jacSite(m, data, jac[:3], jac[3:], m.site("P_nominal").id)
        np.testing.assert_allclose(jac @ data.qvel, ways @ speed, atol=1e-10)
        for j in range(3):
            end, anchor = data.site(f"link_end_{j}"), data.site(f"anchor_{j}")
            np.testing.assert_allclose(end.xpos, anchor.xpos, atol=1e-14)


def test_the_whole_travel_is_within_the_sliders_stroke() -> None:
    low, high = upper_model(scenario().mechanism, 1e-3).joint("slider_0").range
    sliders = np.array([sliders_at(placed(x)) for x in coordinates(500)])
    assert low < sliders.min()
    assert sliders.max() < high


def test_motion_and_jacobian_are_derivatives_of_pose_and_inverse_kinematics() -> None:
    e, out, jac = 1e-6, np.empty((6, 3)), np.empty((3, 6))
    for x in coordinates(20, 0.2):
        motion(UPPER.shape, x, out)
        jacobian(UPPER.limbs, placed(x), np.empty(3), jac)
        for j in range(3):
            before, after = (placed(x + s * np.eye(3)[j]) for s in (-e, e))
            slope = np.empty(6)
            twist_between(before, after, 2.0 * e, slope)
            np.testing.assert_allclose(out[:, j], slope, atol=2e-9)
            rate = (sliders_at(after) - sliders_at(before)) / (2.0 * e)
            np.testing.assert_allclose(jac @ out[:, j], rate, atol=2e-8)
