"""Signals that have nothing to do with each other, however alike they look."""

from __future__ import annotations

import numpy as np
import pytest

from hiltestbed.axis.models import AxisRun, model_of
from hiltestbed.axis.motion import related
from tests.axis import machines

T = np.arange(0.0, 2000.0) * 1e-3
SINE = np.sin(2.0 * np.pi * 0.7 * T) + 0.3 * np.sin(2.0 * np.pi * 1.9 * T)


def test_walks_are_related_no_more_often_than_chance_says() -> None:
    """The recorded pace is one of 21 that are alike, and the best of them in 4.8 % of all cases."""
    rng = np.random.default_rng(11)
    walks = np.cumsum(rng.standard_normal((100, 2, len(T))), axis=2)
    assert np.mean([related(T, *pair) for pair in walks]) < 0.1
    assert np.mean([related(T, SINE, walk) for walk, _ in walks]) < 0.1
    assert np.mean([related(T, walk, SINE) for walk, _ in walks]) < 0.1


@pytest.mark.parametrize(
    ("position", "other"),
    [
        (lambda r: r.y, machines.carriage),
        (lambda r: r.u, machines.servo),
        (lambda r: r.u, machines.damper),
    ],
)
def test_machines_are(position, other) -> None:
    for seed in (0, 1):
        r = other(seed)
        assert related(r.t, position(r), r.u if other is machines.carriage else r.y)


@pytest.mark.parametrize(
    ("kind", "nominal"), [("drive", {"mass": 2.0}), ("servo", {}), ("damper", {"damping": 5.0})]
)
def test_a_walk_tells_nothing_of_an_axis(kind, nominal) -> None:
    walk = np.cumsum(np.random.default_rng(4).standard_normal((2, len(T))), axis=1) * 1e-3
    u, y = (walk[0], SINE) if kind == "drive" else (SINE, walk[0])
    records = [AxisRun("run", T, u, y)]
    assert "have to do with each other" in (model_of(kind, records, nominal).tells_nothing() or "")
