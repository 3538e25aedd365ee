"""`hiltestbed rank`: every compensation on a scenario, best first."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from hiltestbed.bench import ranking
from hiltestbed.bench.contenders import CONTENDERS

SHORT = ("--set", "duration=0.6", "--set", "rig.platform.tracking=ideal")
STIFFNESS, MASS, DELAY = 1.0e5, 400.0, 0.005  # of scenarios/03, reduced mass


def test_methods_are_ranked_by_the_error_of_the_rebound(
    call: Callable[..., tuple[int, str, str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = tuple(m for m in CONTENDERS if m.name in ("none", "phase_lead", "smith_predictor"))
    monkeypatch.setattr(ranking, "contenders", lambda: few)
    name, out = "03-bumper-delay-uncompensated", tmp_path / "rank"
    status, text, _ = call("rank", name, *SHORT, "--out", str(out), "--json")
    assert status == 0
    found = json.loads(text)
    methods = {row["method"]: row for row in found["methods"]}
    assert found["methods"][-1]["method"] == "none"
    assert found["methods"][-1]["needs"] == "nothing"
    assert methods["smith_predictor"]["section"]["force"]["stiffness"] == pytest.approx(STIFFNESS)
    # ln(e/e_ref) = (pi/2) w tau without compensation, and of the fifth that is not known with it
    worth = 0.5 * math.pi * math.sqrt(STIFFNESS / MASS) * DELAY
    assert methods["none"]["cor_log_error"] == pytest.approx(worth, rel=0.02)
    for method in ("phase_lead", "smith_predictor"):
        assert abs(methods[method]["cor_log_error"]) < 0.02 * worth
        assert methods[method]["late"] == pytest.approx(0.2 * worth, rel=0.05)
    assert (out / "report.html").read_text().count("<img") == 1


def test_bodies_that_move_freely_have_nothing_to_compensate(
    call: Callable[..., tuple[int, str, str]],
) -> None:
    status, out, err = call("rank", "22-air-bearing")
    assert (status, out) == (2, "")
    assert "there is no loop" in err


def test_a_rebound_along_z_is_not_compared_with_one_along_the_impulse() -> None:
    """A reference that parts on the slope of a cone has no rebound along z."""
    run, reference = (
        SimpleNamespace(figures=[SimpleNamespace(cor=cor, cor_normal=along)], trouble={})
        for cor, along in ((0.53, 0.77), (None, 0.65))
    )
    assert ranking._error(cast(Any, run), cast(Any, reference)) == math.log(0.77 / 0.65)


def test_a_method_that_a_limit_stops_says_which(
    call: Callable[..., tuple[int, str, str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ranking, "contenders", lambda: CONTENDERS[:1])
    status, text, _ = call(
        "rank", "03-bumper-delay-uncompensated", *SHORT, "--set", "safety.force=100",
        "--out", str(tmp_path / "rank"),
    )  # fmt: skip
    assert status == 0
    assert re.search(r"none: stopped at t = 0\.\d+ s: .*100", text)
