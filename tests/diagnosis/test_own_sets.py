"""What the simulation can run can be diagnosed: shipped scenarios as they record themselves,
healthy and with something hidden.

The records are those of the loop, so that differences between the models of loop and replay become
visible; the second rig covers facilities that compute differently. ``./check --all`` goes through
all scenarios.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hiltestbed.config.gallery import shipped
from hiltestbed.diagnosis.investigate import investigate
from hiltestbed.diagnosis.verdict import Verdict, decide
from hiltestbed.measured import load_dataset
from hiltestbed.scenario import Scenario, load_scenario, resolved, scenario_from
from tests.slow import ALL, slow

from .recorded import dataset_of

SCENARIOS = sorted(f.stem for f in shipped("scenarios").glob("*.yaml"))
# without contact or one that can be judged
WITHOUT_CONTACT = (
    "01-free-flight",
    "12-miss",
    "14-rendezvous",
    "15-ring-docking",
    "16-probe-drogue",
    "17-gripper",
)
# factors on speed and known spring of each run; of a scenario of more than 10 s, the first three
RUNS = ((1.0, 1.0), (0.75, 1.0), (1.25, 1.0), (1.0, 0.6), (1.0, 1.6))
NOISE = 1e-3  # of the force that stops the approach, for a scenario without noise
HIDDEN: dict[str, dict[str, Any]] = {
    "sensor.delay": {"delay": 0.003},
    "contact.stiffness": {"factor": 0.85},
    "sensor.gain": {"factor": 1.1, "axis": "z"},
    "dynamics.mass": {"factor": 1.15, "body": "chaser"},
    "platform.lag": {"bandwidth": 25.0},
    "contact.surface_friction": {},
    "contact.dry_friction": {},
}


def force_of(scenario: Scenario) -> float:
    """v sqrt(k mu) [N]: the force that stops the approach along z."""
    chaser, target = scenario.spacecraft.chaser.mass, scenario.spacecraft.target.mass
    stiffness, mount = scenario.mechanism.contact.stiffness, scenario.mechanism.mount
    if mount is not None:
        stiffness = min(stiffness, mount.stiffness[2])
    reduced = chaser * target / (chaser + target)
    return abs(scenario.approach.velocity[2]) * (stiffness * reduced) ** 0.5


def nominal_of(name: str) -> Scenario:
    scenario = load_scenario(shipped("scenarios") / f"{name}.yaml")
    if scenario.sensor.noise > 0.0:
        return scenario
    level = NOISE * force_of(scenario)
    noise = {"sensor.noise": level, "sensor.torque_noise": 0.1 * level}
    return scenario_from(resolved(scenario), set=noise)


def campaign(scenario: Scenario) -> list[dict[str, Any]]:
    """Changed keys of several speeds and known springs; slower runs last longer."""
    out, mount = [], scenario.mechanism.mount
    for speed, spring in RUNS[: 3 if scenario.duration > 10.0 else None]:
        changes: dict[str, Any] = {
            "approach.velocity": [speed * v for v in scenario.approach.velocity],
            "duration": round(scenario.duration / min(speed, 1.0), 3),
        }
        if mount is not None:
            changes["mechanism.mount.stiffness"] = [spring * k for k in mount.stiffness]
        else:
            changes["mechanism.contact.stiffness"] = spring * scenario.mechanism.contact.stiffness
        out.append(changes)
    return out


def verdict_of(nominal: Scenario, folder: Path, *effects: Mapping[str, Any]) -> Verdict:
    file = dataset_of(folder, nominal, campaign(nominal), effects, seed=nominal.seed)
    with np.errstate(all="ignore"):
        return decide(investigate(load_dataset(file)))


@pytest.mark.parametrize("scenario", SCENARIOS if ALL else [slow("05-off-centre")])
def test_a_healthy_rig_is_left_alone(scenario: str, tmp_path: Path) -> None:
    verdict = verdict_of(nominal_of(scenario), tmp_path)
    unjudged = scenario in WITHOUT_CONTACT
    assert verdict.verdict == ("inconclusive" if unjudged else "no_discrepancy"), verdict
    assert verdict.causes == ()
    assert bool(verdict.not_judged) == unjudged


@pytest.mark.parametrize(
    ("scenario", "kind"),
    [(s, k) for s in SCENARIOS if s not in WITHOUT_CONTACT for k in HIDDEN]
    if ALL
    else [slow("05-off-centre", "contact.stiffness")],
)
def test_what_is_hidden_is_named(scenario: str, kind: str, tmp_path: Path) -> None:
    nominal = nominal_of(scenario)
    hidden = {"kind": kind, **HIDDEN[kind]}
    if kind == "contact.dry_friction":
        hidden["force"] = float(f"{0.05 * force_of(nominal):.3g}")
    if kind == "contact.surface_friction":
        hidden["coefficient"] = round(nominal.mechanism.contact.friction + 0.1, 3)
    verdict = verdict_of(nominal, tmp_path, hidden)
    assert verdict.verdict in ("named", "ambiguous"), verdict
    names = [(c.effect, *c.indistinguishable_from) for c in verdict.causes]
    assert len(names) == 1, verdict
    assert kind in names[0], verdict
