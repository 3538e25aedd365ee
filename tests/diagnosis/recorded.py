"""Datasets made by the simulation itself, for what follows once a cause is named; naming is tested
on an independent rig.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from ruamel.yaml import YAML

from hiltestbed.measured import MeasuredDataset, load_dataset
from hiltestbed.run_folder.store import write_trace
from hiltestbed.scenario import scenario_from
from hiltestbed.signals import RunTrace
from hiltestbed.simulation import simulate
from tests.equipment.independent_rig import draw_set, write_set

SPEEDS = (0.02, 0.06)
CHASER = {"mass": 500.0, "inertia": [200.0, 180.0, 150.0], "port": {"position": [0, 0, 1.0]}}
TARGET = {"mass": 2000.0, "inertia": [900.0, 900.0, 700.0], "port": {"position": [0, 0, -1.0]}}
NOMINAL: dict[str, Any] = {
    "name": "facility",
    "duration": 0.8,
    "rate": 1000.0,
    "physics_rate": 2000.0,
    "spacecraft": {"chaser": CHASER, "target": TARGET},
    "approach": {"gap": 0.002, "velocity": [0, 0, 0.02]},
    "mechanism": {"kind": "bumper", "contact": {"stiffness": 1.0e5, "damping": 400.0}},
    "rig": {"platform": {"kind": "pss33", "tracking": "ideal"}},
    "sensor": {"delay": 0.005, "noise": 0.1},
    "compensation": {"force": {"kind": "phase_lead"}, "motion": {"kind": "none"}},
}


def drawn(folder: Path, seed: int, *hidden: str, **options: Any) -> MeasuredDataset:
    """A set of the independent rig, healthy or with what is ``hidden``."""
    options |= {"names": hidden} if hidden else {}
    kind = "single" if hidden else "healthy"
    write_set(folder, draw_set(np.random.default_rng(seed), kind, **options))
    return load_dataset(folder / "dataset.yaml")


def written(trace: RunTrace, file: Path, without: Sequence[str] = ()) -> None:
    """A trace on record, without some of its groups."""
    write_trace(trace, file)
    table = pq.read_table(file)
    names = [c for c in table.column_names if c.partition(".")[0] not in without]
    pq.write_table(table.select(names), file)


def recorded(
    folder: Path,
    effects: list[dict[str, Any]],
    nominal: Mapping[str, Any] = NOMINAL,
    without: Sequence[str] = (),
    beside: Mapping[str, Any] | None = None,
) -> Path:
    """The dataset file of two runs of a rig that has `effects`, which its ``nominal`` scenario does
    not.

    without: groups that were not recorded. beside: settings of the second run alone.
    """
    sets: list[dict[str, Any]] = [
        {"approach.velocity.2": v, "approach.gap": 0.1 * v} for v in SPEEDS
    ]
    sets[1] |= beside or {}
    for i, s in enumerate(sets):
        trace = simulate(
            [scenario_from({**nominal, "effects": effects, "seed": i}, s)], trace=True
        ).trace
        assert trace is not None
        written(trace.run(0), folder / f"run_{i}.parquet", without)
    yaml = YAML(typ="safe")
    yaml.dump(dict(nominal), folder / "nominal.yaml")
    runs = [{"file": f"run_{i}.parquet", "set": s} for i, s in enumerate(sets)]
    yaml.dump({"scenario": "nominal.yaml", "runs": runs}, folder / "dataset.yaml")
    return folder / "dataset.yaml"
