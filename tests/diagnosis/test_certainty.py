"""How well the data hold the estimates: correlation against its closed form, profiles against
refits, bounds that were met, and intervals that hold what is not asked for.
"""

from __future__ import annotations

import numpy as np
import pytest

from hiltestbed.diagnosis.certainty import certainty
from hiltestbed.diagnosis.explain import Explanation, explain
from hiltestbed.diagnosis.link_model import LinkModel
from hiltestbed.effects import EFFECTS
from hiltestbed.effects.search import Candidate

from .made import candidates, contact_link, effect, platform_link

BIAS, PRELOAD = 0.6, 6.0


def candidate(
    kind: str, names: tuple[str, ...], low: float, high: float, **fixed: object
) -> Candidate:
    """With the same bounds for each parameter, started at a tenth of the upper one."""
    count = len(names)
    bounds = np.full(count, low), np.full(count, high)
    return Candidate(
        EFFECTS[kind], names, *bounds, np.zeros(count, bool), ((0.1 * high,) * count,), fixed
    )


def of_preload(most: float = 50.0) -> Explanation:
    """A preload and a bias on z, found again among just these, by clocks that are known."""
    bias = effect("sensor.bias", force=(0.0, 0.0, BIAS), torque=(0.0, 0.0, 0.0))
    link = contact_link([effect("contact.preload", force=PRELOAD), bias], speeds=(0.03, 0.05))
    offset = candidate("sensor.bias", ("force.2",), -10.0, 10.0, torque=(0.0, 0.0, 0.0))
    preload = candidate("contact.preload", ("force",), 0.0, most)
    return explain(LinkModel(link).as_timed(), (preload, offset))


@pytest.fixture(scope="module")
def found() -> Explanation:
    return of_preload()


def test_the_correlation_of_two_estimates_is_that_of_what_they_change(found: Explanation) -> None:
    """Of two numbers it is the cosine between the changes that they make, with the other sign."""
    model, of = found.model, found.fit.of
    base = np.concatenate(model.residuals(of))
    first, second = (
        np.concatenate(model.residuals(of._replace(theta=of.theta + step))) - base
        for step in 1e-3 * np.eye(2)
    )
    cosine = first @ second / np.sqrt((first @ first) * (second @ second))
    correlation = certainty("wrench", found).correlation
    assert np.diag(correlation) == pytest.approx(1.0, abs=1e-9)
    assert correlation[0, 1] == pytest.approx(-cosine, abs=1e-3)
    assert 0.1 < abs(cosine) < 0.9


def test_a_profile_is_what_a_refit_of_the_others_costs(found: Explanation) -> None:
    """The residual is linear in both numbers: the least over the other is that of a parabola."""
    profiles, likelihood, theta = (
        certainty("wrench", found).profiles,
        found.likelihood,
        found.fit.of.theta,
    )
    for j, profile in enumerate(profiles):
        assert np.all(np.diff(profile.values) > 0.0)
        for value, rise in zip(profile.values[::4], profile.rise[::4], strict=True):
            points = np.tile(theta, (3, 1))
            points[:, j], points[:, 1 - j] = value, theta[1 - j] + np.array([-0.05, 0.0, 0.05])
            costs = [likelihood.cost(x) for x in likelihood.lefts(found.fit.causes, list(points))]
            a, b, c = np.polyfit(points[:, 1 - j], costs, 2)
            least = c - b * b / (4.0 * a) - likelihood.cost(found.fit.left)
            assert rise == pytest.approx(least, rel=0.05, abs=0.02)


def test_what_would_stand_at_a_bound_of_its_search_is_not_named(found: Explanation) -> None:
    """It stands in for something else, or for a size that was not thought possible."""
    assert [p.met for p in certainty("wrench", found).profiles] == [None] * 2
    short = of_preload(0.5 * PRELOAD)
    assert not short.adequate
    assert "contact.preload" not in short.kinds


def test_a_stamp_that_is_off_is_in_the_interval_of_a_lag() -> None:
    """A lag of bandwidth f is late by 1.4/(2 pi f); a pose that is also stamped 0.3 ms late tells
    that lateness no better than the stamp is known.
    """
    link = platform_link([effect("platform.lag", bandwidth=40.0)])
    e = explain(LinkModel(link), candidates("platform.lag"))
    assert e.kinds == ("platform.lag",)
    (bandwidth,) = (x for x in e.causes[0].estimates if x.name == "bandwidth")
    assert bandwidth.low <= 40.0 <= bandwidth.high
