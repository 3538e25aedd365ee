"""Growing an explanation cause by cause, where no one or two effects come near the noise."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hiltestbed.diagnosis.adequacy import contact_leftovers
from hiltestbed.diagnosis.fit import fit, null_fit
from hiltestbed.diagnosis.grow import far_off, grow
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.search import Explanation, Search
from hiltestbed.effects import EFFECTS
from hiltestbed.effects.search import Scales

from .made import effect, sweeps

H, ROWS = 0.01, 1500
TRUTH = [
    effect("platform.lag", bandwidth=3.0),
    effect("platform.backlash", width=2e-4),
    effect("platform.scale", factor=0.9, axis="x"),
]


def one_of_three() -> Explanation:
    """The explanation that a lag alone gives."""
    residual = Residual(sweeps(TRUTH, (1.0, 1.6), ROWS, 1e-6, seed=4))
    scales = Scales(1.0, 1e-3, 1e5, H, 1.0, 0.01, 0.02, ROWS * H, travel=4e-3, substeps=4)
    candidates = tuple(
        c for e in EFFECTS.values() if e.link == "platform" for c in e.candidates(scales)
    )
    lag = next(c for c in candidates if c.kind == "platform.lag")
    one = fit(residual, (lag,), lag.grid)
    before, left = (contact_leftovers(residual, effects) for effects in ((), one.effects()))
    return Explanation(
        residual, candidates, null_fit(residual), one, False, True, left, before, (one,)
    )


def test_three_causes_are_found_from_one() -> None:
    found = one_of_three()
    assert far_off(found)
    grown = {e.kind: e.parameters() for e in grow(found, Search(found.candidates)).effects()}
    assert sorted(grown) == sorted(e.kind for e in TRUTH)
    assert grown["platform.lag"]["bandwidth"] == pytest.approx(3.0, rel=2e-3)
    assert grown["platform.backlash"]["width"] == pytest.approx(2e-4, rel=5e-3)
    assert grown["platform.scale"]["factor"] == pytest.approx(0.9, rel=1e-3)


def test_nothing_is_added_to_causes_that_leave_noise_alone() -> None:
    """What still pays then is another size of what the noise hides, or what a record does not
    state.
    """
    found = one_of_three()
    of_noise = {
        name: replace(left, variance=1.0, block=1.0) for name, left in found.leftovers.items()
    }
    assert all(left.noise for left in of_noise.values())
    assert grow(found, Search(found.candidates, judge=lambda *_: of_noise)).kinds == (
        "platform.lag",
    )
