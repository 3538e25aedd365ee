"""The run that is proposed separates what it is meant to separate, by as much as it says: it is run,
and all runs are diagnosed again.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from ruamel.yaml import YAML

from hiltestbed.diagnosis.explain import Explanation
from hiltestbed.diagnosis.find import find
from hiltestbed.diagnosis.investigate import investigate
from hiltestbed.diagnosis.next_run import next_experiment
from hiltestbed.diagnosis.result import Cause, Experiment, Finding, Parameter
from hiltestbed.measured import MeasuredDataset, load_dataset
from hiltestbed.scenario import scenario_from
from tests.slow import SLOW, slow

from .recorded import NOMINAL, logged, recorded, without

UNSEEN = ("pose_act", "twist_act", "wrench_meas", "wrench_true")
LESS_DAMPING = {"kind": "contact.damping", "factor": 0.95}  # -20 N s/m, as a delay of 0.2 ms has
LIGHTER = {"kind": "dynamics.mass", "factor": 0.7, "body": "target"}
LATE = {"kind": "sensor.delay", "delay": 2e-4}
HEAVIER = {"kind": "dynamics.mass", "factor": 1.3, "body": "target"}


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> MeasuredDataset:
    return load_dataset(recorded(tmp_path_factory.mktemp("healthy"), []))


class Advised(NamedTuple):
    """An ambiguous finding, its advice, and what all runs show with the one that it proposes."""

    found: Finding
    experiment: Experiment
    explanations: dict[str, Explanation]
    after: Finding


def followed(folder: Path, hidden: dict[str, Any], missing: tuple[str, ...] = ()) -> Advised:
    file = recorded(folder, [hidden], missing=missing)
    dataset = load_dataset(file)
    found = find(investigate(dataset))
    assert found.verdict == "ambiguous"
    experiment = next_experiment(found, dataset)
    assert experiment is not None
    (run,) = experiment.runs
    yaml = YAML(typ="safe")
    data = yaml.load(file)
    data["runs"].append({"file": "new.parquet", "set": dict(run)})
    yaml.dump(data, file)
    acting = scenario_from({**NOMINAL, "effects": [hidden], "seed": 9}, run)
    logged(acting, folder / "new.parquet", without(*missing))
    findings = investigate(load_dataset(file))
    return Advised(found, experiment, findings.explanations, find(findings))


@pytest.mark.parametrize(
    ("hidden", "missing", "key"),
    [
        slow(LESS_DAMPING, (), "mechanism.contact.stiffness"),
        (LIGHTER, UNSEEN, "mass"),
        slow(HEAVIER, UNSEEN, "mass"),
    ],
)
def test_the_run_that_is_proposed_decides(
    tmp_path: Path, hidden: dict[str, Any], missing: tuple[str, ...], key: str
) -> None:
    """A delay tau is worth -k tau of damping on every mass: another spring decides. The relative
    motion shows the reduced mass: another mass decides.
    """
    result = followed(tmp_path, hidden, missing)
    if missing:  # 1/mu = 1/m_chaser + 1/m_target: the factor on the chaser that gives the same
        (open_,), f = result.found.causes, hidden["factor"]
        chaser, target = (NOMINAL["spacecraft"][body]["mass"] for body in ("chaser", "target"))
        alike = 1.0 / (chaser * (1.0 / chaser + (1.0 / f - 1.0) / target))
        told = {e["body"]: e["factor"] for e in (open_.entry(), open_.alternatives[0][0])}
        assert told == pytest.approx({"target": f, "chaser": alike}, rel=1e-3)
        assert open_.probability == pytest.approx(0.5, abs=0.01)
    assert any(key in name for name in result.experiment.runs[0])
    assert result.after.verdict == "named"
    (cause,) = result.after.causes
    entry = cause.entry()
    value = entry.pop("factor")
    assert entry == {k: v for k, v in hidden.items() if k != "factor"}
    assert value == pytest.approx(hidden["factor"], rel=5e-3)


@SLOW
def test_a_run_separates_by_as_much_as_is_said(tmp_path: Path) -> None:
    """Chi-square by which all runs refuse another hypothesis, fitted anew, is the square of the
    separation. The delay is true here: a damper in its place is refused less than the reverse.
    """
    result = followed(tmp_path, LATE)
    said = [float(x) for x in re.findall(r"([\d.]+) standard dev", result.experiment.text)]
    likelihood = result.explanations["wrench"].likelihood
    assert len(said) == len(result.found.open)
    for sigma, pair in zip(said, result.found.open, strict=True):
        costs = [likelihood.fit(fit.causes, [fit.of.theta]).cost for fit in pair.fits]
        assert sigma == pytest.approx(math.sqrt(abs(costs[0] - costs[1])), rel=0.25)


def test_what_is_not_open_needs_no_run(healthy: MeasuredDataset) -> None:
    assert next_experiment(Finding("no_discrepancy", None), healthy) is None
    settled = Cause("contact.dry_friction", {"force": Parameter(9.0, (8.9, 9.1), "N")}, 1.0)
    assert next_experiment(Finding("named", "contact", (settled,)), healthy) is None
    # every channel of the loop is on record
    assert next_experiment(Finding("inconclusive", None), healthy) is None


def test_runs_that_contradict_each_other_are_repeated(healthy: MeasuredDataset) -> None:
    experiment = next_experiment(Finding("unknown", "contact", contrary="y"), healthy)
    assert experiment.runs[0] == experiment.runs[1] == healthy.spec.runs[0].set


def test_a_link_that_was_not_judged_needs_its_channels(tmp_path: Path) -> None:
    dataset = load_dataset(recorded(tmp_path, [], missing=("wrench_comp",)))
    experiment = next_experiment(
        Finding("inconclusive", None, not_judged={"compensation": "needs wrench_comp"}), dataset
    )
    assert "wrench_comp" in experiment.text
    assert "pose_act" not in experiment.text
