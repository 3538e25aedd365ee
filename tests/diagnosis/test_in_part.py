"""A cause holds where something else is at work as well; what stands in for something else does
not.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from hiltestbed.diagnosis.adequacy import contact_leftovers
from hiltestbed.diagnosis.fit import fit, null_fit
from hiltestbed.diagnosis.in_part import (
    at_bound,
    explained,
    holding,
    in_each_run,
    same_in_each,
    varies,
)
from hiltestbed.diagnosis.report.page import TITLES
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.result import VERDICTS
from hiltestbed.diagnosis.search import Explanation, Search
from hiltestbed.effects import Effect

from .made import H, contact_link, effect, reread
from .test_verdict import SPEEDS, WEIGHED, candidates


@cache
def disturbed(*hidden: Effect, size: float = 1.0) -> Explanation:
    """What a search makes of contacts with `hidden` and a chirp [N] in them that the vocabulary has
    no name for.
    """
    link = contact_link(hidden, speeds=SPEEDS)
    t = np.arange(500) * H
    wave = [
        run.measured + size * (np.sin(2 * np.pi * 40 * t**1.7 + i) * run.touching)[:, None]
        for i, run in enumerate(link.runs)
    ]
    return Search(candidates(*WEIGHED)).explain(Residual(reread(link, wave)))


def test_a_cause_beside_a_disturbance_is_named_in_part() -> None:
    e = disturbed(effect("contact.preload", force=6.0))  # type: ignore[arg-type]  # frozen, thus hashable
    assert e.departs
    assert not e.adequate
    kept = [e.chosen.kinds[i] for i in holding(e)]
    assert kept == ["contact.preload"]
    assert explained(e) > 0.3


def test_a_disturbance_alone_has_no_part_that_holds() -> None:
    e = disturbed(size=3.0)
    assert not e.adequate
    assert holding(e) == ()


def test_a_cause_has_one_size_in_each_run_and_a_stand_in_has_not() -> None:
    """A preload that grows with the speed of the approach is none."""
    preload = candidates("contact.preload")[0]
    steady = Residual(contact_link([effect("contact.preload", force=6.0)], speeds=SPEEDS))
    growing = contact_link(speeds=SPEEDS)
    steps = [
        run.measured + 200.0 * v * run.touching[:, None] * (np.arange(6) == 2)
        for run, v in zip(growing.runs, SPEEDS, strict=True)
    ]
    for residual, same in ((steady, True), (Residual(reread(growing, steps)), False)):
        chosen = fit(residual, (preload,), preload.grid)
        alone = [[fit(residual.on([i]), (preload,), preload.grid)] for i in residual.runs]
        assert same_in_each(chosen, alone, 0, 3) is same


@pytest.mark.parametrize("what", ["steady", "with the force", "in contact", "with time"])
def test_the_size_of_a_stand_in_varies_with_a_condition(what: str) -> None:
    """A bias that is always there is one. What grows with the force, acts in contact only, or
    fades, is none.
    """
    bias = candidates("sensor.bias")[0]
    link = contact_link(speeds=SPEEDS)
    rows = np.arange(len(link.runs[0].measured))
    sizes = {
        "steady": lambda run, v: 0.0 * rows + 4.0,
        "with the force": lambda run, v: 0.0 * rows + 4.0 * v / np.mean(SPEEDS),
        "in contact": lambda run, v: 4.0 * run.touching,
        "with time": lambda run, v: 4.0 - 4.0 * rows / rows[-1],
    }
    along = np.arange(6) == 2
    logged = [
        run.measured + sizes[what](run, v)[:, None] * along
        for run, v in zip(link.runs, SPEEDS, strict=True)
    ]
    residual = Residual(reread(link, logged))
    chosen = fit(residual, (bias,), bias.grid)
    assert varies(residual, chosen, 0, list(range(len(bias.names))), 0.0) is (what != "steady")


def test_a_run_that_any_size_fits_says_nothing_of_it() -> None:
    """Three of five tell: as many as asked agree, one more than there are does not; and one that
    differs is too many then.
    """
    preload = candidates("contact.preload")[0]
    residual = Residual(contact_link([effect("contact.preload", force=6.0)], speeds=SPEEDS))
    chosen = fit(residual, (preload,), preload.grid)
    larger = replace(chosen, theta=1.4 * chosen.theta)
    alone = [[chosen], [chosen], [chosen], [chosen, larger], [larger, chosen]]
    assert same_in_each(chosen, alone, 0, 3)
    assert not same_in_each(chosen, alone, 0, 4)
    assert not same_in_each(chosen, [*alone, [larger]], 0, 3)


def test_a_size_that_the_runs_do_not_bear_on_is_the_same_in_none() -> None:
    """Damping makes a force of 8 N and more of each touch: what is below is not met, neither the
    end of a dead zone nor a bias within it.

    Both stay where a fit starts, in every run alone too; a stiffness is found again.
    """
    stiffness, zone, bias = (
        candidates(kind)[0] for kind in ("contact.stiffness", "sensor.deadzone", "sensor.bias")
    )
    residual = Residual(
        contact_link(
            [effect("contact.stiffness", factor=1.1), effect("sensor.deadzone", width=5.0)],
            speeds=SPEEDS,
        )
    )
    chosen = fit(
        residual, (stiffness, zone, bias), [[1.1, 5.0, 0.0, -3.0, 0.0, 0.0, 0.0, 0.0]], tries=1
    )
    assert chosen.part(2)[1] == -3.0
    none = contact_leftovers(residual, chosen.effects())
    found = Explanation(
        residual, chosen.causes, null_fit(residual), chosen, True, True, none, none, (chosen,)
    )
    assert [same_in_each(chosen, in_each_run(found), i, 3) for i in range(3)] == [
        True,
        False,
        False,
    ]


def test_what_fits_all_runs_is_among_what_fits_each_that_it_fits_as_well() -> None:
    """As it is, not only where a descent from there ends; not in a run that it does not fit."""
    stiffness = candidates("contact.stiffness")[0]
    link = contact_link([effect("contact.stiffness", factor=1.1)], speeds=SPEEDS)
    changed = [run.measured * (1.05 if i == 0 else 1.0) for i, run in enumerate(link.runs)]
    chosen = fit(Residual(link), (stiffness,), stiffness.grid)
    residual = Residual(reread(link, changed))
    none = contact_leftovers(residual, chosen.effects())
    found = Explanation(
        residual, chosen.causes, null_fit(residual), chosen, True, True, none, none, (chosen,)
    )
    assert [any((f.theta == chosen.theta).all() for f in fits) for fits in in_each_run(found)] == [
        False
    ] + [True] * (len(SPEEDS) - 1)


@pytest.mark.parametrize(("factor", "there"), [(1.3, False), (20.0, True)])
def test_an_estimate_at_the_end_of_its_search_is_no_estimate(factor: float, there: bool) -> None:
    stiffness = candidates("contact.stiffness")[0]
    assert at_bound(stiffness, np.clip([factor], stiffness.low, stiffness.high)) is there


def test_every_verdict_has_a_title() -> None:
    assert set(TITLES) == set(VERDICTS)
