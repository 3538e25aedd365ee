"""What is no cause: an effect whose size the data do not determine, an explanation that the rebound
contradicts; and the price of what is attributed to the timing of the facility.
"""

from __future__ import annotations

import math
from types import SimpleNamespace as Fake
from typing import Any

import numpy as np
import pytest

from hiltestbed import load_scenario
from hiltestbed.diagnosis import find, rebound
from hiltestbed.diagnosis.certainty import spans_its_range
from hiltestbed.diagnosis.fit import Fit
from hiltestbed.diagnosis.rebound import Rebound
from hiltestbed.diagnosis.timing import ClockOffset
from hiltestbed.diagnosis.verdict import Named, Verdict
from hiltestbed.effects.search import Candidate
from hiltestbed.effects.table import EFFECTS


def fit_of(kind: str, names: tuple[str, ...], low: list, high: list, log: list) -> Fit:
    bounds = (np.array(low), np.array(high), np.array(log, dtype=bool))
    cause = Candidate(EFFECTS[kind], names, *bounds, (), {})
    return Fit((cause,), np.array(low), 0.0, np.zeros(0), np.zeros((0, len(names))))


@pytest.mark.parametrize(
    ("kind", "names", "ends", "spans"),
    [
        ("platform.mode", ("frequency", "damping_ratio"), [[2.0, 400.0], [0.01, 0.02]], True),
        ("platform.mode", ("frequency", "damping_ratio"), [[2.1, 390.0], [0.01, 0.02]], True),
        # the size is known; a lesser parameter is not
        ("platform.mode", ("frequency", "damping_ratio"), [[20.0, 25.0], [0.001, 0.5]], False),
        ("platform.mode", ("frequency", "damping_ratio"), [[40.0, 400.0], [0.01, 0.02]], False),
        ("sensor.delay", ("delay",), [[0.0, 0.03]], True),
        ("sensor.delay", ("delay",), [[0.0, 0.02]], False),
        ("sensor.delay", ("delay",), [[math.nan, math.nan]], True),
        ("sensor.bias", ("force.0", "force.2"), [[-50.0, 50.0], [1.0, 1.2]], False),
        ("sensor.bias", ("force.0", "force.2"), [[-50.0, 50.0], [-49.0, 50.0]], True),
    ],
)
def test_an_interval_as_wide_as_that_of_the_range_determines_nothing(
    kind: str, names: tuple[str, ...], ends: list, spans: bool
) -> None:
    bounds = {
        "platform.mode": ([2.0, 0.001], [400.0, 0.5], [True, True]),
        "sensor.delay": ([0.0], [0.03], [False]),
        "sensor.bias": ([-50.0] * 2, [50.0] * 2, [False] * 2),
    }
    found = fit_of(kind, names, *bounds[kind])
    assert spans_its_range(found, 0, np.array(ends)) is spans
    named = Named(kind, "platform", found, 0, 1.0)
    certain: Any = Fake(of=lambda link, fit: Fake(ends=np.array(ends)))
    verdict = find._determined(Verdict("named", "platform", (named,), {}), certain)
    assert (verdict.verdict, len(verdict.causes)) == (("unknown", 0) if spans else ("named", 1))


@pytest.mark.parametrize(
    ("shown", "expected"),
    [
        # coefficients of the loop without a cause, with the chosen one and with two others; 1.03
        # is on record
        ((1.005, 1.005, 1.005, 1.029), "second"),
        ((1.005, 1.001, 1.02, 1.004), "first"),
        ((1.005, 1.001, 1.003, 1.004), "none"),
        ((1.005, 1.029, 1.005, 1.03), "chosen"),  # nearer
        ((1.0297, 1.0299, 1.03, 1.03), "chosen"),  # the rebound does not depart
    ],
)
def test_an_explanation_that_leaves_the_rebound_where_it_was_is_not_one(
    monkeypatch: pytest.MonkeyPatch, shown: tuple[float, ...], expected: str
) -> None:
    scenario = load_scenario("02-bumper")
    null, chosen, first, second = (
        Fake(name=name, kinds=(name,), causes=(name,), score=score, effects=tuple)
        for name, score in (("null", 0.0), ("chosen", 1.0), ("first", 2.0), ("second", 3.0))
    )
    cor = dict(zip(("null", "chosen", "first", "second"), shown, strict=True))
    monkeypatch.setattr(
        rebound, "_simulated", lambda fits, *rest: np.array([[cor[f.name]] * 4 for f in fits])
    )
    monkeypatch.setattr(rebound, "_rebound", lambda layout, i: Rebound(1.03, 1e-3, 100))
    monkeypatch.setattr(rebound, "_as_stamped", lambda found: None)
    monkeypatch.setattr(rebound, "_others", lambda explanations, name: [])
    monkeypatch.setattr(rebound, "_left", lambda found, other: {})
    monkeypatch.setattr(rebound, "replace", lambda old, **new: Fake(**(vars(old) | new)))
    found = Fake(
        departs=True,
        adequate=True,
        null=null,
        chosen=chosen,
        singles=(second, chosen),
        more=(first,),
        rivals=(),
    )
    findings: Any = Fake(
        layout=Fake(runs=[Fake(scenario=scenario)] * 4), explanations={"wrench": found}, weighed=()
    )
    result = rebound._uncontradicted(findings)
    e: Any = result.explanations["wrench"]
    assert (e.chosen.name if e.adequate else "none") == expected
    assert len(result.weighed) == (expected != "chosen")


def test_a_clock_that_is_off_has_a_price() -> None:
    """Half a millisecond in a contact of w = 16 rad/s is (pi/2) w tau = 1.2 % of the rebound."""
    price = 0.5 * math.pi * 15.8 * 5e-4
    offset = ClockOffset("pose_act", "pose_cmd", 0.5, 5e-4, None, price)
    assert "0.5 rows (0.0005 s) late relative to pose_cmd" in offset.sentence()
    assert "changes the coefficient of restitution by +1.2 %" in offset.sentence()
