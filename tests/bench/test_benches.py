"""Benchmarks on a corner of their grids: identification, facilities, speed, and the ranking of
compensations on a scenario."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from hiltestbed.bench import facilities as bench
from hiltestbed.bench import ranking
from hiltestbed.bench.contacts import grid
from hiltestbed.bench.contenders import CONTENDERS
from hiltestbed.bench.identification import METHODS, identification_report, leaderboard, measure
from hiltestbed.bench.throughput import _oval_cone, docking_ratios
from hiltestbed.config.gallery import shipped
from hiltestbed.contact.geometry import FACES, KIND, ROW
from hiltestbed.contact.sides import sides_of
from hiltestbed.contact.surfaces.surface import MESH
from hiltestbed.platform.kinds import PLATFORMS
from hiltestbed.scenario import load_scenario
from tests.slow import SLOW

RECORD = set(
    ["method", "frequency", "delay", "damping_ratio", "noise", "stiffness_error", "damping_error"]
)


def test_methods_side_by_side() -> None:
    contacts = grid((8.0,), (0.002, 0.005), damping_ratios=(0.2,))
    records = [record for method in METHODS for record in measure(method, contacts, 0.002, seeds=4)]
    assert all(record.keys() >= RECORD for record in records)
    board = leaderboard(records)
    by_name = {row["method"]: row for row in board}
    assert abs(by_name["rls"]["stiffness_error"]) < 0.002
    assert abs(by_name["rls"]["damping_error"]) < 0.02
    assert by_name["rls_raw"]["damping_error"] > 0.1
    assert by_name["rls_delay_estimated"]["delay_error"] < 3e-4
    page = identification_report(
        records,
        {"leaderboard": board, "intervals": {"stiffness": 0.95, "damping": 0.95, "seeds": 400.0}},
    ).html()
    assert "rls_lead" in page


@pytest.fixture(scope="module")
def result():
    with pytest.MonkeyPatch.context() as patch:
        entered = bench.facilities_entered()
        patch.setattr(
            bench,
            "facilities_entered",
            lambda: {name: entered[name] for name in ("serial_arm", "air_bearing")},
        )
        return bench.facilities(quick=True)


def test_every_kind_of_platform_takes_part() -> None:
    assert {settings["kind"] for settings in bench.facilities_entered().values()} == set(PLATFORMS)
    assert {"stewart, hydraulic", "stewart, electric"} <= set(bench.facilities_entered())


def test_a_record_a_facility_and_treatment(result) -> None:
    assert {(r["facility"], r["treatment"]) for r in result.records} >= {
        ("serial_arm", "uncompensated"),
        ("serial_arm", "default"),
        ("air_bearing", "as it is"),
    }
    for rig in result.summary["rigs"]:
        assert rig["cost"] > 0.0
        assert len(rig["distorts"].split(". ")) >= 1
    assert "What each kind distorts" in result.report.html()


def test_the_virtual_damper_brings_the_designed_restitution_back(result) -> None:
    """EPOS' hybrid: designed by the damping that the measured rig takes and tuned by one trial, e
    is that of the contact within 1 %.
    """
    by = {r["treatment"]: r for r in result.records if r["facility"] == "serial_arm"}
    hybrid = next(r for name, r in by.items() if name.startswith("hybrid"))
    assert not by["uncompensated"]["passive"]
    assert math.exp(abs(hybrid["cor_log_error"])) - 1.0 < 0.01
    assert hybrid["passive"]


@SLOW
def test_the_oval_cone_is_searched_by_its_triangles(tmp_path: Path) -> None:
    keys = {"mechanism.kind": "mjcf", "mechanism.latch": None, **_oval_cone(tmp_path)}
    sides = sides_of(load_scenario(shipped("scenarios") / "09-docking.yaml", set=keys).mechanism)
    rows = sides.geometry.index[: sides.geometry.count * ROW].reshape(-1, ROW)
    assert set(rows[:, KIND].tolist()) == {MESH}
    assert set(rows[:, FACES].tolist()) == {96_256}
    assert not sides.native


@SLOW
def test_every_case_of_a_docking_is_timed() -> None:
    ratios = docking_ratios(1, 2)
    assert set(ratios) == {
        "cone by its profile",
        "cone by its profile, upper platform moving",
        "cone by its triangles",
    }
    assert all(ratio > 0.0 for ratio in ratios.values())


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
