"""The page of a run: it says what the figures say, and stands alone."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import hiltestbed
from hiltestbed.energy import energy_generated
from hiltestbed.run_report import run_report

SHORT = {"duration": 0.6, "approach.gap": 0.002, "rig.platform.tracking": "ideal"}


def shipped(name: str, **changes) -> hiltestbed.Run:
    return hiltestbed.run(hiltestbed.load_scenario(hiltestbed.shipped("scenarios") / f"{name}.yaml", changes))


@pytest.fixture(scope="module")
def late() -> hiltestbed.Run:
    return shipped("03-bumper-delay-uncompensated", **SHORT)


def test_the_energy_of_the_page_is_that_of_the_loop(late: hiltestbed.Run) -> None:
    """The sum over the trace against the one that the loop keeps tick by tick."""
    assert late.trace is not None
    assert energy_generated(late.trace, late.scenario)[-1] == pytest.approx(late.summary["energy_generated"], rel=1e-9)


def test_the_page_warns_and_advises(late: hiltestbed.Run, tmp_path: Path) -> None:
    hiltestbed.write_run(late, tmp_path / "r", rerun=False)
    page = (tmp_path / "r" / "report.html").read_text()
    assert "http" not in page
    for words in ("faster than the approach", "Is the loop passive?", "less than that delay", "What to do next", "compensation.force="):
        assert words in page
    assert page.count("data:image/png") == 2
    assert json.loads((tmp_path / "r" / "summary.json").read_text())["cor"] == late.summary["cor"]


def test_a_miss_and_a_run_without_trace_have_a_page() -> None:
    miss = shipped("12-miss", duration=0.05)
    page = run_report(miss).html()
    assert "the question does not arise" in page
    assert "did not touch" in page
    assert "data:image" not in run_report(hiltestbed.Run(miss.scenario, miss.summary)).html()
