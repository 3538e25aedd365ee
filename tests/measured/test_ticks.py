"""Stamps that miss the loop's ticks, rows that a logger held, digits that were not written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hiltestbed import load_scenario
from hiltestbed.measured.clock import Clock
from hiltestbed.measured.noise import digits_of, last_digit
from hiltestbed.measured.reading import read_record
from hiltestbed.measured.ticks import as_ticks
from hiltestbed.measured.values import without_held

TICK, ROWS = 1e-3, 800
NOISE = 2e-6  # [m]


def _motion(t: np.ndarray, seed: int = 1) -> np.ndarray:
    return (
        0.05 * t
        + 0.002 * np.sin(20.0 * t)
        + NOISE * np.random.default_rng(seed).standard_normal(len(t))
    )


def _read(stamps: np.ndarray, motion: np.ndarray) -> Clock:
    clock = Clock(stamps, np.arange(len(stamps)), float(np.median(np.diff(stamps))))
    found, _ = as_ticks(0, [(clock, {"pose_act.pz": motion})], TICK)
    return found[id(clock)]


def test_stamps_that_jitter_about_ticks_are_ticks() -> None:
    at = np.arange(ROWS) * TICK
    stamps = at + 0.1 * TICK * np.clip(np.random.default_rng(2).standard_normal(ROWS), -2.0, 2.0)
    np.testing.assert_allclose(_read(stamps, _motion(at)).t, at, atol=1e-12)


def test_neighbours_that_jitter_to_either_side_stay_on_their_ticks() -> None:
    """0.4 of a tick to either side: their stamps are 0.2 and 1.8 ticks apart, as if one row were
    lost.
    """
    at = np.arange(ROWS) * TICK
    off = np.zeros(ROWS)
    off[[100, 101, 300, 301, 500, 501]] = [-0.4, 0.4, 0.4, -0.4, -0.4, 0.4]
    np.testing.assert_allclose(_read(at + off * TICK, _motion(at)).t, at, atol=1e-12)


def test_a_clock_that_runs_fast_and_lost_rows_leave_each_row_on_its_tick() -> None:
    at = np.delete(np.arange(ROWS), [100, 101, 400]) * TICK
    np.testing.assert_allclose(_read(at * (1.0 + 5e-4), _motion(at)).t, at, atol=1e-12)


def test_samples_that_were_taken_between_ticks_stay_there() -> None:
    stamps = np.arange(ROWS) * TICK + 0.2 * TICK * np.random.default_rng(3).uniform(-1.0, 1.0, ROWS)
    smooth = 0.3 * stamps + 1e-9 * np.random.default_rng(4).standard_normal(ROWS)
    np.testing.assert_array_equal(_read(stamps, smooth).t, stamps)
    later = np.arange(ROWS) * TICK + 0.3 * TICK
    np.testing.assert_array_equal(_read(later, _motion(later)).t, later)


def test_a_log_at_another_rate_is_left_as_it_is() -> None:
    stamps = np.arange(ROWS) / 997.0
    np.testing.assert_array_equal(_read(stamps, _motion(stamps)).t, stamps)


def test_rows_that_are_held_are_lost_and_a_force_at_rest_is_not() -> None:
    force = {
        f"wrench_meas.{a}": np.random.default_rng(5).standard_normal(ROWS)
        for a in ("fx", "fy", "fz", "tx")
    }
    for column in force.values():
        column[51:54] = column[50]
        column[600:700] = column[600]
    kept, remarks = without_held(0, force)
    lost = np.flatnonzero(np.isnan(kept["wrench_meas.fz"]))
    np.testing.assert_array_equal(lost, [51, 52, 53])
    assert len(remarks) == 1
    plain, none = without_held(0, {n: np.zeros(ROWS) for n in force})
    assert not none
    assert not np.isnan(plain["wrench_meas.fz"]).any()


@pytest.mark.parametrize("count", [3, 5])
def test_significant_digits_are_counted(count: int) -> None:
    values = np.array(
        [float(f"{v:.{count}g}") for v in np.random.default_rng(6).standard_normal(500)]
    )
    assert digits_of(values) == count
    assert digits_of(np.random.default_rng(7).standard_normal(500)) is None
    assert last_digit(np.array([123.45]), 5)[0] == pytest.approx(0.01)


def test_a_command_of_four_digits_is_within_half_a_step_of_what_was_written_and_nearer_to_the_truth(
    tmp_path: Path,
) -> None:
    """It passes 0.1, where the last digit becomes ten times as coarse: neither step is that of all
    rows, and four digits are.
    """
    t, rng = np.arange(1000) * 1e-3, np.random.default_rng(12)
    true = 0.090003 + 0.02 * t
    table = {"t": t, "pose_cmd.px": true} | {
        f"pose_act.{part}": 1e-3 * rng.standard_normal(1000) for part in ("px", "py", "pz")
    }
    written = {
        name: [float(f"{v:.4g}") if name != "t" else v for v in column]
        for name, column in table.items()
    }
    pq.write_table(pa.table(written), tmp_path / "run.parquet")
    record, _ = read_record(
        0,
        tmp_path / "run.parquet",
        {},
        load_scenario("reference-bumper", {"rate": 1000, "duration": 1.0}),
    )
    assert record is not None
    assert record.digits["pose_cmd.px"] == 4
    step = np.where(true < 0.1, 1e-5, 1e-4)
    np.testing.assert_allclose(record.rounding("pose_cmd")[:, 0], step / np.sqrt(12.0))
    off = np.abs(record.filled("pose_cmd")[:, 0] - true)
    inside = slice(10, 990)  # the first and the last stretch have one neighbour
    assert (off <= 0.51 * step)[inside].all()
    assert np.sqrt(np.mean(off[inside] ** 2)) < 0.4 * np.sqrt(
        np.mean((record.column("pose_cmd.px") - true)[inside] ** 2)
    )
