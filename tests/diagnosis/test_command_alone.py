"""Records without the pose that was reached: A went where the believed drives took it, under the
recorded force.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

import hiltestbed
from hiltestbed.diagnosis.layout import DatasetLayout, lay_out
from hiltestbed.diagnosis.links import WrenchLink
from hiltestbed.diagnosis.paths import best_path, make_wrench_link
from hiltestbed.measured import load_dataset

from .made import effect
from .recorded import NOMINAL, recorded

NOISE = NOMINAL["sensor"]["noise"]  # [N]
SERVO = NOMINAL | {"rig": {"platform": {"kind": "pss33", "tracking": "servo"}}}
LATE: dict[str, Any] = {"kind": "platform.delay", "delay": 0.004}


def replayed(folder: Path, effects: list[dict[str, Any]]) -> tuple[DatasetLayout, WrenchLink]:
    layout = lay_out(load_dataset(recorded(folder, effects, SERVO, ("pose_act", "twist_act"))))
    return layout, make_wrench_link(layout, best_path(layout, None), layout.whole)


def test_the_path_is_the_one_on_which_the_drives_followed_the_command(tmp_path: Path) -> None:
    """The drives are late by some 8 ms, 500 um at 0.06 m/s, and yield by 10 um; the recorded force
    is late by whole ticks, which are shifted back, and its noise of 0.1 N over drives of some 1e7
    N/m makes 10 nm.
    """
    reached = recorded(tmp_path, [], SERVO)
    poses = [
        np.asarray(pq.read_table(reached.parent / f"run_{i}.parquet", columns=["pose_act.pz"])[0])
        for i in range(2)
    ]
    layout, link = replayed(tmp_path, [])
    assert layout.deflection is not None
    for path, pose, found in zip(link.paths, poses, layout.deflection, strict=True):
        assert np.abs(found.away[:, 2]).max() > 1e-4
        assert np.abs(path[:, 2] - pose).max() < 1e-7


@pytest.mark.parametrize("effects", [[], [LATE]], ids=["healthy", "late"])
def test_what_the_sensor_read_follows_from_the_command(
    tmp_path: Path, effects: list[dict[str, Any]]
) -> None:
    """An effect of the platform acts before its drives, which are linear: the reading is that of
    the drives behind the late command.
    """
    layout, link = replayed(tmp_path, effects)
    known = [effect(e["kind"], delay=e["delay"]) for e in effects]
    for i, run in enumerate(layout.runs):
        left = (link.runs[i].measured - link.shown(i, known))[run.touching(link.runs[i].rows), 2]
        assert np.sqrt(np.mean(left**2)) < 1.3 * NOISE


def test_a_healthy_rig_departs_nowhere(tmp_path: Path) -> None:
    found = hiltestbed.diagnose(recorded(tmp_path, [], SERVO, ("pose_act", "twist_act")))
    assert (found.verdict, found.causes) == ("inconclusive", ())
