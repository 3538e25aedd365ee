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
from tests.slow import ALL, SLOW, slow

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


@SLOW
def test_a_turned_sensor_is_found_although_the_lever_went_along_with_it(tmp_path: Path) -> None:
    """A turn about x puts tz on ty, as a contact on another lever does, and the lever is chosen
    while nothing is known.
    """
    own = OwnSet(
        "05-off-centre", ({"kind": "sensor.rotation", "angles_deg": [1.0, 0.0, 0.0]},), single=True
    )
    with np.errstate(all="ignore"):
        explanation = investigate(load_dataset(record_set(own, tmp_path))).explanations["wrench"]
    assert explanation.adequate
    assert explanation.chosen.kinds == ("sensor.rotation",)
    assert explanation.chosen.theta == pytest.approx([1.0, 0.0], abs=0.01)


@SLOW
def test_a_platform_that_bears_another_force_than_the_sensor_shows_is_not_blamed(
    tmp_path: Path,
) -> None:
    """A part of fz that shows on fy is no load of the drives: under the record's wrench the
    platform seems to depart by 1e-6 of its way.
    """
    crosstalk = {"kind": "sensor.crosstalk", "source": "z", "axis": "y", "ratio": 0.15}
    verdict = verdict_of(OwnSet("05-off-centre", (crosstalk,), single=True), tmp_path)
    assert (verdict.verdict, verdict.link, [c.effect for c in verdict.causes]) == (
        "named",
        "sensor",
        ["sensor.crosstalk"],
    )
