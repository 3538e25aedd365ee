"""Time stamps and resampling: no tick is filled that the file says nothing of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hiltestbed import load_scenario
from hiltestbed.diagnosis.bridged import kink_errors
from hiltestbed.measured.clock import check_clock, start_of_run
from hiltestbed.measured.reading import read_record
from hiltestbed.measured.ticks import bend, to_ticks

TICK = 1e-3


def _severities(t: np.ndarray, duration: float = 1.0) -> list[str]:
    return [remark.severity for remark in check_clock(0, t, TICK, duration)[1]]


def test_samples_on_the_ticks_are_taken_bit_by_bit() -> None:
    values = np.random.default_rng(1).standard_normal(100)
    out, valid = to_ticks(TICK * np.arange(100, dtype=np.float64), values, 100, TICK, TICK)
    np.testing.assert_array_equal(out, values)
    assert valid.all()


@pytest.mark.parametrize("rate", [730.0, 1000.0, 4321.0])
def test_a_straight_line_survives_any_rate_and_phase(rate: float) -> None:
    """Linear interpolation is exact on a line: what counts as measured lies on it to round-off."""
    t = 0.0004 + np.arange(round(rate)) / rate
    out, valid = to_ticks(t, 3.0 - 2.0 * t, 1000, TICK, 1 / rate)
    at = TICK * np.arange(1000, dtype=np.float64)
    np.testing.assert_allclose(out[valid], (3.0 - 2.0 * at)[valid], atol=1e-12)
    assert valid.mean() > min(1.0, rate * TICK) - 0.01
    assert np.isnan(out[~valid]).all()


def test_interpolation_error_is_of_second_order() -> None:
    """Between samples h apart a sine of frequency w is off by at most (w h)^2/8."""
    errors = []
    for rate in (1000.0, 2000.0):
        t = 0.3 / rate + np.arange(round(rate)) / rate
        out, valid = to_ticks(t, np.sin(20 * t), 1000, TICK, 1 / rate)
        errors.append(
            np.abs(out - np.sin(20 * TICK * np.arange(1000, dtype=np.float64)))[valid].max()
        )
    assert errors[0] < (20 * TICK) ** 2 / 8
    assert errors[0] / errors[1] > 3.0


@pytest.mark.parametrize("rate", [250.0, 640.0, 870.0])
def test_a_smooth_curve_through_the_samples_takes_off_what_straight_lines_miss(rate: float) -> None:
    """Away from the ends, of a sine: lines miss up to (w h)^2/8, a cubic spline less than 5/384 (w
    h)^4 (de Boor, 2001, chapter V).
    """
    w, h = 20.0, 1.0 / rate
    t = 0.3 * h + h * np.arange(round(rate), dtype=np.float64)
    at = TICK * np.arange(1000, dtype=np.float64)
    straight, measured = to_ticks(t, np.sin(w * t), 1000, TICK, h)
    bent = bend(t, np.sin(w * t), straight, measured, TICK)
    assert bent is not None
    inside = (at > t[8]) & (at < t[-9])
    missed = np.abs(np.interp(at, t, np.sin(w * t)) - np.sin(w * at))[inside].max()
    assert missed == pytest.approx((w * h) ** 2 / 8, rel=0.1)
    filled = np.interp(at, at[measured], straight[measured])
    assert np.abs(filled + bent - np.sin(w * at))[inside].max() < 5.0 / 384.0 * (w * h) ** 4


def test_the_noise_of_samples_between_ticks_counts_as_much_as_that_of_ticks(tmp_path: Path) -> None:
    """Put between two rows, white noise w keeps 2/3 of its variance and all that it adds up to: the
    level that is judged by stays w.

    By less than a tenth: third differences see 6 % less of noise whose neighbours go along, and the
        means of 499 blocks spread by 3 %.
    """
    rng, sigma, tick = np.random.default_rng(3), 2e-6, 1.0 / 2000.0
    loop = np.arange(4000) * tick
    t = np.arange(3399) / 1700.0
    table = pa.table({"t": t, "pose_act.pz": np.interp(t, loop, sigma * rng.standard_normal(4000))})
    pq.write_table(table, tmp_path / "run.parquet")
    scenario = load_scenario("reference-bumper", {"rate": 2000, "duration": 2.0})
    record, _ = read_record(0, tmp_path / "run.parquet", {}, scenario)
    assert record is not None
    np.testing.assert_allclose(record.sampled["pose_act.pz"], sigma, rtol=0.1)
    blocks = np.nanmean(record.column("pose_act.pz")[:3992].reshape(-1, 8), axis=1)
    white = blocks.std() * np.sqrt(8.0)
    np.testing.assert_allclose(white, sigma, rtol=0.1)


@pytest.mark.parametrize("rate", [500.0, 900.0, 1200.0, 1700.0, 2600.0])
@pytest.mark.parametrize("by_the_logger", [True, False])
def test_a_touch_between_two_rows_is_off_by_three_times_its_uncertainty_at_most(
    tmp_path: Path, rate: float, by_the_logger: bool
) -> None:
    """A ramp that begins anywhere in a tick, as a force does at a touch; rows interpolated by the
    logger, or sampled at their stamps.
    """
    loop, rng = np.arange(600) / 2000.0, np.random.default_rng(11)
    scenario = load_scenario("reference-bumper", {"rate": 2000, "duration": 0.3})
    t = np.arange(int(loop[-1] * rate) + 1) / rate
    for _ in range(20):
        begin = rng.uniform(0.1, 0.2)
        force = 3e4 * np.maximum(loop - begin, 0.0)
        logged = np.interp(t, loop, force) if by_the_logger else 3e4 * np.maximum(t - begin, 0.0)
        pq.write_table(pa.table({"t": t, "wrench_meas.fz": logged}), tmp_path / "run.parquet")
        record, _ = read_record(0, tmp_path / "run.parquet", {}, scenario)
        assert record is not None
        error = np.nan_to_num(record.column("wrench_meas.fz") - force[: record.ticks])
        allowed = kink_errors(record, "wrench_meas")[:, 2]
        assert (np.abs(error) <= 3.0 * allowed + 1e-6).all()


@pytest.mark.parametrize("rate", [500.0, 900.0, 1200.0, 1700.0])
def test_noise_of_a_log_at_another_rate_is_no_kink(tmp_path: Path, rate: float) -> None:
    """At most 3e-4 of the rows exceed the ratio, each with five ticks around it, and three times as
    many by chance in one record. Ticks without a row, a seventh at 1700 Hz, are no kinks.
    """
    loop, rng = np.arange(6000) / 2000.0, np.random.default_rng(5)
    t = np.arange(int(loop[-1] * rate) + 1) / rate
    logged = np.interp(t, loop, rng.standard_normal(6000))
    pq.write_table(pa.table({"t": t, "wrench_meas.fz": logged}), tmp_path / "run.parquet")
    record, _ = read_record(
        0,
        tmp_path / "run.parquet",
        {},
        load_scenario("reference-bumper", {"rate": 2000, "duration": 3.0}),
    )
    assert record is not None
    assert np.mean(kink_errors(record, "wrench_meas")[:, 2] > 0.0) < 5 * 1e-3


def test_rows_that_are_ticks_bend_nowhere_though_some_are_lost() -> None:
    t = np.delete(TICK * np.arange(1000, dtype=np.float64), [100, 101, 500])
    assert bend(t, np.sin(20.0 * t), *to_ticks(t, np.sin(20.0 * t), 1000, TICK, TICK), TICK) is None


def test_a_gap_and_what_lies_beyond_the_record_stay_empty() -> None:
    t = TICK * np.arange(100, 900, dtype=np.float64)
    keep = (t < 0.4) | (t >= 0.5)
    _, valid = to_ticks(t[keep], t[keep], 1000, TICK, TICK)
    assert not valid[:100].any()
    assert not valid[400:500].any()
    assert not valid[900:].any()
    assert valid.sum() == 700


def test_a_slow_record_counts_only_where_it_has_samples() -> None:
    _, valid = to_ticks(0.01 * np.arange(100, dtype=np.float64), np.arange(100.0), 1000, TICK, 0.01)
    assert valid.sum() == 100
    assert valid[::10].all()


def test_time_that_runs_backwards_is_an_error_with_its_row() -> None:
    t = TICK * np.arange(500, dtype=np.float64)
    t[200:] -= 0.05
    clock, remarks = check_clock(0, t, TICK, 1.0)
    assert clock is None
    assert remarks[-1].severity == "error"
    assert "row 199" in remarks[-1].text
    assert "row 200" in remarks[-1].text


def test_a_few_repeated_stamps_are_a_stated_loss_and_many_an_error() -> None:
    t = TICK * np.arange(500, dtype=np.float64)
    t[100] = t[99]
    clock, remarks = check_clock(0, t, TICK, 1.0)
    assert clock is not None
    assert len(clock.t) == 499
    assert (np.diff(clock.t) > 0).all()
    assert [r.severity for r in remarks if "same stamp" in r.text] == ["loss"]
    assert "error" in _severities(np.round(TICK * np.arange(500, dtype=np.float64), 2))


@pytest.mark.parametrize("scale", [1e3, 1e6])
def test_time_in_another_unit_is_an_error_that_names_the_scale(scale: float) -> None:
    clock, remarks = check_clock(0, TICK * np.arange(1000, dtype=np.float64) * scale, TICK, 1.0)
    assert clock is None
    assert f"{{scale: {1 / scale:g}}}" in remarks[-1].fix


def test_time_scaled_twice_is_found_too() -> None:
    clock, remarks = check_clock(0, TICK * np.arange(1000, dtype=np.float64) * 1e-3, TICK, 1.0)
    assert clock is None
    # seconds by a unit in the channel map, which counts before one that the file states
    assert "converted from ms on top, channels: {t: {unit: s}} without a scale" in remarks[-1].fix


def test_a_wall_clock_counts_from_its_first_row_and_says_so() -> None:
    shift, remarks = start_of_run(0, 1.7e9, TICK, 1.0)
    assert shift == 1.7e9
    assert remarks[0].severity == "note"
    assert start_of_run(0, 0.0, TICK, 1.0) == (0.0, [])


def test_a_late_record_is_not_moved() -> None:
    shift, remarks = start_of_run(0, 0.2, TICK, 1.0)
    assert shift == 0.0
    assert remarks[0].severity == "loss"


def test_uneven_sampling_and_gaps_are_stated() -> None:
    t = TICK * np.arange(1000, dtype=np.float64)
    t += 1e-4 * np.random.default_rng(2).standard_normal(1000)
    assert any("unevenly" in r.text for r in check_clock(0, t, TICK, 1.0)[1])
    t = np.delete(TICK * np.arange(1000, dtype=np.float64), slice(300, 350))
    gap = next(r for r in check_clock(0, t, TICK, 1.0)[1] if "gap" in r.text)
    assert gap.evidence["missing"] == pytest.approx(50)


@pytest.mark.parametrize("rows", [0, 1])
def test_a_record_needs_two_rows(rows: int) -> None:
    clock, remarks = check_clock(0, np.zeros(rows), TICK, 1.0)
    assert clock is None
    assert remarks[0].severity == "error"
