"""Runs of mechanisms with moving parts under a servo, the default: what the loop records, its own
diagnosis explains.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hiltestbed import diagnose
from hiltestbed.diagnosis.links import flat_pose
from hiltestbed.diagnosis.result import Finding
from hiltestbed.diagnosis.yielding import deflection, engagement, told_pose
from hiltestbed.identification.samples import GATE_SIGMA
from hiltestbed.measured import load_dataset
from hiltestbed.scenario import load_scenario
from tests.slow import SLOW

from .recorded import dataset_of

pytestmark = SLOW


def recorded(folder: Path, name: str, duration: float, effects: list[dict[str, Any]]) -> Path:
    """A dataset of two runs, the second one at four fifths of the speed."""
    nominal = load_scenario(name)
    sets = [
        {"duration": duration, "approach.velocity": [part * v for v in nominal.approach.velocity]}
        for part in (1.0, 0.8)
    ]
    return dataset_of(folder, nominal, sets, effects)


def found(folder: Path, name: str, duration: float, effects: list[dict[str, Any]]) -> Finding:
    """The diagnosis of two such runs."""
    return diagnose(recorded(folder, name, duration, effects)).finding


@pytest.mark.parametrize(("name", "duration"), [("16-probe-drogue", 4.0), ("17-gripper", 3.0)])
def test_where_nothing_departs_nothing_is_found(tmp_path: Path, name: str, duration: float) -> None:
    finding = found(tmp_path, name, duration, [])
    assert finding.verdict == "no_discrepancy"
    assert not finding.not_judged
    chaos = any("the smallest difference decides" in words for words in finding.assumed)
    assert chaos == (name == "17-gripper")  # its jaws slip and stick from step to step


def test_a_gain_is_told_by_what_comes_before_the_jaws_slip(tmp_path: Path) -> None:
    """Three per cent of the 0.7 kN of the touch are 70 standard deviations of one sample."""
    finding = found(
        tmp_path, "17-gripper", 2.1, [{"kind": "sensor.gain", "factor": 1.03, "axis": "z"}]
    )
    assert finding.verdict == "named"
    (cause,) = finding.causes
    assert cause.effect == "sensor.gain"
    assert cause.parameters["factor"].estimate == pytest.approx(1.03, abs=0.001)


def test_drives_yield_to_a_captured_ring_also_where_its_force_passes_through_zero(
    tmp_path: Path,
) -> None:
    """The rings hold each other by 4 N m; from 4.50 to 4.56 s their force is below the noise of 0.3
    N, as if they were apart.
    """
    measured = load_dataset(recorded(tmp_path, "15-ring-docking", 4.7, [])).runs[0]
    # [N], [ticks]
    force, late = 0.3, round(measured.scenario.sensor.delay * measured.scenario.rate)
    apart = ~measured.survey.touching(measured.record.ticks, late, GATE_SIGMA * force)
    deflected = deflection(measured, force, engaged=engagement(measured))
    moved = flat_pose(measured.record.filled("pose_act")) - flat_pose(told_pose(measured))
    gap = slice(9000, 9120)
    assert apart[gap].all()
    assert np.abs(moved[gap, 4]).min() > 1e-7  # [rad]
    assert np.abs(moved - deflected.away)[gap, 4].max() < 0.05 * np.abs(moved[gap, 4]).min()
