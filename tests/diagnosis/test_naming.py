"""Effects hidden in data of a rig that shares no code with the simulation, with their decoys; and
the practice sets.

``./check --all`` goes through the whole vocabulary.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from hiltestbed.diagnosis.find import cause_of
from hiltestbed.diagnosis.investigate import investigate
from hiltestbed.diagnosis.verdict import decide
from hiltestbed.effects import EFFECTS
from hiltestbed.measured import load_dataset
from tests.equipment.diagnosis.run import judged_right, one_set
from tests.equipment.diagnosis.tasks import Task
from tests.equipment.independent_rig import SIZES
from tests.measured_data import measured_data
from tests.slow import ALL, SLOW, slow

HIDDEN = [name for name in EFFECTS if name in SIZES]  # learned laws are not drawn
QUICK = ("sensor.gain",)
SETS = {
    1: (),
    2: ("sensor.delay",),
    3: ("contact.dry_friction",),
    4: ("platform.lag",),
    5: ("dynamics.mass",),
    6: ("sensor.crosstalk", "platform.backlash"),
    7: None,
    8: (),
}


@pytest.mark.parametrize("effect", [e for e in HIDDEN if ALL or e in QUICK])
def test_a_hidden_effect_is_named(effect):
    record = one_set(Task(HIDDEN.index(effect), "single", (effect,)))
    assert record["right"], record


@pytest.mark.parametrize("seed", [100, slow(104)])
def test_two_hidden_effects_are_both_named(seed):
    assert one_set(Task(seed, "pair"))["right"]


@pytest.mark.parametrize("seed", range(100, 104 if ALL else 101))
def test_a_healthy_rig_is_left_alone(seed):
    record = one_set(Task(seed, "healthy"))
    assert record["verdict"] == "no_discrepancy"
    assert record["causes"] == []


@SLOW
@pytest.mark.parametrize("seed", [102, 104])
def test_what_has_no_name_is_called_unknown_with_its_link(seed):
    assert one_set(Task(seed, "foreign"))["right"]


@SLOW
@pytest.mark.parametrize("number", SETS)
def test_practice_sets(number):
    folder = measured_data("rig_practice")
    answers = yaml.safe_load((Path(folder) / "answers.yaml").read_text())[f"set_{number}"]
    findings = investigate(load_dataset(Path(folder) / f"set_{number}" / "dataset.yaml"))
    verdict = decide(findings)
    if SETS[number] is None:
        assert (verdict.verdict, verdict.link) == ("unknown", "contact")
        return
    causes = [cause_of(c) for c in verdict.causes]
    sets = [(c.effect, *c.indistinguishable_from) for c in causes]
    assert judged_right(
        "single" if answers else "healthy", list(answers), [], verdict.verdict, verdict.link, sets
    )
    for cause in causes:
        for name, true in answers.get(cause.effect, {}).items():
            if isinstance(true, float):
                assert cause.parameters[name].estimate == pytest.approx(true, rel=0.15)


def test_the_judgement_wants_every_cause_and_no_more():
    assert judged_right("pair", ["a", "b"], [], "named", "contact", [("a",), ("c", "b")])
    assert not judged_right("single", ["a"], [], "named", "contact", [("a",), ("b",)])
    assert not judged_right("single", ["a"], [], "ambiguous", "contact", [("b", "c", "d", "a")])
    assert not judged_right("healthy", [], [], "unknown", "contact", [])
    assert judged_right("foreign", [], ["sensor"], "unknown", "contact", [])
    assert np.all(
        [not judged_right("single", ["a"], [], v, None, []) for v in ("unknown", "no_discrepancy")]
    )
