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
from hiltestbed.diagnosis.find import find
from hiltestbed.diagnosis.investigate import investigate
from hiltestbed.diagnosis.layout import lay_out
from hiltestbed.diagnosis.yielding import deflection
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredDataset, MeasuredRun, load_dataset
from tests.slow import SLOW

from .recorded import dataset_of

SCENARIO = "reference-bumper"
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
    changes = {"rig.platform": platform, "compensation.motion": {"kind": "none"}}
    believed = load_scenario(SCENARIO, set=changes if platform else {})
    sets = [{"approach.velocity": [0.0, 0.0, v], "duration": 0.9} for v in speeds]
    noise = {"sensor.noise": NOISE, "sensor.torque_noise": 0.02}
    return load_dataset(dataset_of(folder, believed, sets, effects, unknown=noise))


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> MeasuredDataset:
    return driven(tmp_path_factory.mktemp("healthy"))


def yielded(measured: MeasuredRun) -> tuple[Array, Array, Array]:
    """Along z, where they are known [m]: what the pose differs by from what was told, what of it is
    replayed, and the doubt of that.
    """
    found = deflection(measured, NOISE)
    assert found is not None
    record, known = measured.record, np.isfinite(found.doubt[:, 2])
    told = np.concatenate([record.filled("pose_act")[:1], record.filled("pose_cmd")[:-1]])
    left = record.filled("pose_act") - told
    return left[known, 2], found.away[known, 2], found.doubt[known, 2]


def test_where_the_drives_yield_to_is_known_to_their_doubt(healthy: MeasuredDataset) -> None:
    """Told the recorded command under the recorded force, 5 ms late and with its noise: 0.2 N on
    4e7 N/m is what is not told.
    """
    left, away, doubt = yielded(healthy.runs[-1])
    assert np.abs(left).max() > 4e-6
    assert np.abs(left - away).max() < 0.01 * np.abs(left).max()
    assert (np.abs(left - away) <= doubt).mean() > 0.99


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
    assert ends[0] <= hidden["width"] <= ends[1]


def test_where_the_drives_yield_to_is_known_to_their_doubt_when_the_sensor_is_later_than_believed(
    tmp_path: Path,
) -> None:
    """At the touch, where the reading does not show the force yet that bends the rig already: 3 ms
    of a rise by k v.
    """
    late = driven(tmp_path, ({"kind": "sensor.delay", "delay": 0.003},), SPEEDS[-1:])
    left, away, doubt = yielded(late.runs[0])
    assert (np.abs(left - away) > 2e-8).any()
    assert (np.abs(left - away) <= doubt + 1e-9).all()


def test_what_a_platform_makes_of_its_command_is_known_whatever_the_force_reads(
    tmp_path: Path,
) -> None:
    """By a response of its own it lags by mm, which no force has a part in: no explanation of the
    platform is good for that alone.
    """
    _, away, doubt = yielded(driven(tmp_path, (), SPEEDS[-1:], RESPONDING).runs[0])
    assert np.abs(away).max() > 1e-4
    assert doubt.max() < 1e-7


@SLOW
def test_beside_a_platform_that_lags_as_believed_a_late_sensor_is_found(tmp_path: Path) -> None:
    hidden = {"kind": "sensor.delay", "delay": 0.002}
    finding = find(investigate(driven(tmp_path, (hidden,), SPEEDS[1:], RESPONDING)))
    assert [c.effect for c in finding.causes] == [hidden["kind"]]
    ends = finding.causes[0].parameters["delay"].ci95
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
