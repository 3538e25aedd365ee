"""Data sets recorded by the simulation itself: every shipped scenario, healthy and with a hidden
effect.

The diagnosis must be able to judge every scenario that the simulation can run. The records are
those of the loop, so that differences between the models of loop and replay become visible; the
independent rig covers facilities that compute differently.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hiltestbed.config.gallery import shipped
from hiltestbed.config.yaml_source import dump_yaml
from hiltestbed.run_folder.store import write_trace
from hiltestbed.scenario import Scenario, dump_scenario, load_scenario, resolved, scenario_from
from hiltestbed.simulation import simulate

# factors on both, one pair per run
SPEEDS_AND_SPRINGS = ((1.0, 1.0), (0.75, 1.0), (1.25, 1.0), (1.0, 0.6), (1.0, 1.6))
LONG = 10.0  # [s] duration above which a scenario's campaign has only three runs
# noise added to a scenario without noise, relative to the force that stops the approach
SENSIBLE_NOISE = 1e-3

HIDDEN: dict[str, dict[str, Any]] = {
    "sensor.delay": {"delay": 0.003},
    "contact.stiffness": {"factor": 0.85},
    "sensor.gain": {"factor": 1.1, "axis": "z"},
    "dynamics.mass": {"factor": 1.15, "body": "chaser"},
    "platform.lag": {"bandwidth": 25.0},
    "contact.surface_friction": {},
    "contact.dry_friction": {},
}


@dataclass(frozen=True)
class OwnSet:
    """A set to record: a scenario's file, changed keys, hidden effects, and whether as one run or
    as a campaign.
    """

    scenario: str
    effects: tuple[Mapping[str, Any], ...] = ()
    changes: Mapping[str, Any] | None = None
    single: bool = False
    noise: bool = True


def nominal_of(own: OwnSet) -> Scenario:
    """The nominal scenario, with sensor noise added if it has none and the set asks for noise."""
    scenario = load_scenario(
        shipped("scenarios") / f"{own.scenario}.yaml", set=dict(own.changes or {})
    )
    if own.noise and scenario.sensor.noise == 0.0:
        level = SENSIBLE_NOISE * expected_force(scenario)
        scenario = scenario_from(
            resolved(scenario), set={"sensor.noise": level, "sensor.torque_noise": 0.1 * level}
        )
    return scenario


def expected_force(scenario: Scenario) -> float:
    """v sqrt(k mu) [N]: the force that stops the approach along z."""
    body = scenario.spacecraft
    reduced = body.chaser.mass * body.target.mass / (body.chaser.mass + body.target.mass)
    stiffness = scenario.mechanism.contact.stiffness
    if scenario.mechanism.mount is not None:
        stiffness = min(stiffness, scenario.mechanism.mount.stiffness[2])
    return abs(scenario.approach.velocity[2]) * (stiffness * reduced) ** 0.5


def hidden_effect(kind: str, scenario: Scenario) -> dict[str, Any]:
    """One of :data:`HIDDEN`, scaled to a scenario."""
    sized = dict(HIDDEN[kind])
    if kind == "contact.dry_friction":
        sized["force"] = float(f"{0.05 * expected_force(scenario):.3g}")
    if kind == "contact.surface_friction":
        sized["coefficient"] = round(scenario.mechanism.contact.friction + 0.1, 3)
    return {"kind": kind, **sized}


def campaign(scenario: Scenario) -> list[dict[str, Any]]:
    """The runs of a test campaign: changed keys for several speeds and known springs; slower runs
    last longer.
    """
    out = []
    steps = SPEEDS_AND_SPRINGS[:3] if scenario.duration > LONG else SPEEDS_AND_SPRINGS
    for speed, spring in steps:
        changes: dict[str, Any] = {
            "approach.velocity": [speed * v for v in scenario.approach.velocity],
            "duration": round(scenario.duration / min(speed, 1.0), 3),
        }
        mount = scenario.mechanism.mount
        if mount is not None:
            changes["mechanism.mount.stiffness"] = [spring * k for k in mount.stiffness]
        else:
            changes["mechanism.contact.stiffness"] = spring * scenario.mechanism.contact.stiffness
        out.append(changes)
    return out


def record_set(own: OwnSet, folder: Path) -> Path:
    """Simulate a set and write its traces, nominal scenario and dataset file. Returns the dataset
    file.
    """
    folder.mkdir(parents=True, exist_ok=True)
    nominal = nominal_of(own)
    runs: Sequence[dict[str, Any]] = [{}] if own.single else campaign(nominal)
    for i, changes in enumerate(runs):
        hidden = scenario_from(
            resolved(nominal) | {"effects": list(own.effects), "seed": nominal.seed + 100 * i},
            set=changes,
        )
        trace = simulate([hidden], trace=True).trace
        write_trace(trace.run(0), folder / f"run_{i}.parquet")  # type: ignore[union-attr]
    (folder / "nominal.yaml").write_text(dump_scenario(nominal), encoding="utf-8")
    entries = [{"file": f"run_{i}.parquet", "set": changes} for i, changes in enumerate(runs)]
    (folder / "dataset.yaml").write_text(
        dump_yaml({"scenario": "nominal.yaml", "runs": entries}), encoding="utf-8"
    )
    return folder / "dataset.yaml"
