"""Runs that contradict each other are told as such, and where in position a residual sits."""

from __future__ import annotations

import numpy as np
import pytest

from hiltestbed.diagnosis.explain import Explanation
from hiltestbed.diagnosis.unexplained import contradiction, describe
from hiltestbed.effects import Effect
from hiltestbed.frames import Array
from hiltestbed.inference.residuals import range_of_half

from .made import contact_link, effect, explained, reread
from .test_verdict import SPEEDS


def of_readings(measured: list[Array]) -> Explanation:
    """What is made of readings of one contact a speed."""
    kinds = "contact.stiffness", "contact.damping", "contact.preload"
    return explained(reread(contact_link(speeds=SPEEDS), measured), *kinds)


def readings(i: int, *hidden: Effect) -> Array:
    return contact_link(hidden, seed=i, speeds=SPEEDS).runs[i].measured


@pytest.mark.parametrize("least", [0.93, 1.0 - 0.02 * (len(SPEEDS) - 1)])
def test_a_stiffness_of_its_own_in_each_run_is_a_contradiction(least: float) -> None:
    """Also where the runs together have the nominal one."""
    factors = [least + 0.04 * i for i in range(len(SPEEDS))]
    found = of_readings(
        [readings(i, effect("contact.stiffness", factor=f)) for i, f in enumerate(factors)]
    )
    assert not found.adequate
    words = contradiction(found)
    assert words.startswith("the runs contradict each other: contact.stiffness explains each")
    for i, factor in enumerate(factors):
        (told,) = [w for w in words.split("factor ") if w.rstrip(", )").endswith(f" in run {i}")]
        assert float(told.split()[0]) == pytest.approx(factor, abs=2e-3)


def test_an_effect_without_a_name_is_no_contradiction_and_has_its_place() -> None:
    """A bump of 4 N over 0.1 mm of the penetration, the same in every run."""
    paths = contact_link(speeds=SPEEDS).paths
    bump = [4.0 * np.exp(-0.5 * ((p[:, 2] - 6e-4) / 5e-5) ** 2) for p in paths]
    along = np.arange(6) == 2
    found = of_readings([readings(i) + b[:, None] * along for i, b in enumerate(bump)])
    assert contradiction(found) == ""
    words = describe(found, "contact").partition("half of it sits between ")[2]
    low, _, high = words.partition(" mm")[0].partition(" and ")
    assert 0.5 < float(low) < 0.6 < float(high) < 0.7


def test_the_range_of_half_of_the_squares_is_the_shortest() -> None:
    """Of a normal bell of the squares: 0.674 standard deviations to each side."""
    position = np.linspace(-10.0, 10.0, 20_001)
    low, high = range_of_half(position, np.exp(-0.25 * (position - 2.0) ** 2))
    assert (low, high) == pytest.approx((2.0 - 0.674, 2.0 + 0.674), abs=0.2)
    assert range_of_half(np.arange(10.0), np.eye(10)[9]) == pytest.approx((8.91, 9.0))
