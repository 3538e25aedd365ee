"""What follows from a named cause, with the cause written by hand: the extended model, its gain in
closed loop, and the folder.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from hiltestbed.diagnosis.closed_loop import RunSignals, restitution
from hiltestbed.diagnosis.layout import lay_out
from hiltestbed.diagnosis.links import WrenchLink
from hiltestbed.diagnosis.recorded import wrench_link
from hiltestbed.diagnosis.report.diagnosis import Diagnosis, conclude
from hiltestbed.diagnosis.report.evidence import channel_residuals, link_series
from hiltestbed.diagnosis.result import Cause, Finding, Heldout, Isolable, Parameter, Ranked
from hiltestbed.effects import EFFECTS
from hiltestbed.errors import InputError
from hiltestbed.measured import MeasuredDataset, load_dataset
from hiltestbed.scenario import load_scenario, scenario_from, scenario_sha256

from .recorded import NOMINAL, recorded

DELAY = 0.004
NAMED = [EFFECTS["sensor.delay"].model_validate({"delay": DELAY})]
LATE = Cause(
    "sensor.delay", {"delay": Parameter(DELAY, (0.0039, 0.0041), "s")}, 0.9, ("sensor.lag",)
)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> MeasuredDataset:
    return load_dataset(
        recorded(tmp_path_factory.mktemp("late"), [{"kind": "sensor.delay", "delay": DELAY}])
    )


@pytest.fixture(scope="module")
def link(dataset: MeasuredDataset) -> WrenchLink:
    layout = lay_out(dataset)
    return wrench_link(layout, [r.record.filled("pose_act") for r in dataset.runs], layout.whole)


@pytest.fixture(scope="module")
def diagnosis(dataset: MeasuredDataset, link: WrenchLink) -> Diagnosis:
    gain = Heldout((0, 1), 20.0, 1.0, 0.95, (0.9, 0.97), 0.1, {0: (15.0, 1.0), 1: (24.0, 1.0)})
    ranking = (
        Ranked(("sensor.delay",), 0.0, "wrench", "delay 0.004", 1.0, True),
        Ranked(("sensor.lag",), 300.0, "wrench"),
    )
    table = (
        Isolable("sensor.delay", "delay", "s", 1e-5, ("log.skew",)),
        Isolable("sensor.drift", "rate", "N/s", None),
    )
    series = link_series(link, NAMED)
    return conclude(
        dataset, Finding("ambiguous", "sensor", (LATE,), series, {}, gain, ranking, table)
    )


def test_a_named_delay_takes_the_residual_down_to_the_noise(link: WrenchLink):
    before, after = (
        {r.channel: r for r in channel_residuals(link_series(link, effects), {}, True)}
        for effects in ([], NAMED)
    )
    force = after["wrench_meas.fz"]
    assert force.rms > 5 * force.noise_floor
    assert not force.white
    assert force.rms_contact is not None
    assert force.rms_free < 1.2 * force.noise_floor < force.rms_contact
    assert force.white_extended
    assert force.rms_extended == pytest.approx(force.noise_floor, rel=0.15)
    assert before["wrench_meas.fz"].rms_extended == before["wrench_meas.fz"].rms


def test_the_extended_model_rebounds_as_the_rig_did(diagnosis: Diagnosis):
    """ln e rises by (pi/2) w tau (physics, Section 1) where the delay is not known to the model."""
    loop = diagnosis.closed_loop
    rate = math.sqrt(1e5 / 400.0)
    for measured, nominal, extended in zip(loop.measured, loop.nominal, loop.extended, strict=True):
        assert nominal.cor is not None
        # the noise of 0.1 N goes round the loop
        assert extended.cor == pytest.approx(measured.cor, rel=3e-3)
        assert extended.peak_force == pytest.approx(measured.peak_force, rel=0.01)
        assert math.log(measured.cor / nominal.cor) == pytest.approx(
            0.5 * math.pi * rate * DELAY, rel=0.15
        )


def test_the_folder_holds_four_files_that_can_be_used(diagnosis: Diagnosis, tmp_path: Path):
    folder = diagnosis.write(tmp_path / "out")
    files = {"diagnosis.json", "extended.yaml", "recording.rrd", "report.html"}
    assert {f.name for f in folder.iterdir()} == files
    data = json.loads((folder / "diagnosis.json").read_text())
    assert set(data) >= {"verdict", "link", "next_experiment"}
    assert data["causes"][0]["parameters"] == {
        "delay": {"estimate": DELAY, "ci95": [0.0039, 0.0041], "unit": "s"}
    }
    assert data["causes"][0]["indistinguishable_from"] == ["sensor.lag"]
    gain = {"runs", "rms_before", "rms_after", "reduction", "ci95", "placebo_reduction"}
    assert set(data["heldout"]) >= gain
    channel = {"channel", "rms", "noise_floor", "rms_free", "rms_contact", "white"}
    assert set(data["residuals"][0]) >= channel
    assert len(data["closed_loop"]["cor_extended"]) == 2
    extended = load_scenario(folder / data["extended_scenario"])
    assert list(extended.effects) == NAMED
    page = (folder / "report.html").read_text()
    assert "sensor.delay" in page
    assert "sensor.lag" in page
    assert "Next experiment" in page
    assert not any(fetched in page for fetched in ('src="http', "href=", "<script", "<link"))
    assert diagnosis.write(folder) == folder  # an earlier diagnosis is replaced


def test_the_recording_has_all_three_on_one_timeline(diagnosis: Diagnosis, tmp_path: Path):
    from rerun.chunk import RrdReader

    from hiltestbed.diagnosis.report.recording import write_diagnosis_recording

    write_diagnosis_recording(tmp_path / "d.rrd", diagnosis)
    rows: dict[str, int] = {}
    for chunk in RrdReader(str(tmp_path / "d.rrd")).stream():
        batch = chunk.to_record_batch()
        if "time" in batch.schema.names:
            rows[str(chunk.entity_path)] = rows.get(str(chunk.entity_path), 0) + batch.num_rows
    for source in ("data", "nominal", "extended"):
        assert rows[f"/run_1/force_z/{source}"] == 800
    assert rows["/run_1/residual/wrench_meas_fz/extended"] == 800


def test_a_foreign_folder_is_left_alone(diagnosis: Diagnosis, tmp_path: Path):
    (tmp_path / "thesis.tex").write_text("mine")
    with pytest.raises(InputError, match="other things"):
        diagnosis.write(tmp_path)
    assert [f.name for f in tmp_path.iterdir()] == ["thesis.tex"]


def test_nothing_named_extends_nothing(dataset: MeasuredDataset, link: WrenchLink, tmp_path: Path):
    healthy = conclude(dataset, Finding("no_discrepancy", None, series=link_series(link)))
    data = healthy.to_json()
    assert data["extended_scenario"] is None
    assert data["next_experiment"] is None
    assert data["heldout"] is None
    assert data["closed_loop"]["cor_extended"] == data["closed_loop"]["cor_nominal"]
    healthy.write(tmp_path / "out")
    assert scenario_sha256(load_scenario(tmp_path / "out" / "extended.yaml")) == scenario_sha256(
        dataset.nominal
    )


@pytest.mark.parametrize(("low", "placebo"), [(-0.02, 0.0), (0.01, 0.3)])
def test_a_gain_that_is_not_significant_is_not_claimed(
    dataset: MeasuredDataset, low: float, placebo: float
):
    """Its interval holds zero, or a wrong effect gains as much."""
    weak = Heldout((0, 1), 1.2, 1.0, 0.2, (low, 0.4), placebo)
    result = conclude(dataset, Finding("named", "sensor", (LATE,), heldout=weak))
    assert result.extended == dataset.nominal
    assert result.to_json()["extended_scenario"] is None
    assert result.to_json()["heldout"]["significant"] is False


@pytest.mark.parametrize("e", [0.4, 0.95, 1.1])
def test_restitution_of_two_straight_lines_in_noise(e: float):
    """The slope of n samples h apart has a spread of sigma sqrt(12/n^3)/h: here 2e-5 of 0.05
    m/s.
    """
    t = np.arange(600) / 1000.0
    z = np.where(t < 0.2, 0.05 * (t - 0.2), -e * 0.05 * (t - 0.3))
    z += np.random.default_rng(1).normal(0.0, 2e-6, 600)
    signals = RunSignals(t, z, None, None, (200, 300, 600))
    assert restitution(signals, scenario_from(NOMINAL)) == pytest.approx(e, abs=3e-3)


def test_no_restitution_without_a_rebound():
    t = np.arange(400) / 1000.0
    signals = RunSignals(t, 0.05 * (t - 0.2), None, None, (200, 400, 400))
    assert restitution(signals, scenario_from(NOMINAL)) is None


def test_an_estimate_is_written_as_far_as_its_interval_bears_it_out():
    assert (
        Parameter(0.00330045, (0.0032938, 0.0033071), "s").in_words()
        == "0.0033 (0.003294 to 0.003307) s"
    )
    assert Parameter(9.0, (7.0, 11.0), "N").in_words() == "9 (7 to 11) N"
    assert Parameter("chaser", None).in_words() == "chaser"
