"""The experiment that is proposed does separate what it is meant to separate: checked against the equations, not the words."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from hiltestbed.diagnosis.report.experiments import next_experiment
from hiltestbed.diagnosis.result import Cause, Finding, Parameter
from hiltestbed.effects import EFFECTS
from hiltestbed.measured import MeasuredDataset, load_dataset

from .recorded import recorded

MASS = 400.0  # kg, reduced
CONFOUNDED = [  # literature, Section 5, and what must be in the proposal
    ("contact.damping", "sensor.delay", "spring"),
    ("sensor.lag", "sensor.delay", "w tau"),
    ("sensor.gain", "contact.stiffness", "known weight"),
    ("frame.compliance", "contact.stiffness", "springs"),
    ("contact.touch_offset", "contact.preload", "electrical contact"),
    ("log.skew", "sensor.delay", "restitution"),
    ("contact.dry_friction", "contact.damping", "ladder of speeds"),
    ("sensor.bias", "sensor.drift", "without contact"),
    ("sensor.crosstalk", "contact.misalignment", "tilted"),
    ("contact.surface_friction", "sensor.crosstalk", "sideways"),
    ("contact.relaxation", "sensor.highpass", "hold"),
    ("platform.lag", "platform.delay", "Sweep|sweep"),
    ("platform.backlash", "platform.friction", "triangles"),
    ("dynamics.mass", "dynamics.appendage", "free flight"),
    ("dynamics.mass", "dynamics.mass", "absolute pose"),
]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> MeasuredDataset:
    return load_dataset(recorded(tmp_path_factory.mktemp("healthy"), []))


def finding(effect: str, rival: str, **parameters: float | str) -> Finding:
    cause = Cause(effect, {name: Parameter(value, None) for name, value in parameters.items()}, 0.5, (rival,))
    return Finding("ambiguous", EFFECTS[effect].link, (cause,))


@pytest.mark.parametrize(("effect", "rival", "words"), CONFOUNDED)
def test_each_confounded_set_has_its_own_experiment(dataset: MeasuredDataset, effect: str, rival: str, words: str):
    given: dict[str, float | str] = {"body": "chaser", "factor": 1.1} if effect == "dynamics.mass" else {}
    for a, b in ((effect, rival), (rival, effect)):
        experiment = next_experiment(finding(a, b, **(given if a == "dynamics.mass" else {})), dataset)
        assert experiment is not None
        assert re.search(words, experiment.text), experiment.text
        assert {effect, rival} <= set(experiment.separates)


def test_a_lag_and_a_delay_part_ways_where_w_tau_is_beyond_three_tenths(dataset: MeasuredDataset):
    experiment = next_experiment(finding("sensor.lag", "sensor.delay", time_constant=0.003), dataset)
    assert experiment is not None
    k = experiment.runs[0]["mechanism.contact.stiffness"]
    assert math.sqrt(k / MASS) * 0.003 > 0.3
    force = experiment.runs[0]["approach.velocity.2"] * math.sqrt(k * MASS)  # v sqrt(k mu), no larger than what the rig has seen
    assert force <= 1.05 * max(c.peak_force or 0.0 for r in dataset.runs for c in r.survey.contacts)


def test_damper_and_delay_are_separated_by_springs_and_never_by_masses(dataset: MeasuredDataset):
    """sqrt(mu) ln e = (pi/2)(k tau - c)/sqrt(k): two springs give two equations, two masses one."""
    experiment = next_experiment(finding("contact.damping", "sensor.delay", factor=0.5), dataset)
    assert experiment is not None
    springs = [run["mechanism.contact.stiffness"] for run in experiment.runs]
    assert len(set(springs)) == 2
    assert min(springs) < 1e5 < max(springs)
    assert not any("mass" in key for run in experiment.runs for key in run)


def test_which_body_is_wrong_is_open_even_where_the_mass_is_named(dataset: MeasuredDataset):
    """1/mu = 1/m1 + 1/m2: the relative pose cannot tell; 500 kg by 1.15 beside 2000 kg is 2000 kg by 2.091 beside 500 kg."""
    from hiltestbed.diagnosis.report.experiments import mass_of_either_body

    cause = Cause("dynamics.mass", {"factor": Parameter(1.15, (1.14, 1.16), "-"), "body": Parameter("chaser", None)}, 1.0)
    named = Finding("named", "dynamics", (cause,))
    text = mass_of_either_body(named, dataset)
    assert text is not None
    factor = float(re.search(r"factor of ([\d.]+)", text)[1])  # type: ignore[index]
    assert 1 / 500 + 1 / (factor * 2000) == pytest.approx(1 / 575 + 1 / 2000, rel=1e-3)
    assert next_experiment(named, dataset) is not None


def test_what_is_not_open_needs_no_experiment(dataset: MeasuredDataset):
    assert next_experiment(Finding("no_discrepancy", None), dataset) is None
    settled = Cause("contact.dry_friction", {"force": Parameter(9.0, (8.9, 9.1), "N")}, 1.0)
    assert next_experiment(Finding("named", "contact", (settled,)), dataset) is None


@pytest.mark.parametrize("link", ["platform", "contact", "sensor", "compensation", "dynamics", None])
def test_an_unknown_departure_gets_an_experiment_on_its_link(dataset: MeasuredDataset, link: str | None):
    assert next_experiment(Finding("unknown", link), dataset) is not None


def test_every_pair_of_effects_of_a_link_has_one(dataset: MeasuredDataset):
    for a, first in EFFECTS.items():
        for b, second in EFFECTS.items():
            if a != b and first.link == second.link and a != "dynamics.mass":
                experiment = next_experiment(finding(a, b), dataset)
                assert experiment is not None
                assert len(experiment.text) > 100


def test_proposed_runs_are_scenarios(dataset: MeasuredDataset):
    """Each can be set on the scenario as it stands."""
    from hiltestbed.scenario import load_scenario

    file = Path(dataset.path).parent / "nominal.yaml"
    for effect, rival, _ in CONFOUNDED:
        cause = Cause(effect, {}, 0.5, (rival,))
        experiment = next_experiment(Finding("ambiguous", "contact", (cause,)), dataset) if effect != "dynamics.mass" else None
        for run in experiment.runs if experiment else ():
            load_scenario(file, set=run)
