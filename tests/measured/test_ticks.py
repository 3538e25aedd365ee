"""Stamps that miss the loop's ticks, rows that a logger held, digits that were not written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hiltestbed import load_scenario
from hiltestbed.measured.clock import UsableRows, as_ticks
from hiltestbed.measured.noise import digits_of, last_digit
from hiltestbed.measured.reading import read_record
from hiltestbed.measured.values import without_held
from hiltestbed.signals import GROUPS

TICK, ROWS = 1e-3, 800
NOISE = 2e-6  # [m]


AT = TICK * np.arange(ROWS, dtype=np.float64)


def _motion(t: np.ndarray) -> np.ndarray:
    noise = NOISE * np.random.default_rng(1).standard_normal(len(t))
    return 0.05 * t + 0.002 * np.sin(20.0 * t) + noise


def _read(stamps: np.ndarray, motion: np.ndarray) -> UsableRows:
    clock = UsableRows(stamps, np.arange(len(stamps)), float(np.median(np.diff(stamps))))
    found, _ = as_ticks(0, [(clock, {"pose_act.pz": motion})], TICK)
    return found[id(clock)]


def _jitter(how: str) -> np.ndarray:
    """(rows,) departures of stamps from the ticks, in ticks."""
    out = 0.1 * np.clip(np.random.default_rng(2).standard_normal(ROWS), -2.0, 2.0)
    if how == "to either side":  # 0.2 and 1.8 ticks apart, as if one row were lost
        out = np.zeros(ROWS)
        out[[100, 101, 300, 301, 500, 501]] = [-0.4, 0.4, 0.4, -0.4, -0.4, 0.4]
    return out


@pytest.mark.parametrize("how", ["at random", "to either side"])
def test_stamps_that_jitter_about_ticks_are_ticks(how: str) -> None:
    np.testing.assert_allclose(_read(AT + _jitter(how) * TICK, _motion(AT)).t, AT, atol=1e-12)


def test_a_clock_that_runs_fast_and_lost_rows_leave_each_row_on_its_tick() -> None:
    at = np.delete(AT, [100, 101, 400])
    np.testing.assert_allclose(_read(at * (1.0 + 5e-4), _motion(at)).t, at, atol=1e-12)


def test_samples_that_were_taken_between_ticks_stay_there() -> None:
    """Uneven ones of a smooth motion, all of them later, and those at another rate."""
    stamps = AT + 0.2 * TICK * np.random.default_rng(3).uniform(-1.0, 1.0, ROWS)
    smooth = 0.3 * stamps + 1e-9 * np.random.default_rng(4).standard_normal(ROWS)
    np.testing.assert_array_equal(_read(stamps, smooth).t, stamps)
    for stamps in (AT + 0.3 * TICK, np.arange(ROWS) / 997.0):
        np.testing.assert_array_equal(_read(stamps, _motion(stamps)).t, stamps)


def test_rows_that_are_held_are_lost_and_a_force_at_rest_is_not() -> None:
    names = (f"wrench_meas.{a}" for a in ("fx", "fy", "fz", "tx"))
    force = {name: np.random.default_rng(5).standard_normal(ROWS) for name in names}
    for column in force.values():
        column[51:54] = column[50]
        column[600:700] = column[600]
    kept, remarks = without_held(0, force)
    lost = np.flatnonzero(np.isnan(kept["wrench_meas.fz"]))
    np.testing.assert_array_equal(lost, [51, 52, 53])
    assert len(remarks) == 1
    moving = np.repeat((0.3 * AT + AT**2)[:, None], 3, axis=1)
    moving[51:54] = moving[50]
    for step, lost in ((0.0, [51, 52, 53]), (1e-3, [])):  # what moves in steps is not held
        poses = np.round(moving / step) * step if step else moving
        kept, _ = without_held(0, dict(zip(GROUPS["pose_cmd"].columns, poses.T, strict=False)))
        np.testing.assert_array_equal(np.flatnonzero(np.isnan(kept["pose_cmd.pz"])), lost)
    plain, none = without_held(0, {n: np.zeros(ROWS) for n in force})
    assert not none
    assert not np.isnan(plain["wrench_meas.fz"]).any()


@pytest.mark.parametrize("count", [3, 5])
def test_significant_digits_are_counted(count: int) -> None:
    values = np.random.default_rng(6).standard_normal(500)
    assert digits_of(np.array([float(f"{v:.{count}g}") for v in values])) == count
    assert digits_of(values) is None
    assert last_digit(np.array([123.45]), 5)[0] == pytest.approx(0.01)


def test_a_command_of_four_digits_is_within_half_a_step_of_what_was_written_and_nearer_to_the_truth(
    tmp_path: Path,
) -> None:
    """It passes 0.1, where the last digit becomes ten times as coarse: neither step is that of all
    rows, and four digits are.
    """
    t, rng = 1e-3 * np.arange(1000, dtype=np.float64), np.random.default_rng(12)
    true = 0.090003 + 0.02 * t
    table = {f"pose_act.{part}": 1e-3 * rng.standard_normal(1000) for part in ("px", "py", "pz")}
    table["pose_cmd.px"] = true
    written = {name: [float(f"{v:.4g}") for v in column] for name, column in table.items()}
    pq.write_table(pa.table(written | {"t": t}), tmp_path / "run.parquet")
    scenario = load_scenario("reference-bumper", {"rate": 1000, "duration": 1.0})
    record, _ = read_record(0, tmp_path / "run.parquet", {}, scenario)
    assert record.digits["pose_cmd.px"] == 4
    step = np.where(true < 0.1, 1e-5, 1e-4)
    np.testing.assert_allclose(record.rounding("pose_cmd")[:, 0], step / np.sqrt(12.0))
    off = np.abs(record.filled("pose_cmd")[:, 0] - true)
    inside = slice(10, 990)  # the first and the last stretch have one neighbour
    assert (off <= 0.51 * step)[inside].all()
    as_written = np.linalg.norm((record.column("pose_cmd.px") - true)[inside])
    assert np.linalg.norm(off[inside]) < 0.4 * as_written
