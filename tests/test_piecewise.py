"""Curves from pairs: between the knots straight, past the ends as the caller asks."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from hiltestbed.config.piecewise import MOST, PACKED, Curve, along, between, packed, steepest

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
