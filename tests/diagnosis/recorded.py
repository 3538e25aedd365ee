"""Datasets made by the simulation itself, for what follows once a cause is named; naming is tested on an independent rig."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from hiltestbed.recording import write_trace
from hiltestbed.scenario import scenario_from
from hiltestbed.simulation import simulate

SPEEDS = (0.02, 0.06)
NOMINAL: dict[str, Any] = {
    "name": "facility",
    "duration": 0.8,
    "rate": 1000.0,
    "physics_rate": 2000.0,
    "spacecraft": {
        "chaser": {"mass": 500.0, "inertia": [200.0, 180.0, 150.0], "port": {"position": [0, 0, 1.0]}},
        "target": {"mass": 2000.0, "inertia": [900.0, 900.0, 700.0], "port": {"position": [0, 0, -1.0]}},
    },
    "approach": {"gap": 0.002, "velocity": [0, 0, 0.02]},
    "mechanism": {"kind": "bumper", "contact": {"stiffness": 1.0e5, "damping": 400.0}},
    "rig": {"platform": {"kind": "pss33", "tracking": "ideal"}},
    "sensor": {"delay": 0.005, "noise": 0.1},
    "compensation": {"force": {"kind": "phase_lead"}, "motion": {"kind": "none"}},
}


def recorded(folder: Path, effects: list[dict[str, Any]]) -> Path:
    """The dataset file of two runs of a rig that has `effects`, which its nominal scenario does not."""
    sets = [{"approach.velocity.2": v, "approach.gap": 0.1 * v} for v in SPEEDS]
    rig = [scenario_from(NOMINAL | {"effects": effects, "seed": i}, s) for i, s in enumerate(sets)]
    trace = simulate(rig, trace=True).trace
    assert trace is not None
    for i in range(len(rig)):
        write_trace(trace.run(i), folder / f"run_{i}.parquet")
    yaml = YAML(typ="safe")
    yaml.dump(NOMINAL, folder / "nominal.yaml")
    runs = [{"file": f"run_{i}.parquet", "set": s} for i, s in enumerate(sets)]
    yaml.dump({"scenario": "nominal.yaml", "runs": runs}, folder / "dataset.yaml")
    return folder / "dataset.yaml"
