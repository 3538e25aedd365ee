"""Kinematics of the upper platform against MuJoCo's own, and the constraints of its three legs."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed.config.models import load
from hiltestbed.frames import Array, twist_between
from hiltestbed.platform.prs3.geometry import (
    HEAVE,
    TILT,
    Upper,
    inverse,
    jacobian,
    motion,
    place,
    revolute,
)

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


@pytest.mark.parametrize("tilt", [TILT, 0.2])
def test_placed_by_the_inverse_kinematics_every_link_of_mujocos_ends_on_its_anchor(
    tilt: float,
) -> None:
    """Slider and revolute joint alone: were the parasitic motion wrong, the anchor would leave the
    plane in which the link swings.
    """
    m = load("prs3/prs3").compile()
    data = mujoco.MjData(m)
    sliders = np.empty((1, 3))
    for x in coordinates(200, tilt):
        pose = placed(x)
        inverse(UPPER.legs, pose[None], sliders)
        turn = Rotation.from_quat(pose[3:])
        data.joint("platform").qpos[:3] = pose[:3] + turn.apply([0.0, 0.0, UPPER.shape[1]])
        data.joint("platform").qpos[3:] = pose[[6, 3, 4, 5]]
        for j in range(3):
            data.joint(f"slider_{j}").qpos[:] = sliders[0, j]
            data.joint(f"revolute_{j}").qpos[:] = revolute(UPPER.legs[j], pose, np.empty(3))
        mujoco.mj_kinematics(m, data)
        for j in range(3):
            assert (
                np.linalg.norm(data.site(f"link_end_{j}").xpos - data.site(f"anchor_{j}").xpos)
                < 1e-9
            )
        np.testing.assert_allclose(data.site("mount").xpos, pose[:3], atol=1e-12)


def test_the_whole_travel_is_within_the_sliders_stroke() -> None:
    low, high = load("prs3/prs3").compile().joint("slider_0").range
    poses = np.array([placed(x) for x in coordinates(500)])
    sliders = np.empty((500, 3))
    inverse(UPPER.legs, poses, sliders)
    assert low < sliders.min()
    assert sliders.max() < high


def test_motion_and_jacobian_are_derivatives_of_pose_and_inverse_kinematics() -> None:
    e, out, jac, ends = 1e-6, np.empty((6, 3)), np.empty((3, 6)), np.empty((2, 3))
    for x in coordinates(20, 0.2):
        motion(UPPER.shape, x, out)
        jacobian(UPPER.legs, placed(x), np.empty(3), jac)
        for j in range(3):
            before, after = (placed(x + s * np.eye(3)[j]) for s in (-e, e))
            slope = np.empty(6)
            twist_between(before, after, 2.0 * e, slope)
            np.testing.assert_allclose(out[:, j], slope, atol=2e-9)
            inverse(UPPER.legs, np.array([before, after]), ends)
            np.testing.assert_allclose(jac @ out[:, j], (ends[1] - ends[0]) / (2.0 * e), atol=2e-8)
