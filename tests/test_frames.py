"""The algebra of rotations and poses against scipy and its own axioms, and curves from pairs."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError
from scipy.spatial.transform import Rotation

from hiltestbed import frames
from hiltestbed.config.piecewise import MOST, PACKED, Curve, along, between, packed, steepest


@pytest.fixture
def quaternions() -> np.ndarray:
    q = np.random.default_rng(1).standard_normal((20, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def test_products_and_rotations_are_scipys(quaternions: np.ndarray) -> None:
    out, v = np.empty(4), np.array([0.3, -1.2, 0.7])
    for a, b in zip(quaternions[:10], quaternions[10:], strict=True):
        frames.quat_mul(a, b, out)
        assert abs(
            out @ (Rotation.from_quat(a) * Rotation.from_quat(b)).as_quat()
        ) == pytest.approx(1.0, abs=1e-14)
        frames.quat_conj_mul(a, b, out)
        assert abs(
            out @ (Rotation.from_quat(a).inv() * Rotation.from_quat(b)).as_quat()
        ) == pytest.approx(1.0, abs=1e-14)
        w = np.empty(3)
        frames.rotate(a, v, w)
        np.testing.assert_allclose(w, Rotation.from_quat(a).apply(v), atol=1e-14)
        frames.rotate_back(a, w, w)
        np.testing.assert_allclose(w, v, atol=1e-14)


@pytest.mark.parametrize("size", [1e-14, 1e-9, 1e-5, 0.9e-4, 1.1e-4, 0.1, 3.0])
def test_exponential_and_logarithm_are_inverse(size: float) -> None:
    r = size * np.array([0.6, -0.64, 0.48])
    q, back = np.empty(4), np.empty(3)
    frames.quat_exp(r, q)
    assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-15)
    frames.rotation_vector(q, back)
    np.testing.assert_allclose(back, r, rtol=1e-12)
    # -q is the same attitude
    np.testing.assert_allclose(frames.rotation_vectors(-q), r, rtol=1e-12)


def test_attitude_deg_turns_about_the_fixed_axes() -> None:
    angles = np.array([12.0, -7.0, 30.0])
    ours, scipys = (
        frames.quat_from_attitude_deg(angles),
        Rotation.from_euler("xyz", angles, degrees=True).as_quat(),
    )
    assert abs(ours @ scipys) == pytest.approx(1.0, abs=1e-15)
    np.testing.assert_allclose(
        frames.rotation_matrix(ours),
        Rotation.from_euler("xyz", angles, degrees=True).as_matrix(),
        atol=1e-15,
    )


def test_the_slope_between_two_poses_takes_one_to_the_other(quaternions: np.ndarray) -> None:
    start = np.concatenate([[0.1, -0.2, 0.3], quaternions[0]])
    twist, end, slope = np.array([0.1, 0.2, -0.3, 0.5, -0.4, 0.3]), np.empty(7), np.empty(6)
    frames.pose_step(start, twist, 0.02, end)
    frames.twist_between(start, end, 0.02, slope)
    np.testing.assert_allclose(slope, twist, rtol=1e-12)


def test_mujoco_order_is_undone(quaternions: np.ndarray) -> None:
    np.testing.assert_array_equal(
        frames.quat_from_mujoco(frames.quat_to_mujoco(quaternions)), quaternions
    )
    np.testing.assert_array_equal(
        frames.quat_to_mujoco(np.array([1.0, 2.0, 3.0, 4.0])), [4.0, 1.0, 2.0, 3.0]
    )


PAIRS = ((-1.0, 4.0), (0.5, 1.0), (2.0, 7.0))


def test_between_the_knots_it_is_straight_and_past_the_ends_the_slopes_go_on() -> None:
    curve = packed(PAIRS)
    assert curve.shape == (PACKED,)
    x = np.linspace(-1.0, 2.0, 50)
    np.testing.assert_allclose(
        [along(curve, v) for v in x], np.interp(x, *np.array(PAIRS).T), atol=1e-14
    )
    assert along(curve, -2.0) == pytest.approx(6.0)
    assert along(curve, 3.0) == pytest.approx(11.0)


def test_a_part_keeps_its_last_value() -> None:
    assert between(packed(PAIRS), -2.0) == 4.0
    assert between(packed(PAIRS), 9.0) == 7.0


def test_without_knots_it_is_nothing() -> None:
    assert along(packed(()), 3.0) == between(packed(()), 3.0) == steepest(packed(())) == 0.0
    assert steepest(packed(PAIRS)) == pytest.approx(4.0)


@pytest.mark.parametrize(
    "pairs",
    [
        [[0.0, 1.0]],
        [[0.0, 1.0], [0.0, 2.0]],
        [[0.0, 1.0, 2.0], [1.0, 1.0]],
        [[i, 0.0] for i in range(MOST + 1)],
    ],
)
def test_what_is_no_curve_is_refused(pairs: list[list[float]]) -> None:
    with pytest.raises(ValidationError):
        TypeAdapter(Curve).validate_python(pairs)
