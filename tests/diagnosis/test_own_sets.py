"""What the simulation can run can be diagnosed: shipped scenarios as they record themselves,
healthy and with something hidden.

``./check --all`` goes through all of them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hiltestbed.diagnosis.investigate import investigate
from hiltestbed.diagnosis.verdict import Verdict, decide
from hiltestbed.measured import load_dataset
from tests.equipment.own_sets import HIDDEN, OwnSet, hidden_effect, nominal_of, record_set
from tests.slow import ALL, slow

SCENARIOS = sorted(f.stem for f in (Path(__file__).parents[2] / "scenarios").glob("*.yaml"))
# to be judged
WITHOUT_CONTACT = (
    "01-free-flight",
    "12-miss",
    "14-rendezvous",
    "15-ring-docking",
    "16-probe-drogue",
    "17-gripper",
)
QUICK = (slow("05-off-centre", "contact.stiffness"),)


def verdict_of(own: OwnSet, folder: Path) -> Verdict:
    with np.errstate(all="ignore"):
        return decide(investigate(load_dataset(record_set(own, folder))))


@pytest.mark.parametrize("scenario", SCENARIOS if ALL else [slow("05-off-centre")])
def test_a_healthy_rig_is_left_alone(scenario: str, tmp_path: Path) -> None:
    verdict = verdict_of(OwnSet(scenario), tmp_path)
    assert verdict.verdict == (
        "inconclusive" if scenario in WITHOUT_CONTACT else "no_discrepancy"
    ), verdict
    assert verdict.causes == ()
    assert bool(verdict.not_judged) == (scenario in WITHOUT_CONTACT)


@pytest.mark.parametrize(
    ("scenario", "kind"),
    [(s, k) for s in SCENARIOS if s not in WITHOUT_CONTACT for k in HIDDEN] if ALL else QUICK,
)
def test_what_is_hidden_is_named(scenario: str, kind: str, tmp_path: Path) -> None:
    hidden = hidden_effect(kind, nominal_of(OwnSet(scenario)))
    verdict = verdict_of(OwnSet(scenario, (hidden,)), tmp_path)
    assert verdict.verdict in ("named", "ambiguous"), verdict
    assert [kind in (c.effect, *c.indistinguishable_from) for c in verdict.causes] == [True], (
        verdict
    )
