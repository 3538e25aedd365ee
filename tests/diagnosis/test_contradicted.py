"""An explanation that the rebound contradicts is none; and the price of what is attributed to the
timing of the facility.
"""

from __future__ import annotations

import math
from types import SimpleNamespace as Fake
from typing import Any

import numpy as np
import pytest

from hiltestbed import load_scenario
from hiltestbed.diagnosis import rebound
from hiltestbed.diagnosis.rebound import Rebound
from hiltestbed.diagnosis.timing import ClockOffset


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
        Fake(name=name, keys=(name,), causes=(name,), evidence=-score, left=())
        for name, score in (("null", 9.0), ("chosen", 1.0), ("first", 2.0), ("second", 3.0))
    )
    cor = dict(zip(("null", "chosen", "first", "second"), shown, strict=True))
    monkeypatch.setattr(
        rebound, "_simulated", lambda fits, *rest: np.array([[cor[f.name]] * 4 for f in fits])
    )
    monkeypatch.setattr(rebound, "_rebound", lambda layout, i: Rebound(1.03, 1e-3, 100))
    monkeypatch.setattr(rebound, "_others", lambda explanations, name: [])
    monkeypatch.setattr(rebound, "replace", lambda old, **new: Fake(**(vars(old) | new)))
    monkeypatch.setattr(
        rebound, "conclude", lambda found, *rest: Fake(**vars(conclusion) | {"fit": found.best})
    )
    monkeypatch.setattr(
        rebound, "Searched", lambda likelihood, best, visited, null: Fake(best=best)
    )
    conclusion = Fake(null=null, fit=chosen, causes=(), visited=(chosen, first, second))
    found = Fake(
        departs=True,
        adequate=True,
        kinds=("chosen",),
        effects=list,
        causes=(),
        fit=chosen,
        candidates=(),
        conclusion=conclusion,
        model=Fake(leaves_noise=lambda left: True, folds=list, members=()),
        likelihood=None,
    )
    findings: Any = Fake(
        layout=Fake(runs=[Fake(scenario=scenario)] * 4), explanations={"wrench": found}, weighed=()
    )
    result = rebound.with_rebounds(findings)
    e: Any = result.explanations["wrench"]
    assert (e.conclusion.fit.name if e.adequate else "none") == expected
    assert len(result.weighed) == (expected != "chosen")


def test_a_clock_that_is_off_has_a_price() -> None:
    """Half a millisecond in a contact of w = 16 rad/s is (pi/2) w tau = 1.2 % of the rebound."""
    price = 0.5 * math.pi * 15.8 * 5e-4
    offset = ClockOffset("pose_act", "pose_cmd", 0.5, 5e-4, price)
    assert "0.5 rows (0.0005 s) late relative to pose_cmd" in offset.sentence()
    assert "changes the coefficient of restitution by +1.2 %" in offset.sentence()
