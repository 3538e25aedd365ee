"""The result folder of a commissioning: the scenarios, a dataset of the motions, the figures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from hiltestbed.config.yaml_source import dump_yaml
from hiltestbed.devices.commission.procedure import Commissioned
from hiltestbed.frames import attitude_deg_from_quat
from hiltestbed.run_folder.store import whole_folder, write_trace
from hiltestbed.run_folder.versions import versions
from hiltestbed.scenario import dump_scenario
from hiltestbed.signals import AXES, RunTrace

RESULT, DATASET = "commission.json", "dataset.yaml"
NOMINAL, BELIEVED = "nominal.yaml", "believed.yaml"
LEAST_COMPLIANCE = 1e-12  # [m/N] that can be measured: 0.1 nm of a press of 100 N


def write_commission(result: Commissioned, path: Path) -> Path:
    """Write the folder and return its path. Raises InputError if it cannot be written."""
    with whole_folder(path, mark=RESULT) as folder:
        (folder / NOMINAL).write_text(dump_scenario(result.nominal), encoding="utf-8")
        (folder / BELIEVED).write_text(dump_scenario(result.believed), encoding="utf-8")
        text = json.dumps(figures(result), indent=2, allow_nan=False) + "\n"
        (folder / RESULT).write_text(text, encoding="utf-8")
        runs = []
        for number, (name, found) in enumerate(result.paths.items()):
            file, t = f"run_{number:02d}.parquet", np.arange(len(found.pose)) / result.believed.rate
            data = {"pose_cmd": found.command, "pose_act": found.pose, "wrench_meas": found.wrench}
            write_trace(RunTrace(t, data, np.zeros(len(t), dtype=bool)), folder / file)
            different = _differences(result.starts[name], len(t) / result.believed.rate)
            runs.append({"file": file, "set": different})
        name = f"commissioning of {result.believed.name}"
        dataset = {"name": name, "scenario": BELIEVED, "runs": runs}
        (folder / DATASET).write_text(dump_yaml(dataset), encoding="utf-8")
    return path


def _differences(start: np.ndarray, duration: float) -> dict[str, Any]:
    """Differences of a motion from the scenario: its start pose, at rest."""
    return {
        "approach.gap": float(-start[2]),
        "approach.offset": [float(v) for v in start[:2]],
        "approach.velocity": [0.0, 0.0, 0.0],
        "approach.attitude_deg": attitude_deg_from_quat(start[3:7]).tolist(),
        "approach.rate_deg": [0.0, 0.0, 0.0],
        "duration": duration,
    }


def figures(result: Commissioned) -> dict[str, Any]:
    """All measured quantities, as plain data."""
    sensor, platform = result.sensor, result.platform
    gain = next((n.value for n in sensor.numbers if n.source == n.axis == "z"), 1.0)
    return {
        "name": result.believed.name,
        "versions": versions(),
        "rate": result.observed.rate,
        "noise": dict(zip(AXES, result.observed.shown_noise.tolist(), strict=True)),
        "tare": dict(zip(AXES, result.observed.shown.tolist(), strict=True)),
        "sensor": {
            "sign": sensor.sign,
            "attitude_deg": attitude_deg_from_quat(sensor.attitude).tolist(),
            "attitude_ci95_deg": sensor.attitude_ci95_deg,
            "turn_deg": sensor.turn_deg,
            "delay": sensor.delay,
            "delay_ci95": sensor.delay_ci95,
            "gains_and_crosstalk": [vars(n) for n in sensor.numbers],
            "residual": dict(zip(AXES, sensor.residual, strict=True)),
            "reading": dict(zip(AXES, sensor.reading, strict=True)),
        },
        "platform": vars(platform),
        "stiffness": {
            "contact_as_felt": gain * result.believed.mechanism.contact.stiffness,
            "rig": [1.0 / c if c > LEAST_COMPLIANCE else None for c in platform.compliance],
        },
        "effects": [e.model_dump(mode="json") for e in result.nominal.effects],
        "departures": list(result.departures),
    }
