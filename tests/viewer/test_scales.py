"""Ranges of the plots."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest

from hiltestbed.viewer.blueprint import UPWARD, readable, ticks


def test_a_range_holds_what_is_drawn_and_two_labelled_ticks(subtests: pytest.Subtests) -> None:
    for span, place in product(np.geomspace(1e-7, 1e7, 57).tolist(), [0.0, -0.4, -1.0, 7.3]):
        with subtests.test(span=span, place=place):
            low, high = readable(place * span, (place + 1.0) * span)
            assert low < place * span
            assert high > (place + 1.0) * span
            step = 10.0 ** math.floor(math.log10(high - low))
            labelled = step if high - low <= UPWARD * step else 10.0 * step
            assert ticks(low, high, labelled) >= 2
            assert high - low < 25.0 * span  # the curve is not a line in the middle


def test_a_constant_has_a_range() -> None:
    low, high = readable(5.0, 5.0)
    assert low < 5.0 < high
