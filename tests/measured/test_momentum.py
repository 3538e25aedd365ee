"""The force's impulse against the logged motion in closed form: the force's record may be late,
filtered, reversed, in another unit.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from hiltestbed.measured import examine
from hiltestbed.measured.momentum import Momentum, balances
from hiltestbed.measured.ratio import AGREE, EXPLAINED
from hiltestbed.measured.units import POUND_FORCE

from . import bounce

NOISE = 0.1  # [N]
IMPULSE = 2 * bounce.SPEED / (1 / bounce.CHASER + 1 / bounce.TARGET)  # [N s] of an undamped bounce
# 1 sigma of the impulse that white noise has over the run, as part of the impulse; four of them
BY_NOISE = 4 * NOISE * math.sqrt(bounce.DURATION / bounce.RATE) / IMPULSE


def _balance(folder: Path, columns: dict[str, np.ndarray]) -> Momentum:
    run = examine(bounce.write_dataset(folder, columns)).runs[0]
    return balances(run.record, run.scenario)["wrench_meas"]


def _late(delay: float, time_constant: float = 0.0) -> np.ndarray:
    """The force of the bounce (rows,) behind a delay and a first-order lag, of 100 steps a row."""
    step = 0.01 / bounce.RATE
    t = np.arange(round(bounce.DURATION / step)) * step
    force = bounce.STIFFNESS * np.maximum(bounce._depth(t - delay), 0.0)
    if time_constant:
        part = -math.expm1(-step / time_constant)
        force = lfilter([part], [1.0, part - 1.0], force)
    return np.asarray(force[::100]) + NOISE * np.random.default_rng(3).standard_normal(
        len(force[::100])
    )


@pytest.mark.parametrize("factor", [1.0, -1 / POUND_FORCE])
@pytest.mark.parametrize(
    ("delay", "time_constant"),
    [(0.0, 0.0), (0.0023, 0.0), (0.020, 0.0), (0.003, 0.006)],
)
def test_a_late_record_has_the_impulse_of_the_force(
    tmp_path: Path, factor: float, delay: float, time_constant: float
) -> None:
    """Mass times change of velocity is 1/factor times the impulse: exactly if it is not late, else
    by far less than two units differ.
    """
    table = bounce.columns()
    table["wrench_meas.fz"] = factor * _late(delay, time_constant)
    pair = _balance(tmp_path, table)
    tolerance = BY_NOISE if not delay else 0.5 * (AGREE - 1.0)
    assert pair.explained > EXPLAINED
    assert pair.scale * factor == pytest.approx(1.0, abs=tolerance)
    assert pair.axes == ("z",)


@pytest.mark.parametrize("factor", [1.0, -1.0])
def test_an_oscillation_leaves_the_sine_of_the_phase_of_its_delay_unexplained(
    tmp_path: Path, factor: float
) -> None:
    """On a sinusoid the force is proportional to the motion: of a late one the cosine is left."""
    table = bounce.columns()
    amplitude, delay = 2e-3, 0.008
    for group, at in (("pose_cmd", table["t"] + 1 / bounce.RATE), ("pose_act", table["t"])):
        table[f"{group}.pz"] = amplitude * np.sin(bounce.OMEGA * at)
    force = bounce.STIFFNESS * amplitude * np.sin(bounce.OMEGA * (table["t"] - delay))
    table["wrench_meas.fz"] = factor * (
        force + NOISE * np.random.default_rng(3).standard_normal(len(force))
    )
    pair = _balance(tmp_path, table)
    late = math.cos(bounce.OMEGA * (delay + 1 / bounce.RATE))  # and the tick of the command
    assert pair.explained == pytest.approx(late**2, abs=0.02)
    assert pair.scale * factor == pytest.approx(late, abs=0.02)


def test_pounds_are_recognised_behind_a_delay(tmp_path: Path) -> None:
    """The hint is the exact factor of the unit, and the ratio beside it nearly so."""
    table = bounce.columns()
    for group in ("wrench_meas", "wrench_comp"):
        table[f"{group}.fz"] = table[f"{group}.fz"] / POUND_FORCE
    table["wrench_meas.fz"] = _late(0.012) / POUND_FORCE
    errors = [
        r
        for r in examine(bounce.write_dataset(tmp_path, table)).remarks
        if r.channel == "wrench_meas.fz" and r.check == "unit"
    ]
    ratio = float(errors[0].text.partition(" is ")[2].partition(" times")[0])
    assert ratio == pytest.approx(POUND_FORCE, rel=AGREE - 1.0)
    assert "lbf" in errors[0].text
    assert f"{POUND_FORCE:.8g}" in errors[0].fix
