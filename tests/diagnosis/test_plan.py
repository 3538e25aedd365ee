"""What a plan says would show is what a diagnosis finds."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from hiltestbed.config.dataset import dataset_from
from hiltestbed.config.yaml_source import read_source
from hiltestbed.diagnosis import plan as module
from hiltestbed.diagnosis.plan import Plan, plan
from hiltestbed.scenario import Scenario, scenario_from
from tests.slow import SLOW

from .recorded import NOMINAL, recorded


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    sensor = {"delay": 0.005, "noise": 0.2, "torque_noise": 0.02}
    return scenario_from({**NOMINAL, "sensor": sensor})


@pytest.fixture(scope="module")
def planned(scenario: Scenario) -> Plan:
    return plan(scenario)


def sizes(found: Plan) -> dict[str, float | None]:
    return {e.effect: e.smallest for e in found.effects}


@SLOW
def test_what_would_show_grows_with_the_noise(planned: Plan) -> None:
    """Chi-square is (size/noise)^2: twice the noise hides twice the size of what is linear in it and
    shows outside contact, where no error of a model of the contact is.
    """
    sensor = {"delay": 0.005, "noise": 0.4, "torque_noise": 0.04}
    noisier = scenario_from({**NOMINAL, "sensor": sensor})
    found, before = sizes(plan(noisier)), sizes(planned)
    for effect in ("sensor.bias", "sensor.drift"):
        ratio = (found[effect] or 0.0) / (before[effect] or 1.0)
        # floors are estimated from a few hundred rows
        assert ratio == pytest.approx(2.0, rel=0.1), effect
    # a stamp may be off by up to a row, whatever the noise
    assert (before["sensor.delay"] or 0.0) > 1.0 / (math.sqrt(3.0) * NOMINAL["rate"])


def test_a_spring_tells_a_soft_frame_from_a_softer_contact_and_the_same_run_again_does_not(
    planned: Plan,
) -> None:
    """A frame of stiffness s makes k s/(k + s) of a spring k: on one spring it looks like a softer
    one.
    """
    pairs = {(e.effect, o) for e in planned.effects for o in e.confused_with}
    assert ("frame.compliance", "contact.stiffness") in pairs
    assert ("sensor.gain", "contact.stiffness") in pairs
    first = planned.proposals[0]
    assert "mechanism.contact.stiffness" in first.set
    assert ("contact.stiffness", "frame.compliance") in first.settles
    settled = {frozenset(p) for q in planned.proposals for p in q.settles}
    # a run with another speed is the same linear contact, larger
    assert frozenset(("sensor.gain", "contact.stiffness")) not in settled


@SLOW
def test_runs_that_are_on_record_give_the_noise(tmp_path: Path) -> None:
    file = recorded(tmp_path, [])
    yaml = YAML(typ="safe")
    data = yaml.load(file)
    data["runs"][1]["file"] = "not_yet.parquet"
    yaml.dump(data, file)
    found = plan(dataset_from(read_source(file), on_record=False))
    assert found.noise["wrench_meas.fz"] == pytest.approx(NOMINAL["sensor"]["noise"], rel=0.1)
    assert found.runs == ("run_0.parquet", "not_yet.parquet")


def test_the_command_prints_one_object(
    call: Callable[..., tuple[int, str, str]],
    planned: Plan,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.setattr(module, "plan", lambda task, progress: planned)
    status, out, _ = call("plan", "02-bumper", "--json")
    assert status == 0
    assert json.loads(out)["effects"][0].keys() >= {"effect", "smallest", "confused_with"}
    status, out, _ = call("plan", "02-bumper")
    assert status == 0
    assert planned.sentence in out
    axis = tmp_path / "axis.yaml"
    axis.write_text("axis: drive\nruns: []\n")
    status, out, err = call("plan", str(axis))
    assert (status, out) == (2, "")
    assert "plan takes a scenario or the dataset of a rig" in err
