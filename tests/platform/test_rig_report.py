"""A measured rig: what is in its folder agrees with what is known of it otherwise."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from hiltestbed import load_scenario
from hiltestbed.errors import InputError
from hiltestbed.platform import rig_report
from hiltestbed.platform.rig_report import measure_rig, write_rig

SCENARIOS = Path(__file__).parents[2] / "scenarios"


def test_the_folder_holds_figures_and_drawings(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(rig_report, "SLOWEST", 5.0)
    monkeypatch.setattr(rig_report, "POINTS", 4)
    scenario = load_scenario(SCENARIOS / "21-own-rig.yaml")
    figures = measure_rig(scenario)
    unused = replace(
        figures,
        scenario=load_scenario(SCENARIOS / "21-own-rig.yaml", {"rig.platform.tracking": "ideal"}),
    )
    told = ("these are the drives", "with tracking ideal a run does not use them")
    assert (told in figures.lines(), told in unused.lines()) == (False, True)
    folder = write_rig(figures, tmp_path / "rig")
    about = json.loads((folder / "rig.json").read_text())
    assert {"workspace.png", "response.png", "stiffness.png", "report.html"} <= {
        p.name for p in folder.iterdir()
    }
    assert [w["axis"] for w in about["workspace"]] == ["x", "y", "z", "rx", "ry", "rz"]
    assert about["workspace"][0]["high"] == pytest.approx(0.4, abs=1e-3)  # the range of its joint
    first = about["modes"][0]["frequency"]
    assert first == pytest.approx(12.2, abs=0.5)


def test_bodies_that_nothing_drives_have_no_response() -> None:
    with pytest.raises(InputError, match="drives nothing"):
        measure_rig(load_scenario(SCENARIOS / "22-air-bearing.yaml"))
