"""Datasets made by the simulation itself, for what follows once a cause is named; naming is tested
on an independent rig.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.random import Generator

from hiltestbed.config.yaml_source import dump_yaml
from hiltestbed.measured import MeasuredDataset, load_dataset
from hiltestbed.run_folder.store import write_trace
from hiltestbed.scenario import Scenario, dump_scenario, resolved, scenario_from
from hiltestbed.simulation import simulate
from tests.equipment.independent_rig import draw_set, write_set

Change = Callable[[pa.Table], pa.Table]
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


def without(*groups: str) -> Change:
    """Leaves these groups out of a log."""
    return lambda log: log.select(
        [c for c in log.column_names if c.partition(".")[0] not in groups]
    )


def only(names: Sequence[str]) -> Change:
    """Leaves in a log its time and these groups and columns."""
    return lambda log: log.select(
        [c for c in log.column_names if c == "t" or not {c, c.partition(".")[0]}.isdisjoint(names)]
    )


def with_noise(log: pa.Table, columns: Sequence[str], noise: float, rng: Generator) -> pa.Table:
    """A log with white noise in some of its columns."""
    for name in (c for c in log.column_names if c in columns):
        noisy = log[name].to_numpy() + noise * rng.standard_normal(len(log))
        log = log.set_column(log.column_names.index(name), name, pa.array(noisy))
    return log


def logged(scenario: Scenario, file: Path, change: Change = lambda log: log) -> None:
    """A run of a scenario on record, in a log that is changed."""
    trace = simulate([scenario], trace=True).trace
    assert trace is not None
    write_trace(trace.run(0), file)
    pq.write_table(change(pq.read_table(file)), file)


def dataset_of(
    folder: Path,
    nominal: Scenario,
    sets: Sequence[Mapping[str, Any]],
    effects: Sequence[Mapping[str, Any]] = (),
    *,
    unknown: Mapping[str, Any] = MappingProxyType({}),
    seed: int = 0,
    change: Change = lambda log: log,
) -> Path:
    """The dataset file of runs of a rig that has ``effects``, which its ``nominal`` scenario does
    not; ``sets``: changed keys of each run.

    unknown: changed keys of the rig that the dataset does not tell. change: of the log of a run.
    """
    entries = []
    for i, keys in enumerate(sets):
        acting = resolved(nominal) | {"effects": [dict(e) for e in effects], "seed": seed + i}
        logged(scenario_from(acting, {**unknown, **keys}), folder / f"run_{i}.parquet", change)
        entries.append({"file": f"run_{i}.parquet", "set": dict(keys)})
    (folder / "nominal.yaml").write_text(dump_scenario(nominal), "utf-8")
    dataset = dump_yaml({"scenario": "nominal.yaml", "runs": entries})
    (folder / "dataset.yaml").write_text(dataset, "utf-8")
    return folder / "dataset.yaml"


def recorded(
    folder: Path,
    effects: Sequence[Mapping[str, Any]],
    nominal: Mapping[str, Any] = NOMINAL,
    missing: Sequence[str] = (),
) -> Path:
    """The dataset file of two runs of a small rig, in which groups may be ``missing``."""
    sets = [{"approach.velocity.2": v, "approach.gap": 0.1 * v} for v in SPEEDS]
    return dataset_of(folder, scenario_from(nominal), sets, effects, change=without(*missing))
