"""The run folder: complete or absent, the same bytes for the same run, and read back as it was."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from hiltestbed import read_run, replay_failure, run, write_run
from hiltestbed.errors import HiltestbedError, InputError
from hiltestbed.run_folder import store as recording_module
from hiltestbed.signals import GROUPS
from hiltestbed.simulation import run_batch
from tests.running import shipped


@pytest.fixture(scope="module")
def short_run():
    return run(
        shipped("04-bumper-delay-compensated", {"duration": 0.45, "rig.platform.tracking": "ideal"})
    )


def test_a_run_is_read_back_as_it_was(short_run, tmp_path: Path) -> None:
    folder = write_run(short_run, tmp_path / "run", rerun=False)
    again = read_run(folder)
    assert again.scenario == short_run.scenario
    assert again.summary == short_run.summary
    for name, values in short_run.trace.columns().items():
        np.testing.assert_array_equal(again.trace.columns()[name], values)
    schema = pq.read_schema(folder / "trace.parquet")
    for group in GROUPS.values():
        for column, unit in zip(group.columns, group.units, strict=True):
            metadata = schema.field(column).metadata
            assert metadata[b"unit"].decode() == unit
            assert metadata[b"frame"]


def test_what_fails_half_way_leaves_what_was_there(
    short_run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write_run(short_run, tmp_path / "run", rerun=False)
    before = (folder / "trace.parquet").read_bytes()

    def full_disk(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(recording_module, "write_trace", full_disk)
    for place in (folder, tmp_path / "new"):
        with pytest.raises(HiltestbedError, match="No space"):
            write_run(short_run, place, rerun=False)
    assert list(tmp_path.iterdir()) == [folder]
    assert (folder / "trace.parquet").read_bytes() == before


def test_a_folder_with_other_things_in_it_is_refused_untouched(short_run, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="other things"):
        write_run(short_run, tmp_path, rerun=False)
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]


# a spring of 1e12 N/m that is late throws the bodies apart at some 1e6 m/s: the model leaves the
# room in the next tick
WILD = {"mechanism.contact.stiffness": 1e12} | {
    f"safety.{limit}": None for limit in ("stroke", "speed", "limb_angle_deg", "force", "torque")
}


def test_a_divergence_says_when_and_why_can_be_replayed_and_leaves_its_batch_alone(
    short_run, tmp_path: Path
) -> None:
    short = {"duration": 0.45, "rig.platform.tracking": "ideal"}
    wild = shipped("04-bumper-delay-compensated", short | WILD)
    failed, other = run_batch([wild, short_run.scenario], trace=True)
    assert failed.summary["status"] == "diverged"
    folder = write_run(failed, tmp_path / "failed", rerun=False)
    loop, (tick, _, reason) = replay_failure(folder)
    assert f"tick {tick}," in failed.summary["stop_reason"]
    assert reason in failed.summary["stop_reason"]
    np.testing.assert_array_equal(loop.drive.pose[0], failed.trace["pose_cmd"][-1])
    assert other.summary["status"] == "completed"
    assert other.trace["pose_cmd"].tobytes() == short_run.trace["pose_cmd"].tobytes()
    assert len(failed.trace.t) < len(other.trace.t)
