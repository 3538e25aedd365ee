"""A platform under its own servo is no departure: what the drives yield to the force is replayed,
not named.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hiltestbed import load_scenario
from hiltestbed.config.yaml_source import dump_yaml
from hiltestbed.diagnosis.find import find
from hiltestbed.diagnosis.investigate import investigate
from hiltestbed.diagnosis.layout import lay_out
from hiltestbed.diagnosis.links import flat_pose
from hiltestbed.diagnosis.yielding import deflection
from hiltestbed.measured import MeasuredDataset, load_dataset
from hiltestbed.run_folder.store import write_trace
from tests.running import run
from tests.slow import SLOW

SCENARIO = Path(__file__).parents[2] / "scenarios" / "reference-bumper.yaml"
NOISE = 0.2  # [N]
SPEEDS = (0.02, 0.04, 0.06)


RESPONDING = {
    "kind": "pss33",
    "tracking": "response",
    "response": {"order": 2, "bandwidth": 40.0, "damping_ratio": 0.8},
}


def driven(
    folder: Path,
    effects: tuple[dict[str, Any], ...] = (),
    speeds: tuple[float, ...] = SPEEDS,
    platform: dict[str, Any] | None = None,
) -> MeasuredDataset:
    """Runs of the reference bumper under its servo, with noise in the sensor, and with `effects`
    that are not believed.

    platform: in place of the servo, believed.
    """
    believed = load_scenario(
        SCENARIO,
        set={"rig.platform": platform, "compensation.motion": {"kind": "none"}} if platform else {},
    )
    (folder / "nominal.yaml").write_text(
        dump_yaml(believed.model_dump(mode="json")), encoding="utf-8"
    )
    entries = []
    for seed, speed in enumerate(speeds):
        approach = {"approach.velocity": [0.0, 0.0, speed], "duration": 0.9}
        given = approach | {
            "sensor.noise": NOISE,
            "sensor.torque_noise": 0.02,
            "seed": seed,
            "effects": list(effects),
        }
        trace = run(load_scenario(folder / "nominal.yaml", set=given)).trace
        assert trace is not None
        write_trace(trace, folder / f"run_{seed}.parquet")
        entries.append(
            f"  - {{file: run_{seed}.parquet, set: {{approach.velocity: [0, 0, {speed}], "
            f"duration: 0.9}}}}"
        )
    (folder / "dataset.yaml").write_text(
        "\n".join(["scenario: nominal.yaml", "runs:", *entries, ""]), encoding="utf-8"
    )
    return load_dataset(folder / "dataset.yaml")


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> MeasuredDataset:
    return driven(tmp_path_factory.mktemp("healthy"))


def test_where_the_drives_yield_to_is_known_to_their_doubt(healthy: MeasuredDataset) -> None:
    """Told the recorded command under the recorded force, 5 ms late and with its noise: 0.2 N on
    4e7 N/m is what is not told.
    """
    measured = healthy.runs[-1]
    found = deflection(measured, NOISE)
    assert found is not None
    told = np.concatenate(
        [measured.record.filled("pose_act")[:1], measured.record.filled("pose_cmd")[:-1]]
    )
    left = measured.record.filled("pose_act") - told
    known = np.isfinite(found.doubt[:, 2])
    assert np.abs(left[known, 2]).max() > 4e-6
    assert np.abs(left[known, 2] - found.away[known, 2]).max() < 0.01 * np.abs(left[known, 2]).max()
    off = np.abs(flat_pose(left)[known] - found.away[known])[:, 2]
    assert (off <= found.doubt[known, 2]).mean() > 0.99


@SLOW
def test_of_a_driven_platform_nothing_is_named_where_nothing_is_hidden(
    healthy: MeasuredDataset,
) -> None:
    finding = find(investigate(healthy))
    assert finding.verdict == "no_discrepancy"
    assert finding.causes == ()


@SLOW
def test_of_a_driven_platform_only_what_is_hidden_is_named(tmp_path: Path) -> None:
    hidden = {"kind": "platform.backlash", "width": 1e-4}
    finding = find(investigate(driven(tmp_path, (hidden,), SPEEDS[1:])))
    assert finding.verdict == "named"
    assert [c.effect for c in finding.causes] == [hidden["kind"]]
    ends = finding.causes[0].parameters["width"].ci95
    assert ends is not None
    assert ends[0] <= hidden["width"] <= ends[1]


def test_where_the_drives_yield_to_is_known_to_their_doubt_when_the_sensor_is_later_than_believed(
    tmp_path: Path,
) -> None:
    """At the touch, where the reading does not show the force yet that bends the rig already: 3 ms
    of a rise by k v.
    """
    late = driven(tmp_path, ({"kind": "sensor.delay", "delay": 0.003},), SPEEDS[-1:])
    for measured in late.runs:
        found = deflection(measured, NOISE)
        assert found is not None
        told = np.concatenate(
            [measured.record.filled("pose_act")[:1], measured.record.filled("pose_cmd")[:-1]]
        )
        known = np.isfinite(found.doubt[:, 2])
        off = np.abs(
            flat_pose(measured.record.filled("pose_act") - told)[known, 2] - found.away[known, 2]
        )
        assert (off > 2e-8).any()
        assert (off <= found.doubt[known, 2] + 1e-9).all()


def test_what_a_platform_makes_of_its_command_is_known_whatever_the_force_reads(
    tmp_path: Path,
) -> None:
    """By a response of its own it lags by mm, which no force has a part in: no explanation of the
    platform is good for that alone.
    """
    lagging = driven(tmp_path, (), SPEEDS[-1:], RESPONDING)
    found = deflection(lagging.runs[0], NOISE)
    assert found is not None
    known = np.isfinite(found.doubt[:, 2])
    assert np.abs(found.away[known, 2]).max() > 1e-4
    assert found.doubt[known, 2].max() < 1e-7


@SLOW
def test_beside_a_platform_that_lags_as_believed_a_late_sensor_is_found(tmp_path: Path) -> None:
    hidden = {"kind": "sensor.delay", "delay": 0.002}
    finding = find(investigate(driven(tmp_path, (hidden,), SPEEDS[1:], RESPONDING)))
    assert [c.effect for c in finding.causes] == [hidden["kind"]]
    ends = finding.causes[0].parameters["delay"].ci95
    assert ends is not None
    assert ends[0] <= hidden["delay"] <= ends[1]


def test_a_command_that_the_drives_cannot_follow_is_not_taken_for_their_yield(
    healthy: MeasuredDataset,
) -> None:
    first = healthy.runs[0]
    record = first.record
    jumped = record.data["pose_cmd"].copy()
    jumped[len(jumped) // 2 :, 2] = 1e6  # [m]
    moved = replace(first, record=replace(record, data=dict(record.data) | {"pose_cmd": jumped}))
    assert deflection(moved, NOISE) is None
    layout = lay_out(replace(healthy, runs=(moved, *healthy.runs[1:])))
    assert layout.deflection is None
    assert "cannot follow" in layout.missing["platform"]
