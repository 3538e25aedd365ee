"""From the explanations of the links to one verdict, on links that are made by themselves."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2, norm

from hiltestbed.diagnosis.adequacy import contact_leftovers, leftover
from hiltestbed.diagnosis.find import cause_of
from hiltestbed.diagnosis.heldout import heldout, placebo_of
from hiltestbed.diagnosis.intervals import intervals
from hiltestbed.diagnosis.investigate import Findings
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.search import Explanation, Search
from hiltestbed.diagnosis.settings import AMBIGUITY
from hiltestbed.diagnosis.verdict import Named, decide
from hiltestbed.effects import EFFECTS
from hiltestbed.effects.search import Candidate
from hiltestbed.frames import Array

from .made import SCALES, H, contact_link, effect, reread

WEIGHED = (
    "contact.stiffness",
    "contact.damping",
    "contact.preload",
    "sensor.gain",
    "sensor.delay",
    "sensor.bias",
)
SPEEDS = (0.02, 0.03, 0.045)


def candidates(*kinds: str) -> tuple[Candidate, ...]:
    return tuple(c for kind in kinds for c in EFFECTS[kind].candidates(SCALES))


def explained(*hidden: Any, kinds: tuple[str, ...] = WEIGHED) -> Explanation:
    return Search(candidates(*kinds)).explain(Residual(contact_link(hidden, speeds=SPEEDS)))


def findings(missing: dict[str, str] | None = None, **explanations: Explanation) -> Findings:
    return Findings(None, dict(explanations), missing or {}, {})  # type: ignore[arg-type]


@cache
def healthy() -> Explanation:
    return explained()


def test_nothing_hidden_nothing_said() -> None:
    assert not healthy().departs
    verdict = decide(findings(wrench=healthy()))
    assert (verdict.verdict, verdict.link, verdict.causes) == ("no_discrepancy", None, ())


def test_where_a_link_was_not_judged_nothing_is_vouched_for() -> None:
    verdict = decide(findings({"platform": "needs pose_cmd"}, wrench=healthy()))
    assert verdict.verdict == "inconclusive"
    assert verdict.not_judged == {"platform": "needs pose_cmd"}
    assert decide(findings({"wrench": "needs a contact"})).verdict == "inconclusive"


def test_a_cause_is_named_with_its_size() -> None:
    e = explained(effect("contact.preload", force=6.0))
    verdict = decide(findings(wrench=e))
    assert verdict.verdict == "named"
    assert [c.effect for c in verdict.causes] == ["contact.preload"]
    ends = intervals(e.residual, e.chosen).ends
    # 1000 rows in contact with 0.1 N each: 0.1/sqrt(1000) = 3 mN.
    assert e.chosen.theta[0] == pytest.approx(6.0, abs=0.02)
    assert ends[0, 0] <= 6.0 <= ends[0, 1]
    assert ends[0, 1] - ends[0, 0] < 0.1


def test_two_causes_are_named_the_stronger_first() -> None:
    e = explained(
        effect("contact.preload", force=6.0),
        effect("sensor.bias", force=(0.0, 0.0, 0.6), torque=(0.0, 0.0, 0.0)),
    )
    verdict = decide(findings(wrench=e))
    assert verdict.verdict == "named"
    assert [c.effect for c in verdict.causes] == ["contact.preload", "sensor.bias"]
    assert verdict.causes[0].weight > verdict.causes[1].weight


def test_two_causes_that_do_the_same_are_both_said() -> None:
    """Along z a stiffness and a damping by one factor are a gain."""
    e = explained(
        effect("sensor.gain", factor=1.2, axis="z"), kinds=("sensor.gain", "contact.stiffness")
    )
    assert decide(findings(wrench=e)).verdict == "named"  # the damper tells
    twin = replace(e, rivals=((e.singles[1],),))
    verdict = decide(findings(wrench=twin))
    assert verdict.verdict == "ambiguous"
    assert verdict.causes[0].indistinguishable_from == ["contact.stiffness"]
    assert 0.5 < verdict.causes[0].probability <= 1.0
    other = effect("sensor.delay", delay=2e-3)
    both = Named("sensor.delay", "dynamics", explained(other, kinds=("sensor.delay",)).chosen, 0)
    (told,) = cause_of(
        findings(wrench=twin), verdict.causes[0], None, (*verdict.causes, both)
    ).alternatives
    # all of it, with what is named elsewhere
    assert [entry["kind"] for entry in told] == ["contact.stiffness", "sensor.delay"]
    assert told[0]["factor"] == e.singles[1].theta[0]
    assert told[1]["delay"] == pytest.approx(2e-3, rel=1e-3)


def test_a_second_spring_that_acts_from_the_touch_on_is_no_rival_of_a_stiffness() -> None:
    e = explained(
        effect("contact.stiffness", factor=1.08), kinds=("contact.stiffness", "contact.hard_stop")
    )
    # it was tried, and fits: noise lets its position be anything near nought
    assert len(e.singles) == 2
    assert e.singles[1].chi2 < e.chosen.chi2 + AMBIGUITY
    assert decide(findings(wrench=e)).verdict == "named"
    assert e.rivals == ((),)


def test_what_no_cause_explains_is_unknown_and_what_is_known_elsewhere_is_kept() -> None:
    lopsided = contact_link(speeds=SPEEDS)
    t = np.arange(500) * H
    wave = [
        run.measured + 3.0 * (np.sin(2 * np.pi * 40 * t**1.7) * run.touching)[:, None]
        for run in lopsided.runs
    ]
    e = Search(candidates(*WEIGHED)).explain(Residual(reread(lopsided, wave)))
    known = explained(effect("contact.preload", force=6.0))
    verdict = decide(findings(wrench=e, dynamics=known))
    assert (verdict.verdict, verdict.link) == ("unknown", "contact")
    assert [c.effect for c in verdict.causes] == ["contact.preload"]


def test_stages_leave_what_they_are_given_as_it_is() -> None:
    residual = Residual(contact_link([effect("contact.preload", force=6.0)], speeds=SPEEDS))
    before = [x.copy() for x in (*(r.measured for r in residual.link.runs), *residual.weight)]
    found = MappingProxyType({"wrench": Search(candidates(*WEIGHED)).explain(residual)})
    decide(Findings(None, found, {}, {}))  # type: ignore[arg-type]
    after = (*(r.measured for r in residual.link.runs), *residual.weight)
    for was, now in zip(before, after, strict=True):
        np.testing.assert_array_equal(was, now)


def test_the_gain_on_left_out_runs_is_that_of_the_cause_and_not_of_its_parameters() -> None:
    e = explained(effect("contact.preload", force=6.0))
    gain = heldout(e.residual, e.chosen, placebo_of(e.singles, e.chosen))
    assert gain is not None
    assert gain.significant
    assert gain.rms_after == pytest.approx(1.0, abs=0.05)
    assert gain.rms_before > 10.0
    assert gain.placebo_reduction < 0.5 * gain.reduction
    assert heldout(healthy().residual, healthy().chosen, None) is None


def noise(rows: int, smooth: int = 1, size: float = 1.0) -> Array:
    white = np.random.default_rng(5).standard_normal(rows + smooth - 1)
    return np.convolve(white, np.full(smooth, size / np.sqrt(smooth)), "valid")


def test_white_noise_at_its_floor_passes_and_what_is_smooth_below_it_does_not() -> None:
    assert leftover([noise(1000), noise(800)]).noise
    assert not leftover([noise(3000, size=1.2)]).noise
    # adds an eighth to the variance, and a whole to that of means of eight
    wave = noise(3000) + 0.5 * np.sin(np.arange(3000) / 40.0)
    assert not leftover([wave]).noise


def test_a_log_slower_than_the_loop_knows_its_noise_floor_from_its_samples_and_not_from_its_ticks() -> (
    None
):
    """The floor of a variance errs by 8 % from 1500 samples, and by the root of their number more
    from fewer.
    """
    link = contact_link((), speeds=SPEEDS)
    fourth = [
        np.where(np.arange(run.rows)[:, None] % 4 == 0, run.sigma, np.inf) for run in link.runs
    ]
    link.runs = [replace(run, sigma=sigma) for run, sigma in zip(link.runs, fourth, strict=True)]
    samples = sum(
        int(np.isfinite(s[~run.touching, 2]).sum())
        for run, s in zip(link.runs, fourth, strict=True)
    )
    left = contact_leftovers(Residual(link), ())["wrench_meas.fz"]
    assert samples < 1500
    chance = chi2.isf(norm.sf(4.5), left.samples) / left.samples
    assert left.variance_limit == pytest.approx(0.08 * np.sqrt(1500 / samples) + chance, rel=1e-3)


@pytest.mark.parametrize("rows", [24, 80, 400, 8000])
def test_a_few_samples_of_noise_are_exceeded_as_rarely_as_many(rows: int) -> None:
    """Of sums of squares the chi-square distribution knows how often. A normal one would put the
    limit of 3 means of eight at 4.7: exceeded in 3 of 1000, not in 3 of a million.
    """
    left = leftover([noise(rows)])
    for limit, count in ((left.variance_limit, rows), (left.block_limit, rows // 8)):
        assert limit - 0.08 == pytest.approx(chi2.isf(norm.sf(4.5), count) / count, rel=0.07)
