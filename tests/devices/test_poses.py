"""Poses as KUKA and Universal Robots write them, against SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed.devices import poses
from hiltestbed.devices.rsi import RsiSettings


def _poses(count: int, seed: int = 1) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [
        np.concatenate([rng.normal(size=3), r.as_quat()]) for r in Rotation.random(count, rng=rng)
    ]


def _same(pose: np.ndarray, other: np.ndarray) -> None:
    np.testing.assert_allclose(pose[:3], other[:3], atol=1e-12)
    assert abs(abs(float(pose[3:] @ other[3:])) - 1.0) < 1e-12


def test_kuka_angles_turn_about_z_then_the_new_y_then_the_new_x() -> None:
    for pose in _poses(200):
        frame = poses.kuka_from_pose(pose)
        np.testing.assert_allclose(frame[:3], 1e3 * pose[:3])
        expected = Rotation.from_quat(pose[3:]).as_euler("ZYX", degrees=True)
        np.testing.assert_allclose(frame[3:], expected, atol=1e-9)
        _same(poses.pose_from_kuka(frame), pose)


@pytest.mark.parametrize("b", [90.0, -90.0])
def test_at_the_pole_the_attitude_is_kept(b: float) -> None:
    for a, c in ((0.0, 0.0), (25.0, 40.0), (-170.0, 33.0)):
        rotation = Rotation.from_euler("ZYX", [a, b, c], degrees=True)
        pose = np.concatenate([np.zeros(3), rotation.as_quat()])
        frame = poses.kuka_from_pose(pose)
        back = Rotation.from_quat(poses.pose_from_kuka(frame)[3:])
        assert (back * rotation.inv()).magnitude() < 2e-6  # asin loses half the digits there
        assert frame[5] == 0.0 or abs(abs(frame[4]) - 90.0) > 1e-5


def test_rotation_vectors() -> None:
    for pose in _poses(200, seed=2):
        frame = poses.rotation_vector_from_pose(pose)
        np.testing.assert_allclose(frame[3:], Rotation.from_quat(pose[3:]).as_rotvec(), atol=1e-9)
        _same(poses.pose_from_rotation_vector(frame), pose)


def test_offsets_in_base_and_tool_axes() -> None:
    in_base, in_tool = RsiSettings(), RsiSettings(reference="tool")
    for start, pose in zip(_poses(50, seed=3), _poses(50, seed=4), strict=True):
        r0, r1 = Rotation.from_quat(start[3:]), Rotation.from_quat(pose[3:])
        base, tool = in_base.offset(start, pose), in_tool.offset(start, pose)
        _same(base, np.concatenate([pose[:3] - start[:3], (r1 * r0.inv()).as_quat()]))
        _same(
            tool, np.concatenate([r0.inv().apply(pose[:3] - start[:3]), (r0.inv() * r1).as_quat()])
        )
        _same(in_base.add(start, base), pose)
        _same(in_tool.add(start, tool), pose)
