"""Records with some channels only: nothing is found in a healthy rig, whatever is not on record,
and a hidden effect is still named.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import hiltestbed
from hiltestbed.diagnosis.layout import lay_out
from hiltestbed.diagnosis.links import LinkRun, WrenchLink
from hiltestbed.diagnosis.paths import best_path
from hiltestbed.diagnosis.yielding import told_pose
from hiltestbed.measured import load_dataset

from ..slow import SLOW, slow
from .recorded import dataset_of, only, with_noise

# a quarter of a tick of its rate is worth 2 N of 5700 N
DAMPED = ("06-two-eight-tonne-vehicles", {"duration": 1.2, "approach.gap": 0.02})
# what the loop finds of the contact is blended into the command slowly: within 2 ms, the default, it
# moves the drives between two rows, as no record shows
KNOWN = {"kind": "resynchronised", "delay": "known", "blending": 0.01}
SLIDE = ("05-off-centre", {"duration": 0.7, "compensation.force": KNOWN})
RINGING = ("13-ring-down", {"duration": 1.5})
DOCKING = ("09-docking", {})
MEASURED = ("pose_act", "wrench_meas")
AXIAL = ("pose_act.pz", "wrench_meas.fz")
NOT_REACHED = ("pose_cmd", "wrench_meas", "wrench_comp")
POSITIONS = tuple(
    f"{group}.{part}" for group in ("pose_act", "pose_cmd") for part in ("px", "py", "pz")
)
FORCES = tuple(
    f"{group}.{part}" for group in ("wrench_meas", "wrench_comp") for part in ("fx", "fy", "fz")
)
POSE_NOISE = 2e-6  # [m]
STIFFER, LATE = (
    {"kind": "contact.stiffness", "factor": 1.1},
    {"kind": "sensor.delay", "delay": 0.002},
)


def partial(
    folder: Path,
    rig: tuple[str, Mapping[str, Any]],
    kept: Sequence[str],
    effects: Sequence[Mapping[str, Any]] = (),
    noise: float = 0.0,
) -> Path:
    """The dataset file of two runs of a shipped scenario with ``effects``, at its speed and 1.5
    times that, of which the groups and columns ``kept`` were recorded; noise: of the measured
    position [m].
    """
    name, changes = rig
    nominal, rng = hiltestbed.load_scenario(name, changes), np.random.default_rng(7)

    def change(log: pa.Table) -> pa.Table:
        return with_noise(only(kept)(log), POSITIONS[:3] if noise else (), noise, rng)

    faster = {"approach.velocity": [1.5 * v for v in nominal.approach.velocity]}
    return dataset_of(folder, nominal, [{}, faster], effects, seed=100, change=change)


@pytest.mark.parametrize(
    ("rig", "kept", "noise"),
    [
        pytest.param(DAMPED, MEASURED, 0.0, id="damped, no rates", marks=SLOW),
        pytest.param(SLIDE, MEASURED, POSE_NOISE, id="slide, noisy pose", marks=SLOW),
        pytest.param(
            SLIDE, (*MEASURED, "pose_cmd"), POSE_NOISE, id="slide, commanded, noisy", marks=SLOW
        ),
        pytest.param(SLIDE, NOT_REACHED, 0.0, id="slide, not reached", marks=SLOW),
        pytest.param(SLIDE, AXIAL, 0.0, id="slide, one axis", marks=SLOW),
        pytest.param(SLIDE, (*POSITIONS, *FORCES), 0.0, id="slide, no attitude"),
        pytest.param(DOCKING, MEASURED, POSE_NOISE, id="docking, noisy pose", marks=SLOW),
        pytest.param(RINGING, NOT_REACHED, 0.0, id="ring-down, not reached", marks=SLOW),
    ],
)
def test_nothing_is_found_in_a_healthy_rig(
    tmp_path: Path, rig: tuple[str, dict[str, Any]], kept: Sequence[str], noise: float
) -> None:
    """A servo moves A within a tick as no record shows: c v differs, dry friction turns, axes that
    are not on record move.
    """
    found = hiltestbed.diagnose(partial(tmp_path, rig, kept, noise=noise))
    assert (found.verdict, found.causes) == ("inconclusive", ())


@SLOW
def test_a_late_sensor_is_not_taken_for_a_lag_where_the_path_yields_to_its_reading(
    tmp_path: Path,
) -> None:
    """Delay and lag of 2 ms differ by 0.03 N at 2 Hz; a path with the noise of the late reading is
    smoother behind a lag. Whether the loop or the record alone had it late is not on record.
    """
    found = hiltestbed.diagnose(partial(tmp_path, RINGING, NOT_REACHED, [LATE]))
    assert {"sensor.delay", "log.skew"} == {
        found.causes[0].effect,
        *found.causes[0].indistinguishable_from,
    }


@SLOW
def test_noise_on_axes_that_are_not_on_record_is_no_departure_of_the_drives(tmp_path: Path) -> None:
    """All is centred, so that only noise turns A; the legs follow each other, and nanometres across
    the axis show it.
    """
    found = hiltestbed.diagnose(
        partial(tmp_path, ("18-stewart", {"duration": 0.6}), (*POSITIONS, *FORCES))
    )
    assert (found.verdict, found.causes) == ("no_discrepancy", ())


def test_forces_without_torques_are_not_balanced_against_a_motion_that_torques_make(
    tmp_path: Path,
) -> None:
    """A latch holds A by torques: about ports a metre or two from the centres of mass they move it
    more than the forces do.
    """
    kept = partial(tmp_path, ("13-ring-down", {"duration": 0.5}), (*POSITIONS, *FORCES))
    assert "needs all axes of wrench_comp" in lay_out(load_dataset(kept)).missing["dynamics"]


def test_what_the_drives_yield_to_must_be_on_record_where_the_pose_is_not(tmp_path: Path) -> None:
    missing = lay_out(load_dataset(partial(tmp_path, SLIDE, ("pose_cmd", *FORCES)))).missing
    assert "needs pose_act, or all axes of wrench_meas" in missing["wrench"]


@pytest.mark.parametrize(
    ("effect", "kept"),
    [
        (STIFFER, MEASURED),
        slow(LATE, MEASURED),
        slow(STIFFER, NOT_REACHED),
        slow(LATE, NOT_REACHED),
    ],
)
def test_a_hidden_effect_is_named(
    tmp_path: Path, effect: dict[str, Any], kept: Sequence[str]
) -> None:
    """Where the pose that was reached is not on record, a late sensor also misleads about what the
    drives bore and when.
    """
    found = hiltestbed.diagnose(partial(tmp_path, SLIDE, kept, [effect]))
    assert (found.verdict, [c.effect for c in found.causes]) == ("named", [effect["kind"]])


@SLOW
def test_the_noise_of_the_force_is_not_in_the_path_that_yields_to_it(tmp_path: Path) -> None:
    """The noise of a force makes 6 nm of the drives, in path and reading alike: what filters it
    would explain the readings. Under the force of the believed contact, whose mount is softer than
    the drives, less than half is left. What acts in the last 5 ms is not on record.
    """
    rig = ("13-ring-down", {"duration": 1.0})
    for name in ("all", "some"):
        (tmp_path / name).mkdir()
    partial(tmp_path / "all", rig, (*MEASURED, "pose_cmd"))
    layout = lay_out(load_dataset(partial(tmp_path / "some", rig, NOT_REACHED)))
    assert layout.deflection is not None
    for i, (run, path, found) in enumerate(
        zip(layout.runs, best_path(layout, None).poses, layout.deflection, strict=True)
    ):
        reached = pq.read_table(tmp_path / "all" / f"run_{i}.parquet")["pose_act.pz"].to_numpy()
        errors = [
            np.std((z - reached)[400:-10])
            for z in (path[:, 2], told_pose(run)[:, 2] + found.away[:, 2])
        ]
        assert errors[0] < 0.5 * errors[1]


def test_what_needs_an_axis_that_is_not_on_record_is_not_judged(tmp_path: Path) -> None:
    missing = lay_out(load_dataset(partial(tmp_path, SLIDE, (*POSITIONS, *FORCES)))).missing
    assert "needs all axes of pose_act or pose_cmd" in missing["wrench"]
    assert "needs all axes of pose_cmd" in missing["platform"]
    assert "needs all axes of wrench_comp" in missing["dynamics"]
    assert "needs all axes of wrench_meas and pose_act and pose_cmd" in missing["compensation"]


def test_an_axis_that_a_rig_cannot_move_need_not_be_on_record(tmp_path: Path) -> None:
    """A floor of air bearings: a tracker sees x, z and the attitude."""
    parts = ("px", "pz", "qx", "qy", "qz", "qw")
    floor = ("22-air-bearing", {"duration": 1.0})
    for dropped in ((), ("px",)):
        kept = tuple(f"pose_act.{part}" for part in parts if part not in dropped)
        missing = lay_out(load_dataset(partial(tmp_path, floor, (*kept, "wrench_meas")))).missing
        assert ("wrench" in missing) == bool(dropped)


@SLOW
def test_a_compensation_that_hangs_on_the_measured_rate_is_not_judged_by_a_differentiated_one(
    tmp_path: Path,
) -> None:
    """It identifies c = 11 kN s/m: the two ways of taking the slope, a tick apart, lead it to
    forces that differ by more than a tenth.
    """
    rates = ("twist_act", "twist_cmd")
    groups = ("pose_act", "pose_cmd", "wrench_meas", "wrench_comp")
    assert (
        "needs twist_act"
        in lay_out(load_dataset(partial(tmp_path, DAMPED, groups))).missing["compensation"]
    )
    assert lay_out(load_dataset(partial(tmp_path, DAMPED, (*groups, *rates)))).missing == {}


def test_a_path_has_the_rates_that_are_on_record(tmp_path: Path) -> None:
    rig = ("05-off-centre", {"duration": 0.4, "approach.gap": 0.001, "compensation.force": KNOWN})
    layout = lay_out(load_dataset(partial(tmp_path, rig, (*MEASURED, "pose_cmd", "twist_act"))))
    path = best_path(layout, None)
    assert path.rates_measured
    assert path.rates is not None
    for poses, rates in zip(path.poses, path.rates, strict=True):
        slope = np.gradient(poses[:, :3], layout.scales.tick, axis=0)
        np.testing.assert_allclose(rates[:, :3], slope, atol=0.02 * np.abs(slope).max())


def test_a_compensation_that_does_nothing_may_copy_an_axis(tmp_path: Path) -> None:
    """It used to be refused as a copy, since a torque that is not on record is not a number."""
    rig = ("07-single-drive", {"duration": 0.4})
    load_dataset(partial(tmp_path, rig, (*POSITIONS, "wrench_meas.fz", "wrench_comp.fz")))


def test_a_latch_that_waits_for_slow_motion_may_close_a_row_later() -> None:
    """Its springs hold the force k x + c v at which it closed, and k x on from there, whenever that
    is: a row later changes c v alone.
    """
    scenario = hiltestbed.load_scenario(
        "09-docking",
        {
            "approach.offset": [0, 0],
            "approach.attitude_deg": [0, 0, 0],
            "mechanism.contact.friction": 0,
        },
    )
    latch, h = scenario.mechanism.latch, scenario.tick
    t = np.arange(400) * h
    speed = 1.5 * latch.speed * np.exp(-t / 0.1)
    path = np.zeros((len(t), 7))
    path[:, 2], path[:, 6] = 1e-4 + np.cumsum(speed) * h, 1.0
    rates = np.zeros((len(t), 6))
    rates[:, 2] = speed
    run = LinkRun(scenario, np.zeros((len(t), 6)), np.ones((len(t), 6)), path[:, 2] > 0.0)
    nuisances = WrenchLink([run], [path], None, [rates]).with_unknown_rate().runs[0].nuisances
    closed = int(np.argmax(speed <= latch.speed))
    shown = closed + 2 + round(scenario.sensor.delay / h)
    assert nuisances[shown:, 2, 1] == pytest.approx(
        scenario.mechanism.contact.damping * (speed[closed + 1] - speed[closed]), rel=1e-3
    )
