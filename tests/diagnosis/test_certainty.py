"""How well the data hold the estimates: correlation against its closed form, profiles against
refits, bounds that were met.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hiltestbed.diagnosis.certainty import Certainties, certainty
from hiltestbed.diagnosis.fit import Fit, effects_at, fit
from hiltestbed.diagnosis.intervals import intervals
from hiltestbed.diagnosis.links import PlatformLink
from hiltestbed.diagnosis.links.base import Timing
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.effects import EFFECTS
from hiltestbed.effects.search import Candidate, Scales

from .made import POSE_NOISE, H, contact_link, effect, platform_link

BIAS, PRELOAD = 0.6, 6.0
SCALES = Scales(force=300.0, depth=3e-3, stiffness=1e5, tick=H, noise=0.1, slow=0.02, fast=0.1)


def candidate(
    kind: str, names: tuple[str, ...], low: float, high: float, **fixed: object
) -> Candidate:
    """With the same bounds for each parameter, started at a tenth of the upper one."""
    count = len(names)
    bounds = np.full(count, low), np.full(count, high)
    return Candidate(
        EFFECTS[kind], names, *bounds, np.zeros(count, bool), ((0.1 * high,) * count,), fixed
    )


@pytest.fixture(scope="module")
def residual() -> Residual:
    bias = effect("sensor.bias", force=(0.0, 0.0, BIAS), torque=(0.0, 0.0, 0.0))
    return Residual(
        contact_link([effect("contact.preload", force=PRELOAD), bias], speeds=(0.03, 0.05))
    )


@pytest.fixture(scope="module")
def found(residual: Residual) -> Fit:
    bias = candidate(
        "sensor.bias", ("force.0", "force.1", "force.2"), -10.0, 10.0, torque=(0.0, 0.0, 0.0)
    )
    return fit(
        residual,
        (candidate("contact.preload", ("force",), 0.0, 50.0), bias),
        [np.array([5.0, 0.0, 0.0, 1.0])],
    )


def test_the_correlation_of_an_offset_always_and_one_in_contact_is_the_closed_form(
    residual: Residual, found: Fit
) -> None:
    """Columns of ones on all n samples and on the m in contact: the inverse of ((m, m), (m, n)) has
    a correlation of -sqrt(m/n).
    """
    link = residual.link
    counted = [np.isfinite(run.sigma[:, 2]) for run in link.runs]
    with_it, without = (
        link.predict([(i, effects) for i in range(len(link.runs))])
        for effects in ([effect("contact.preload", force=1.0)], [])
    )
    shows = [np.abs(a - b)[:, 2] > 0.5 for a, b in zip(with_it, without, strict=True)]
    m, n = (
        sum(int((s & c).sum()) for s, c in zip(shows, counted, strict=True)),
        sum(int(c.sum()) for c in counted),
    )
    correlation = certainty("wrench", residual, found).correlation
    assert np.diag(correlation) == pytest.approx(1.0, abs=1e-9)
    assert correlation[0, 3] == pytest.approx(-np.sqrt(m / n), abs=0.02)
    assert np.abs(correlation[[0, 1, 2], [1, 2, 3]]).max() < 0.01  # x and y say nothing of z


def test_a_profile_is_what_a_refit_of_the_others_costs(residual: Residual, found: Fit) -> None:
    profiles = certainty("wrench", residual, found).profiles
    misfit = max(1.0, found.chi2 / np.count_nonzero(found.residual))
    for j, other in ((0, 3), (3, 0)):
        profile = profiles[j]
        assert profile.rise[profile.values == found.theta[j]] == pytest.approx(0.0, abs=1e-6)
        assert np.all(np.diff(profile.values) > 0.0)
        for value, rise in zip(profile.values[::4], profile.rise[::4], strict=True):
            best = _least(residual, found, j, float(value), other)
            assert rise == pytest.approx((best - found.chi2) / misfit, rel=0.05, abs=0.02)


def _least(residual: Residual, found: Fit, j: int, value: float, other: int) -> float:
    """Least chi-square over parameter `other` where parameter j has the value, by a parabola: the
    residual is linear in it.
    """
    places, costs = found.theta[other] + np.array([-0.05, 0.0, 0.05]), []
    for place in places:
        theta = found.theta.copy()
        theta[[j, other]] = value, place
        costs.append(square(residual(effects_at(found.causes, theta))))
    a, b, c = np.polyfit(places, costs, 2)
    return float(c - b * b / (4.0 * a))


def test_an_estimate_at_a_bound_says_so(residual: Residual, found: Fit) -> None:
    free = certainty("wrench", residual, found)
    assert [p.met for p in free.profiles] == [None] * 4
    bounded = (candidate("contact.preload", ("force",), 0.0, 0.5 * PRELOAD), found.causes[1])
    short = certainty("wrench", residual, fit(residual, bounded, [np.array([1.0, 0.0, 0.0, 1.0])]))
    assert [p.met for p in short.profiles] == ["highest", None, None, None]
    assert short.profiles[0].values[-1] == 0.5 * PRELOAD


def test_what_was_fitted_once_is_worked_out_once(residual: Residual, found: Fit) -> None:
    explained = SimpleNamespace(
        residual=residual, candidates=(), departs=True, adequate=True, chosen=found, rivals=()
    )
    certain = Certainties({"wrench": explained})  # type: ignore[dict-item]
    assert certain.of("wrench", found) is certain.of("wrench", found)
    assert len(list(certain)) == 1
    data = next(iter(certain)).to_json()
    assert data["parameters"] == [
        "contact.preload force",
        *(f"sensor.bias force.{i}" for i in range(3)),
    ]


def test_a_cause_without_a_number_has_no_profile_and_no_correlation(residual: Residual) -> None:
    none = np.zeros(0)
    euler = Candidate(
        EFFECTS["dynamics.integrator"],
        (),
        none,
        none,
        np.zeros(0, bool),
        ((),),
        {"scheme": "explicit_euler"},
    )
    told = certainty("wrench", residual, fit(residual, (euler,), euler.grid))
    assert told.profiles == ()
    assert told.correlation.shape == (0, 0)


def test_the_interval_of_a_response_holds_however_finely_the_facility_steps_it() -> None:
    """x'' = w^2 (u - x) - 1.4 w x', stepped semi-implicitly in 20 or 100 parts of a tick: a bias of
    up to 0.7 % that no misfit shows.
    """
    link, rng = platform_link(speeds=(0.03,)), np.random.default_rng(5)
    command, (plain, stepped) = link.commands[0][:, 2], EFFECTS["platform.lag"].candidates(SCALES)
    for steps, bandwidth in ((20, 32.0), (20, 45.0), (100, 32.0)):
        w, dt, x, v = 2.0 * np.pi * bandwidth, H / steps, -0.0030, 0.03
        node, reached = np.concatenate([[x], command]), [x]
        for k in range(len(command) - 1):
            for j in range(steps):
                v += dt * (
                    w * w * (node[k] + (node[k + 1] - node[k]) * (j + 1) / steps - x) - 1.4 * w * v
                )
                x += dt * v
            reached.append(x)
        measured = link.shown(0) + POSE_NOISE * rng.standard_normal((len(command), 6))
        measured[:, 2] += np.array(reached) - link.shown(0)[:, 2]
        residual = Residual(
            PlatformLink(
                [replace(link.runs[0], measured=measured)],
                link.commands,
                [np.zeros((len(command), 6))],
            )
        )
        found = fit(residual, (plain,), plain.grid)
        low, high = certainty("platform", residual, found, (plain, stepped)).ends[0]
        assert low < bandwidth < high
        assert high - low < 0.1 * bandwidth  # of one bounce
        if steps == 20:
            # without the variant it does not
            assert not np.prod(certainty("platform", residual, found).ends[0] - bandwidth) < 0.0


def test_an_interval_holds_the_uncertainty_of_a_timing_that_was_estimated() -> None:
    """Of a stamp that was found 0.3 ms late where it is not, a lag makes up by its bandwidth: 2
    zeta / w less 0.3 ms.
    """
    link = platform_link([effect("platform.lag", bandwidth=40.0)])
    believed, off = Residual(link), Residual(link.with_timing(Timing(delay=0.3 * H)))
    lag = candidate("platform.lag", ("bandwidth",), 2.0, 400.0)
    right, wrong = (fit(residual, (lag,), [np.array([38.0])]) for residual in (believed, off))
    lagging = 1.4 / (2.0 * np.pi)
    assert lagging / wrong.theta[0] == pytest.approx(lagging / 40.0 - 0.3 * H, abs=0.05 * H)
    low, high = intervals(off, wrong).ends[0]
    assert not low <= 40.0 <= high
    (low, high), (near, far) = (
        certainty("platform", off, wrong).ends[0],
        certainty("platform", believed, right).ends[0],
    )
    assert low <= 40.0 <= high
    # as believed: nothing was estimated
    assert (near, far) == tuple(intervals(believed, right).ends[0])
