"""`hiltestbed compare` of foreign records: planted delays, to a fraction of a sample."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from hiltestbed.analysis.record_comparison import shift_between

STIFFNESS, SPEED, W = 1.0e5, 0.03, 2.0 * np.pi * 2.5  # [N/m], [m/s], [rad/s] of a half sine

TICK = 1.0 / 2000.0  # [s] of the scenario


def pose(t: np.ndarray) -> np.ndarray:
    """[m] approach, half a sine of penetration, and the way back."""
    deep = SPEED / W * np.sin(W * np.clip(t - 0.3, 0.0, np.pi / W))
    return np.where(t < 0.3, SPEED * (t - 0.3), deep - SPEED * np.maximum(t - 0.3 - np.pi / W, 0.0))


def force(t: np.ndarray) -> np.ndarray:
    """[N]"""
    return STIFFNESS * np.maximum(pose(t), 0.0)


@pytest.mark.parametrize("rate", [500.0, 2000.0])
def test_a_planted_delay_is_found_to_a_fraction_of_a_sample(rate: float) -> None:
    rng, delay = np.random.default_rng(4), 0.00437
    t_a, t_b = np.arange(0.0, 0.8, 1e-3), 7.0 + np.arange(0.0, 0.8, 1.0 / rate)
    a = force(t_a) + rng.normal(0.0, 0.5, len(t_a))
    b = 0.9 * force(t_b - 7.0 - delay) + 3.0 + rng.normal(0.0, 0.5, len(t_b))
    found = shift_between(t_a, a, t_b, b)
    # of 190 N, 0.5 N of noise
    assert found.delay == pytest.approx(7.0 + delay, abs=max(4.0 * found.sd, 2e-5))
    assert found.sd < 1e-4
    assert (found.gain, found.offset) == pytest.approx((0.9, 3.0), abs=0.1)
    assert shift_between(t_a, np.zeros_like(a), t_b, b) is None


def test_delays_of_two_logs_are_a_ledger(call, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    late = {"a": (0.002, 0.001), "b": (0.0065, 0.0035)}  # of the force, of the platform
    for name, clock, rate in (("a", 0.0, 1000.0), ("b", 12.3456, 800.0)):
        t = np.arange(0.0, 0.8, 1.0 / rate)
        sensor, platform = late[name]
        columns = {
            "stamp": 1e3 * (t + clock),
            "command": 1e3 * pose(t + TICK),  # for the end of the tick
            "position": 1e3 * pose(t - platform),
            "load": force(t - platform - sensor) + rng.normal(0.0, 0.3, len(t)),
        }
        pd.DataFrame(columns).to_csv(tmp_path / f"{name}.csv", index=False)
    (tmp_path / "dataset.yaml").write_text(
        """scenario: reference-bumper
runs: [{file: a.csv}, {file: b.csv}]
channels:
  t: {column: stamp, unit: ms}
  pose_cmd.pz: {column: command, unit: mm}
  pose_act.pz: {column: position, unit: mm}
  wrench_meas.fz: {column: load}
"""
    )
    files = [str(tmp_path / f"{name}.csv") for name in "ab"]
    given = ("--channels", str(tmp_path / "dataset.yaml"))
    status, out, _ = call("compare", *files, *given, "--json")
    found = json.loads(out)
    assert status == 0
    assert found["aligned_by"] == "pose_cmd.pz"
    assert found["clock_offset"] == pytest.approx(12.3456, abs=5e-5)
    # k x of the delayed force: cos(w tau) of it, and the rest is damping
    k = found["stiffness"]
    assert k == pytest.approx(STIFFNESS, rel=0.02)
    delays = {row["what"]: row for row in found["between"] + found["within"]}
    expected = {
        "pose_act.pz: B after A": 0.0025,
        "wrench_meas.fz: B after A": 0.007,
        "A: platform (pose_cmd.pz to pose_act.pz)": 0.001,
        "B: platform (pose_cmd.pz to pose_act.pz)": 0.0035,
    }
    for what, delay in expected.items():
        assert delays[what]["delay"] == pytest.approx(delay, abs=1e-4), what
        assert delays[what]["damping"] == pytest.approx(-k * delays[what]["delay"])
    status, out, _ = call("compare", *files, *given, "--k", "1e5")
    assert status == 0
    assert "Aligned by pose_cmd.pz" in out
    status, _, err = call("compare", *files)
    assert status == 2
    assert "holds none of the columns" in err
