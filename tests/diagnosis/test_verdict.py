"""From the explanations of the links to one verdict, on links that are made by themselves."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

from hiltestbed.diagnosis.explain import Explanation, explain
from hiltestbed.diagnosis.find import cause_of, heldout
from hiltestbed.diagnosis.investigate import Findings
from hiltestbed.diagnosis.link_model import LinkModel
from hiltestbed.diagnosis.verdict import Named, decide

from .made import H, candidates, contact_link, effect, reread
from .made import explained as explained_link

WEIGHED = (
    "contact.stiffness",
    "contact.damping",
    "contact.preload",
    "sensor.gain",
    "sensor.delay",
    "sensor.bias",
)
SPEEDS = (0.02, 0.03, 0.045)


def explained(*hidden: Any, kinds: tuple[str, ...] = WEIGHED) -> Explanation:
    """By clocks that are known."""
    link = contact_link(hidden, speeds=SPEEDS)
    return explain(LinkModel(link).as_timed(), candidates(*kinds))


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
    (found,) = e.causes[0].estimates
    # 1000 rows in contact with 0.1 N each: 0.1/sqrt(1000) = 3 mN.
    assert found.value == pytest.approx(6.0, abs=0.02)
    assert found.low <= 6.0 <= found.high
    assert found.high - found.low < 0.1


def test_two_causes_are_named_the_stronger_first() -> None:
    e = explained(
        effect("contact.preload", force=6.0),
        effect("sensor.bias", force=(0.0, 0.0, 0.6), torque=(0.0, 0.0, 0.0)),
    )
    verdict = decide(findings(wrench=e))
    assert verdict.verdict == "named"
    assert [c.effect for c in verdict.causes] == ["contact.preload", "sensor.bias"]
    assert verdict.causes[0].cause.gain > verdict.causes[1].cause.gain


def test_two_causes_that_do_the_same_are_both_said() -> None:
    """Along z a stiffness and a damping by one factor are a gain."""
    e = explained(
        effect("sensor.gain", factor=1.2, axis="z"), kinds=("sensor.gain", "contact.stiffness")
    )
    assert decide(findings(wrench=e)).verdict == "named"  # the damper tells
    (stiffness,) = candidates("contact.stiffness")
    rival = e.likelihood.fit((stiffness,), [np.array([1.2])])
    alike = replace(e.causes[0], rivals=("contact.stiffness",), others=(rival,), probability=0.6)
    twin = replace(e, conclusion=replace(e.conclusion, causes=(alike,)))
    verdict = decide(findings(wrench=twin))
    assert verdict.verdict == "ambiguous"
    assert verdict.causes[0].indistinguishable_from == ("contact.stiffness",)
    other = effect("sensor.delay", delay=2e-3)
    both = Named("dynamics", explained(other, kinds=("sensor.delay",)).causes[0])
    (told,) = cause_of(verdict.causes[0], (*verdict.causes, both)).alternatives
    # all of it, with what is named elsewhere
    assert [entry["kind"] for entry in told] == ["contact.stiffness", "sensor.delay"]
    assert told[0]["factor"] == rival.of.theta[0]
    # a run's integration may err by 0.05 rows, 50 us: three runs know the delay to 30 us, and all
    # of them together err by noise of 4 us at most
    assert told[1]["delay"] == pytest.approx(2e-3, rel=2e-3)


def test_a_second_spring_that_acts_from_the_touch_on_is_no_rival_of_a_stiffness() -> None:
    e = explained(
        effect("contact.stiffness", factor=1.08), kinds=("contact.stiffness", "contact.hard_stop")
    )
    assert decide(findings(wrench=e)).verdict == "named"
    assert e.kinds == ("contact.stiffness",)
    assert e.causes[0].rivals == ()


def test_what_no_cause_explains_is_unknown_and_what_is_known_elsewhere_is_kept() -> None:
    lopsided = contact_link(speeds=SPEEDS)
    t = np.arange(500) * H
    wave = [
        run.measured + 3.0 * (np.sin(2 * np.pi * 40 * t**1.7) * run.touching)[:, None]
        for run in lopsided.runs
    ]
    e = explained_link(reread(lopsided, wave), "contact.stiffness", "contact.damping")
    known = explained(effect("contact.preload", force=6.0))
    verdict = decide(findings(wrench=e, dynamics=known))
    assert (verdict.verdict, verdict.link) == ("unknown", "contact")
    assert [c.effect for c in verdict.causes] == ["contact.preload"]


def test_stages_leave_what_they_are_given_as_it_is() -> None:
    link = contact_link([effect("contact.preload", force=6.0)], speeds=SPEEDS)
    before = [x.copy() for r in link.runs for x in (r.measured, r.sigma)]
    found = MappingProxyType({"wrench": explained_link(link, *WEIGHED)})
    decide(Findings(None, found, {}, {}))  # type: ignore[arg-type]
    after = [x for r in link.runs for x in (r.measured, r.sigma)]
    for was, now in zip(before, after, strict=True):
        np.testing.assert_array_equal(was, now)


def test_the_gain_on_left_out_runs_is_that_of_the_cause_and_not_of_its_parameters() -> None:
    e = explained(effect("contact.preload", force=6.0))
    gain = heldout(e, e.fit)
    assert gain.significant
    assert gain.rms_after == pytest.approx(1.0, abs=0.05)
    assert gain.rms_before > 10.0
    assert gain.placebo_reduction < 0.5 * gain.reduction
    assert heldout(healthy(), healthy().fit) is None
