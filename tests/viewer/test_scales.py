"""Ranges of the plots, and where an estimate is drawn as settled."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest

from hiltestbed.viewer.blueprint import UPWARD, readable, ticks
from hiltestbed.viewer.plots import unsure


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


def test_a_mean_settles_when_its_spread_is_a_tenth_of_it() -> None:
    """The running mean of n samples 1 + sigma e has the error sigma/sqrt(n): below a tenth from
    about n = 100 sigma^2 on.
    """
    rng, sigma, first = np.random.default_rng(1), 1.0, []
    for _ in range(40):
        samples = 1.0 + sigma * rng.standard_normal(4000)
        running = np.cumsum(samples) / np.arange(1, 4001)
        doubt = unsure(running, np.ones(4000, dtype=bool))
        first.append(int(np.flatnonzero(doubt)[-1]))
        assert not doubt[-1]
    assert 100 < np.median(first) < 1000


def test_rows_without_a_sample_keep_what_was_thought_and_none_is_no_trust() -> None:
    values = np.concatenate([np.full(10, np.nan), np.full(90, 3.0)])
    counted = np.arange(100) < 50
    doubt = unsure(values, counted)
    assert doubt[:11].all()
    assert not doubt[20:].any()
    assert unsure(np.full(5, np.nan), np.ones(5, dtype=bool)).all()
