"""Sobol indices against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import qmc

from hiltestbed.campaign.sensitivity import explained_share, sensitivity


def points(n: int, keys: int) -> np.ndarray:
    return qmc.Sobol(keys, rng=1).random(n)


def test_ishigami() -> None:
    """f = sin a + 7 sin^2 b + 0.1 c^4 sin a on [-pi, pi]^3, of which all indices are known
    (Ishigami and Homma 1990).
    """
    x = math.pi * (2.0 * points(2048, 3) - 1.0)
    f = np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    found = sensitivity(["a", "b", "c"], x, f, [False] * 3)
    assert found.explained > 0.99
    first, total = (0.3139, 0.4424, 0.0), (0.5576, 0.4424, 0.2437)
    assert [i.first_order for i in found.indices] == pytest.approx(first, abs=0.01)
    assert [i.total for i in found.indices] == pytest.approx(total, abs=0.01)


def test_a_choice_counts_like_any_key() -> None:
    """y = x + offset(choice): shares are those of the variances; total is first order."""
    u = points(1024, 2)
    choice = np.floor(3.0 * u[:, 1])
    offset = np.array([0.0, 1.0, -0.5])
    y = u[:, 0] + offset[choice.astype(int)]
    found = sensitivity(["x", "c"], np.column_stack([u[:, 0], choice]), y, [False, True])
    share = (1.0 / 12.0) / (1.0 / 12.0 + offset.var())
    for index, expected in zip(found.indices, (share, 1.0 - share), strict=True):
        assert index.first_order == pytest.approx(expected, abs=0.01)
        assert index.total == pytest.approx(expected, abs=0.01)


def test_a_choice_that_turns_the_sign_is_interaction_alone() -> None:
    """y = (x - 1/2) s with s = 1 or -1: neither moves the mean, together they are everything."""
    u = points(512, 2)
    sign = np.where(u[:, 1] < 0.5, 1.0, -1.0)
    found = sensitivity(
        ["x", "s"], np.column_stack([u[:, 0], sign]), (u[:, 0] - 0.5) * sign, [False, True]
    )
    assert [i.total for i in found.indices] == pytest.approx([1.0, 1.0], abs=0.02)
    assert [i.first_order for i in found.indices] == pytest.approx([0.0, 0.0], abs=0.02)


def test_noise_is_not_explained_and_few_cases_give_nothing() -> None:
    rng = np.random.default_rng(2)
    x = rng.random((400, 3))
    found = sensitivity(["a", "b", "c"], x, rng.normal(size=400), [False] * 3)
    assert found.explained < 0.05
    assert sensitivity(["a"], x[:30, :1], x[:30, 0], [False]) is None
    assert sensitivity(["a"], x[:, :1], np.ones(400), [False]) is None


def test_the_share_of_a_key_with_few_values() -> None:
    x = np.repeat([0.0, 1.0], 50)
    y = x + np.tile([0.1, -0.1], 50)
    assert explained_share(x, y) == pytest.approx(0.25 / 0.26)
