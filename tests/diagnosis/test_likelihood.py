"""One likelihood for the links of the loop: its parts against closed forms."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.linalg import cho_factor, cho_solve
from scipy.stats import norm

from hiltestbed.diagnosis.explain import explain
from hiltestbed.diagnosis.investigate import candidates_of
from hiltestbed.diagnosis.isolability import detectable
from hiltestbed.diagnosis.layout import lay_out
from hiltestbed.diagnosis.link_model import LinkModel, leftover
from hiltestbed.diagnosis.paths import best_path, make_wrench_link
from hiltestbed.diagnosis.recorded import dynamics_link
from hiltestbed.inference.likelihood import Likelihood, independent
from hiltestbed.inference.model import Hypothesis
from hiltestbed.inference.residuals import Changes, Gram, RunResiduals
from hiltestbed.measured import MeasuredDataset
from tests.diagnosis.recorded import drawn

FLOOR = 1.2
PRELOADED = ("contact.preload", "contact.stiffness", "contact.damping")
NOTHING = Hypothesis((), np.zeros(0), np.zeros(0))


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> MeasuredDataset:
    return drawn(tmp_path_factory.mktemp("healthy"), 400_126)


@cache
def white(count: int) -> list[list[np.ndarray]]:
    rng = np.random.default_rng(3)
    return [[rng.standard_normal(400) for _ in range(6)] for _ in range(count)]


def test_white_noise_passes_whatever_its_level() -> None:
    for level in (0.1, 1.0, 30.0):
        assert all(leftover([level * x for x in parts]).noise for parts in white(200))


@pytest.mark.parametrize("shape", ["line", "drift"])
def test_what_is_not_white_is_seen_below_the_noise(shape: str) -> None:
    t = np.arange(400)
    more = 0.5 * np.sin(0.3 * t) if shape == "line" else 0.5 * np.sin(2.0 * np.pi * t / 400)
    assert not any(leftover([x + more for x in parts]).noise for parts in white(20))


def test_above_its_floor_a_run_counts_by_its_share_and_below_by_its_square(
    healthy: MeasuredDataset,
) -> None:
    """-2 log of the normal density, maximised over a variance that is not below 1."""
    model = LinkModel(dynamics_link(lay_out(healthy), [400] * 6))
    likelihood = Likelihood(model, np.full(len(model.runs), 100.0))
    for level in (0.5, 1.0, 3.0):
        x = level * white(1)[0][0][:100]
        ms = float(np.mean(x * x))
        density = -2.0 * float(np.sum(norm.logpdf(x, scale=math.sqrt(max(ms, 1.0)))))
        left = RunResiduals.of([x] * len(model.runs) + [np.zeros(0)])
        cost = likelihood.cost(left) / len(model.runs)
        assert cost == pytest.approx(density - 100.0 * math.log(2.0 * math.pi), rel=1e-12)


def test_scalar_products_give_the_squares_of_what_is_moved() -> None:
    rng = np.random.default_rng(4)
    left = RunResiduals.of([rng.normal(size=n) for n in (50, 1, 200)] + [rng.normal(size=2)])
    known, more = (
        Changes(rng.normal(size=(p, 251)), rng.normal(size=(p, q))) for p, q in ((3, 2), (2, 3))
    )
    wider, step = left.with_priors(np.zeros(1)), rng.normal(size=5)
    gram = Gram.of(left, known).and_(wider, known, more)
    samples = left.samples + step @ np.vstack([known.samples, more.samples])
    moved = RunResiduals(samples, left.starts, wider.priors)
    squares = np.einsum("i,j,ijr->r", step, step, gram.products) + 2.0 * step @ gram.along
    assert wider.squares() + squares / left.rows == pytest.approx(moved.squares(), rel=1e-12)
    priors = step @ np.vstack([np.pad(known.priors, ((0, 0), (0, 1))), more.priors])
    change = step @ gram.priors @ step + 2.0 * step @ gram.along_priors
    moved_priors = float(np.sum((wider.priors + priors) ** 2))
    assert float(wider.priors @ wider.priors) + change == pytest.approx(moved_priors, rel=1e-12)


def test_errors_of_a_recorded_force_leave_the_motion_white(healthy: MeasuredDataset) -> None:
    """Forces with white errors, integrated: the innovations are white, with a variance of 1, and
    those of a channel tell nothing of another's, though a force across moves and turns a body.
    """
    layout, rng = lay_out(healthy), np.random.default_rng(1)
    link = dynamics_link(layout, layout.rows)
    sigma = 5.0
    variance = [np.full((r.rows, 6), sigma**2) for r in link.runs]
    filtered, gains = link.with_input_errors(variance), link._gains()
    z = []
    for i, run in enumerate(link.runs):
        pushed = sigma * rng.standard_normal((run.rows, 6)) @ gains.T
        away = np.cumsum(np.cumsum(pushed, axis=0), axis=0)
        noise = run.sigma * rng.standard_normal(run.sigma.shape)
        z.append(filtered.whitened(i, away + noise))
    x = np.concatenate(z)
    assert float(np.mean(x * x)) == pytest.approx(1.0, abs=5.0 * math.sqrt(2.0 / x.size))
    assert float(np.mean(x[1:] * x[:-1])) == pytest.approx(0.0, abs=5.0 / math.sqrt(x.size))
    across = x.T @ x / len(x)
    assert np.abs(across - np.diag(np.diag(across))).max() < 5.0 / math.sqrt(len(x))


def test_a_delay_that_varies_has_the_likelihood_of_its_variance(healthy: MeasuredDataset) -> None:
    """-2 log of the normal density with the whole covariance, beside that without the jitter's."""
    layout = lay_out(healthy)
    model = LinkModel(make_wrench_link(layout, best_path(layout, None), layout.rows))
    jitter = next(c for c in candidates_of(layout.scales, ("sensor",)) if c.kind == "sensor.jitter")
    model.floors = np.full(len(model.runs), FLOOR)  # above what any group's noise happens to be
    counts = independent(model.residuals(NOTHING), noise_known=True)
    likelihood = Likelihood(model, counts)
    of = Hypothesis((jitter,), np.array([layout.scales.tick]), np.zeros(0))
    total = 0.0
    for i, shown in zip(
        model.members, model.link.predict([(i, of.each()) for i in model.members]), strict=True
    ):
        mean, ratio = model._spread(i, shown, of.each())
        columns, left = model._noise(i).columns, model.link.runs[i].measured - mean
        for c in range(6):
            before, after = (
                cho_factor(
                    np.eye(len(mean))
                    + (w[:, None] * columns[:, c]) @ (w[:, None] * columns[:, c]).T
                )
                for w in (model.weight[i][:, c], model.weight[i][:, c] / ratio[:, c])
            )
            z = left[:, c] * model.weight[i][:, c] / ratio[:, c]
            total += float(z @ cho_solve(after, z)) / FLOOR**2
            total += 2.0 * float(np.sum(np.log(np.diag(after[0]) / np.diag(before[0]))))
            counted = model.weight[i][:, c] > 0.0
            total += 2.0 * float(np.sum(np.log(FLOOR * ratio[counted, c])))
    assert likelihood.cost(model.residuals(of)) == pytest.approx(total, rel=1e-9)


def test_the_size_of_a_jitter_is_that_of_its_delays(healthy: MeasuredDataset) -> None:
    """To a share of the root of the deviations' squares, in contact weighed by the force's rate:
    what else is known of the readings are their noise, and 0.1 % of the force.
    """
    layout, rng = lay_out(healthy), np.random.default_rng(12)
    link = make_wrench_link(layout, best_path(layout, None), layout.rows)
    jitter = next(c for c in candidates_of(layout.scales, ("sensor",)) if c.kind == "sensor.jitter")
    sigma, runs, squares, weights = 2.0 * layout.scales.tick, [], 0.0, 0.0
    for i, run in enumerate(link.runs):
        (shown,), late = link.predict([(i, ())]), 2.0 * rng.standard_normal(run.rows)
        rows = np.arange(run.rows)
        read = np.column_stack([np.interp(rows - late, rows, x) for x in shown.T])
        noise = np.where(np.isfinite(run.sigma), run.sigma, 0.0)
        runs.append(replace(run, measured=read + noise * rng.standard_normal(read.shape)))
        rate = np.gradient(shown[:, 2]) ** 2
        squares, weights = squares + float(rate @ late**2), weights + float(rate.sum())
    jittery = copy(link)
    jittery.runs = runs
    model = LinkModel(jittery)
    likelihood = Likelihood(model, independent(model.residuals(NOTHING), noise_known=True))
    found = likelihood.fit((jitter,), [np.array([layout.scales.tick])])
    assert model.leaves_noise(found.left)
    assert found.of.theta[0] / sigma == pytest.approx(0.5 * math.sqrt(squares / weights), rel=0.03)


@pytest.mark.parametrize(("part", "kinds"), [(0.25, ()), (2.0, ("contact.preload",))])
def test_an_effect_is_named_at_twice_the_size_that_shows_and_not_at_a_quarter_of_it(
    healthy: MeasuredDataset, part: float, kinds: tuple[str, ...]
) -> None:
    layout = lay_out(healthy)
    link = make_wrench_link(layout, best_path(layout, None), layout.rows)
    candidates = [c for c in candidates_of(layout.scales, ("contact",)) if c.kind in PRELOADED]
    (least,) = (d for d in detectable(LinkModel(link), candidates) if d.kind == "contact.preload")
    more = zip(link.shown_in_all(least.effects), link.shown_in_all(), strict=True)
    pairs = zip(link.runs, more, strict=True)
    acting = copy(link)
    acting.runs = [replace(r, measured=r.measured + part * (a - b)) for r, (a, b) in pairs]
    assert explain(LinkModel(acting), candidates).kinds == kinds
