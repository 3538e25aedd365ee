"""Records without the pose that was reached: A went where the believed drives took it, under the
recorded force.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

import hiltestbed
from hiltestbed.diagnosis.layout import lay_out
from hiltestbed.diagnosis.links import WrenchLink
from hiltestbed.diagnosis.paths import best_path, make_wrench_link
from hiltestbed.diagnosis.recorded import DatasetLayout
from hiltestbed.effects import Effect
from hiltestbed.measured import load_dataset

from .made import effect
from .recorded import NOMINAL, recorded

NOISE = NOMINAL["sensor"]["noise"]  # [N]
SERVO = NOMINAL | {"rig": {"platform": {"kind": "pss33", "tracking": "servo"}}}


def without_reached(dataset: Path, folder: Path) -> Path:
    """The same dataset file, of whose runs the pose that was reached is not on record."""
    for file in dataset.parent.glob("*.yaml"):
        shutil.copy(file, folder)
    for file in dataset.parent.glob("*.parquet"):
        table = pq.read_table(file)
        lost = [n for n in table.column_names if n.startswith(("pose_act.", "twist_act."))]
        pq.write_table(table.drop_columns(lost), folder / file.name)
    return folder / dataset.name


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The dataset of a healthy rig."""
    return recorded(tmp_path_factory.mktemp("whole"), [], SERVO)


@pytest.fixture(scope="module")
def healthy(whole: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return without_reached(whole, tmp_path_factory.mktemp("healthy"))


def replayed(dataset: Path) -> tuple[DatasetLayout, WrenchLink]:
    layout = lay_out(load_dataset(dataset))
    return layout, make_wrench_link(layout, best_path(layout, None), layout.whole)


def misfits(dataset: Path, *known: Effect) -> list[float]:
    """[N] the rms of what is left of each run's force in contact."""
    layout, link = replayed(dataset)
    found = []
    for i, run in enumerate(layout.runs):
        left = (link.runs[i].measured - link.shown(i, known))[run.touching(link.runs[i].rows), 2]
        found.append(float(np.sqrt(np.mean(left**2))))
    return found


def test_the_path_is_the_one_on_which_the_drives_followed_the_command(
    whole: Path, healthy: Path
) -> None:
    """The drives are late by some 8 ms, 500 um at 0.06 m/s, and yield by 10 um; the recorded force
    is late by whole ticks, which are shifted back, and its noise of 0.1 N over drives of some 1e7
    N/m makes 10 nm.
    """
    layout, link = replayed(healthy)
    assert layout.deflection is not None
    for i, (path, found) in enumerate(zip(link.paths, layout.deflection, strict=True)):
        pose = pq.read_table(whole.parent / f"run_{i}.parquet")["pose_act.pz"].to_numpy()
        assert np.abs(found.away[:, 2]).max() > 1e-4
        assert np.abs(path[:, 2] - pose).max() < 1e-7


def test_what_the_sensor_read_follows_from_the_command(healthy: Path, tmp_path: Path) -> None:
    """An effect of the platform acts before its drives, which are linear: the reading is that of
    the drives behind the late command.
    """
    late: dict[str, Any] = {"kind": "platform.delay", "delay": 0.004}
    delayed = recorded(tmp_path, [late], SERVO, ("pose_act", "twist_act"))
    assert max(misfits(healthy)) < 1.3 * NOISE
    assert max(misfits(delayed, effect("platform.delay", delay=0.004))) < 1.3 * NOISE


def test_a_healthy_rig_departs_nowhere(healthy: Path) -> None:
    found = hiltestbed.diagnose(healthy)
    assert (found.verdict, found.causes) == ("inconclusive", ())
