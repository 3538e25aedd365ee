"""A platform that is a drive against dry friction is found as that; one that lags stays a lag."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from hiltestbed.diagnosis.adequacy import contact_leftovers, noise_alone
from hiltestbed.diagnosis.fit import fit, null_fit
from hiltestbed.diagnosis.grow import Richer
from hiltestbed.diagnosis.intervals import intervals
from hiltestbed.diagnosis.links import PlatformLink
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.search import Explanation, Search
from hiltestbed.effects import EFFECTS, Effect
from hiltestbed.effects.search import Candidate, Scales

from .made import effect, sweeps

H, ROWS = 0.01, 1000
DRIVE = {"bandwidth": 3.0, "damping_ratio": 0.5, "friction": 6e-5, "offset": -1.2e-4}
SCALES = Scales(1.0, 1e-3, 1e5, H, 1.0, 0.01, 0.02, ROWS * H, travel=4e-3, substeps=4)


def candidates(rich: bool = False) -> tuple[Candidate, ...]:
    return tuple(
        c
        for e in EFFECTS.values()
        if e.link == "platform" and e.rich is rich
        for c in e.candidates(SCALES)
    )


def link(*hidden: Effect) -> PlatformLink:
    return sweeps(hidden, (0.6, 1.0, 1.6), ROWS, 2e-6, seed=7)


def explained_by(residual: Residual, *kinds: str) -> Explanation:
    """The explanation that the first hypotheses of effects with few numbers give together."""
    chosen = tuple(next(c for c in candidates() if c.kind == kind) for kind in kinds)
    starts = [
        np.concatenate(start)
        for start in ([c.grid[i % len(c.grid)] for c in chosen] for i in range(7))
    ]
    found = fit(residual, chosen, starts)
    before, left = (contact_leftovers(residual, effects) for effects in ((), found.effects()))
    null, adequate = null_fit(residual), noise_alone(left)
    return Explanation(residual, candidates(), null, found, adequate, True, left, before, (found,))


@cache
def richer() -> Richer:
    return Richer(Search(candidates()), candidates(rich=True))


def test_a_drive_is_found_with_its_numbers_where_a_lag_stood_in_for_it() -> None:
    stood_in = explained_by(Residual(link(effect("platform.drive", None, **DRIVE))), "platform.lag")
    assert not stood_in.adequate
    found = richer().in_place_of(stood_in)
    assert found.adequate
    assert found.chosen.kinds == ("platform.drive",)
    assert not any(found.rivals)
    ends = intervals(found.residual, found.chosen).ends
    for name, (low, high) in zip(found.chosen.causes[0].names, ends, strict=True):
        assert low <= DRIVE[name] <= high, name
        assert high - low < 0.05 * abs(DRIVE[name]), name


def test_a_drive_beside_a_limit_of_the_speed_leaves_the_limit_and_takes_the_place_of_the_lag() -> (
    None
):
    hidden = [effect("platform.drive", None, **DRIVE), effect("platform.speed_limit", speed=6e-3)]
    stood_in = explained_by(
        Residual(link(*hidden)), "platform.speed_limit", "platform.lag", "platform.backlash"
    )
    assert not stood_in.adequate
    found = richer().in_place_of(stood_in)
    assert found.adequate
    assert sorted(found.chosen.kinds) == ["platform.drive", "platform.speed_limit"]


def test_what_a_lag_explains_stays_a_lag() -> None:
    """Alone, and beside a limit of the speed."""
    one = explained_by(Residual(link(effect("platform.lag", bandwidth=3.0))), "platform.lag")
    assert one.adequate
    assert richer().in_place_of(one) is one
    together = [effect("platform.lag", bandwidth=3.0), effect("platform.speed_limit", speed=6e-3)]
    two = explained_by(Residual(link(*together)), "platform.speed_limit", "platform.lag")
    assert two.adequate
    assert richer().in_place_of(two) is two


def test_what_it_resembles_is_not_sought_beside_it() -> None:
    residual = Residual(
        link(effect("platform.drive", None, **DRIVE), effect("platform.backlash", width=2e-4))
    )
    cause = next(c for c in candidates(rich=True) if "offset" in c.names)
    drive = fit(residual, (cause,), cause.grid)
    further = Search((*candidates(), *candidates(rich=True))).extend(residual, drive)
    assert further
    assert not {f.causes[-1].kind for f in further} & {
        *EFFECTS["platform.drive"].resembles,
        "platform.drive",
    }


def test_a_lag_beside_something_without_a_name_is_not_taken_for_a_drive() -> None:
    """A chirp of 20 um that no effect makes bends the numbers of a drive, and what is bent does not
    carry over.
    """
    clean, t = link(effect("platform.lag", bandwidth=3.0)), np.arange(ROWS) * H
    runs = [
        replace(run, measured=run.measured + 2e-5 * np.sin(2 * np.pi * 4.0 * t**1.3 + i)[:, None])
        for i, run in enumerate(clean.runs)
    ]
    found = explained_by(
        Residual(PlatformLink(runs, clean.commands, clean.deflection)), "platform.lag"
    )
    assert not found.adequate
    assert richer().in_place_of(found) is found
