"""A motion that was only measured is taken as smooth, one that a facility was commanded along as uniform within a tick."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import hiltestbed
from hiltestbed.diagnosis.layout import lay_out
from hiltestbed.diagnosis.paths import best_path, make_wrench_link
from hiltestbed.measured import load_dataset

STIFFNESS, DAMPING, MASS, GAP, SPEED = 1e5, 400.0, 100.0, 0.0023, 0.06  # [N/m], [N s/m], [kg], [m], [m/s]
RATE = 2000  # [Hz]


def bounce() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, place past the touch and force of a mass on a spring and a damper, in closed form up to where it turns back."""
    d = 0.5 * DAMPING / MASS
    w = math.sqrt(STIFFNESS / MASS - d * d)
    t = np.arange(round(0.09 * RATE)) / RATE
    s = np.maximum(t - GAP / SPEED, 0.0)
    x = SPEED / w * np.exp(-d * s) * np.sin(w * s)
    v = SPEED * np.exp(-d * s) * (np.cos(w * s) - d / w * np.sin(w * s))
    touches = t > GAP / SPEED
    return t, np.where(touches, x, SPEED * t - GAP), np.where(touches, STIFFNESS * x + DAMPING * v, 0.0)


@pytest.mark.parametrize("noise", [0.0, 5e-7], ids=["clean", "smoothed"])
def test_the_force_of_a_smooth_motion_has_no_half_tick_of_its_acceleration(tmp_path: Path, noise: float) -> None:
    """The slope of the tick that ends would add c a h/2, 0.18 N of the peak's 180 N; sampled alone it costs c x''' h^2/6, 1 mN."""
    t, place, force = bounce()
    rng = np.random.default_rng(3)
    measured = {
        "t": t,
        "pose_act.pz": place + noise * rng.standard_normal(len(t)),
        "wrench_meas.fz": force + 0.05 * rng.standard_normal(len(t)),
    }
    pq.write_table(pa.table(measured), tmp_path / "run.parquet")
    contact = {"mechanism": {"kind": "bumper", "contact": {"stiffness": STIFFNESS, "damping": DAMPING}}, "approach.gap": GAP}
    rig = {"rate": RATE, "physics_rate": 8 * RATE, "duration": len(t) / RATE, "approach.velocity.2": SPEED}
    (tmp_path / "nominal.yaml").write_text(hiltestbed.dump_scenario(hiltestbed.load_scenario("02-bumper", contact | rig)), "utf-8")
    (tmp_path / "dataset.yaml").write_text("scenario: nominal.yaml\nruns: [{file: run.parquet}]\naccept: [unit]\n", "utf-8")
    layout = lay_out(load_dataset(tmp_path / "dataset.yaml"))
    link = make_wrench_link(layout, best_path(layout, None), layout.whole)
    off = (link.shown(0)[:, 2] - force)[force > 150.0]
    half_tick = DAMPING * 150.0 / MASS / (2.0 * RATE)
    assert abs(np.mean(off)) < (0.02 if noise == 0.0 else 0.3) * half_tick
