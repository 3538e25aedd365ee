"""A bounce in closed form as measured data: two free bodies, a spring, no damping; the law is x =
(v/w) sin(w t) while they touch.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

STIFFNESS, CHASER, TARGET = 1.0e5, 500.0, 2000.0
GAP, SPEED, SIDE = 3.0e-3, 0.03, 4.0e-3  # [m], [m/s], [m/s] along x
RATE, DURATION = 1000, 0.6
OMEGA = math.sqrt(STIFFNESS * (1 / CHASER + 1 / TARGET))
TOUCH, PARTING = GAP / SPEED, GAP / SPEED + math.pi / OMEGA
PEAK = STIFFNESS * SPEED / OMEGA

Table = dict[str, np.ndarray]
SCENARIO = f"""
name: bounce
seed: 1
duration: {DURATION}
rate: {RATE}
physics_rate: 4000
spacecraft:
  chaser: {{mass: {CHASER}, inertia: [200.0, 180.0, 150.0]}}
  target: {{mass: {TARGET}, inertia: [900.0, 900.0, 700.0]}}
approach: {{gap: {GAP}, velocity: [{SIDE}, 0.0, {SPEED}]}}
mechanism: {{kind: bumper, contact: {{stiffness: {STIFFNESS}, damping: 0.0}}}}
rig: {{platform: {{tracking: ideal}}}}
sensor: {{delay: 0.0}}
compensation: {{force: {{kind: none}}, motion: {{kind: none}}}}
"""


def columns(
    rate: float = RATE, force_noise: float = 0.1, pose_noise: float = 1e-6, seed: int = 5
) -> dict[str, np.ndarray]:
    """Column name to samples at ``rate`` [Hz] over DURATION, with white noise of known size."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(DURATION * rate)) / rate
    force = STIFFNESS * np.maximum(_depth(t), 0.0)
    out = {"t": t}
    # a command is reached a tick later
    for group, noise, at in (("pose_cmd", 0.0, t + 1 / RATE), ("pose_act", pose_noise, t)):
        pose = {"px": SIDE * at, "pz": _depth(at), "qw": 1.0}
        for part in ("px", "py", "pz", "qx", "qy", "qz", "qw"):
            out[f"{group}.{part}"] = pose.get(part, 0.0) + noise * rng.standard_normal(len(t))
    for part in ("fx", "fy", "fz", "tx", "ty", "tz"):
        noise = force_noise * rng.standard_normal(len(t)) * (1.0 if part[0] == "f" else 0.2)
        out[f"wrench_meas.{part}"] = noise + (force if part == "fz" else 0.0)
        out[f"wrench_comp.{part}"] = out[f"wrench_meas.{part}"].copy()
    return out


def _depth(t: np.ndarray) -> np.ndarray:
    """pz [m] at t."""
    pz = np.where(t < TOUCH, SPEED * (t - TOUCH), -SPEED * (t - PARTING))
    inside = (t >= TOUCH) & (t <= PARTING)
    pz[inside] = SPEED / OMEGA * np.sin(OMEGA * (t[inside] - TOUCH))
    return pz


def changed(group: str, factor: float, parts: str = "") -> Callable[[Table], None]:
    """Multiplies the columns of a group, or those of its ``parts``, by a factor."""

    def change(table: Table) -> None:
        for name in table:
            if name.startswith(group) and (not parts or name[-2:] in parts.split()):
                table[name] = factor * table[name]

    return change


def write_dataset(
    folder: Path, *tables: dict[str, Any], channels: str = "", files: tuple[str, ...] = ()
) -> Path:
    """The path of a dataset of Parquet files, or of ``files``, with its scenario beside it."""
    (folder / "nominal.yaml").write_text(SCENARIO)
    names = list(files)
    for index, table in enumerate(tables):
        names.append(f"run_{index}.parquet")
        pq.write_table(pa.table(table), folder / names[-1])
    runs = "\n".join(f"  - {{file: {name}}}" for name in names)
    path = folder / "dataset.yaml"
    path.write_text(f"scenario: nominal.yaml\nruns:\n{runs}\n{channels}")
    return path
