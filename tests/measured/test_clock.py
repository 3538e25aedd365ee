"""Time stamps and resampling: no tick is filled that the file says nothing of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hiltestbed import load_scenario
from hiltestbed.diagnosis.recorded import kink_errors
from hiltestbed.measured.clock import bend, check_clock, start_of_run, to_ticks, unrolled
from hiltestbed.measured.reading import read_record
from hiltestbed.measured.record import Record

TICK = 1e-3
AT = TICK * np.arange(1000, dtype=np.float64)


def _recorded(folder: Path, duration: float, **columns: np.ndarray) -> Record:
    """The record of a loop at 2 kHz from a file with these columns, ``__`` for the dot."""
    table = {name.replace("__", "."): values for name, values in columns.items()}
    pq.write_table(pa.table(table), folder / "run.parquet")
    scenario = load_scenario("reference-bumper", {"rate": 2000, "duration": duration})
    record, _ = read_record(0, folder / "run.parquet", {}, scenario)
    assert record is not None
    return record


def test_samples_on_the_ticks_are_taken_bit_by_bit() -> None:
    values = np.random.default_rng(1).standard_normal(100)
    out, valid = to_ticks(AT[:100], values, 100, TICK, TICK)
    np.testing.assert_array_equal(out, values)
    assert valid.all()


@pytest.mark.parametrize("rate", [730.0, 1000.0, 4321.0])
def test_a_straight_line_survives_any_rate_and_phase(rate: float) -> None:
    """Linear interpolation is exact on a line: what counts as measured lies on it to round-off."""
    t = 0.0004 + np.arange(round(rate)) / rate
    out, valid = to_ticks(t, 3.0 - 2.0 * t, 1000, TICK, 1 / rate)
    np.testing.assert_allclose(out[valid], (3.0 - 2.0 * AT)[valid], atol=1e-12)
    assert valid.mean() > min(1.0, rate * TICK) - 0.01
    assert np.isnan(out[~valid]).all()


def test_interpolation_error_is_of_second_order() -> None:
    """Between samples h apart a sine of frequency w is off by at most (w h)^2/8."""
    errors = []
    for rate in (1000.0, 2000.0):
        t = 0.3 / rate + np.arange(round(rate)) / rate
        out, valid = to_ticks(t, np.sin(20 * t), 1000, TICK, 1 / rate)
        errors.append(np.abs(out - np.sin(20 * AT))[valid].max())
    assert errors[0] < (20 * TICK) ** 2 / 8
    assert errors[0] / errors[1] > 3.0


@pytest.mark.parametrize("rate", [250.0, 640.0, 870.0])
def test_a_smooth_curve_through_the_samples_takes_off_what_straight_lines_miss(rate: float) -> None:
    """Away from the ends, of a sine: lines miss up to (w h)^2/8, a cubic spline less than 5/384 (w
    h)^4 (de Boor, 2001, chapter V).
    """
    w, h = 20.0, 1.0 / rate
    t = 0.3 * h + h * np.arange(round(rate), dtype=np.float64)
    straight, measured = to_ticks(t, np.sin(w * t), 1000, TICK, h)
    bent = bend(t, np.sin(w * t), straight, measured, TICK)
    assert bent is not None
    inside = (t[8] < AT) & (t[-9] > AT)
    missed = np.abs(np.interp(AT, t, np.sin(w * t)) - np.sin(w * AT))[inside].max()
    assert missed == pytest.approx((w * h) ** 2 / 8, rel=0.1)
    filled = np.interp(AT, AT[measured], straight[measured])
    assert np.abs(filled + bent - np.sin(w * AT))[inside].max() < 5.0 / 384.0 * (w * h) ** 4


def test_the_noise_of_samples_between_ticks_counts_as_much_as_that_of_ticks(tmp_path: Path) -> None:
    """Put between two rows, white noise w keeps 2/3 of its variance and all that it adds up to: the
    level that is judged by stays w.

    By less than a tenth: third differences see 6 % less of noise whose neighbours go along, and the
    means of 499 blocks spread by 3 %.
    """
    rng, sigma = np.random.default_rng(3), 2e-6
    t = np.arange(3399) / 1700.0
    noise = np.interp(t, np.arange(4000) / 2000.0, sigma * rng.standard_normal(4000))
    record = _recorded(tmp_path, 2.0, t=t, pose_act__pz=noise)
    np.testing.assert_allclose(record.sampled["pose_act.pz"], sigma, rtol=0.1)
    blocks = np.nanmean(record.column("pose_act.pz")[:3992].reshape(-1, 8), axis=1)
    np.testing.assert_allclose(blocks.std() * np.sqrt(8.0), sigma, rtol=0.1)


@pytest.mark.parametrize("rate", [500.0, 900.0, 1200.0, 1700.0, 2600.0])
@pytest.mark.parametrize("by_the_logger", [True, False])
def test_a_touch_between_two_rows_is_off_by_three_times_its_uncertainty_at_most(
    tmp_path: Path, rate: float, by_the_logger: bool
) -> None:
    """A ramp that begins anywhere in a tick, as a force does at a touch; rows interpolated by the
    logger, or sampled at their stamps.
    """
    loop, rng = np.arange(600) / 2000.0, np.random.default_rng(11)
    t = np.arange(int(loop[-1] * rate) + 1) / rate
    for _ in range(20):
        begin = rng.uniform(0.1, 0.2)
        force = 3e4 * np.maximum(loop - begin, 0.0)
        logged = np.interp(t, loop, force) if by_the_logger else 3e4 * np.maximum(t - begin, 0.0)
        record = _recorded(tmp_path, 0.3, t=t, wrench_meas__fz=logged)
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
    record = _recorded(tmp_path, 3.0, t=t, wrench_meas__fz=logged)
    assert np.mean(kink_errors(record, "wrench_meas")[:, 2] > 0.0) < 5 * 1e-3


@pytest.mark.parametrize("share", [0.003, 0.4])
def test_rows_that_are_ticks_bend_nowhere_though_some_are_lost(share: float) -> None:
    t = AT[np.random.default_rng(8).random(len(AT)) >= share]
    assert bend(t, np.sin(20.0 * t), *to_ticks(t, np.sin(20.0 * t), 1000, TICK, TICK), TICK) is None


def test_a_gap_and_what_lies_beyond_the_record_stay_empty() -> None:
    t = np.r_[AT[100:400], AT[500:900]]
    _, valid = to_ticks(t, t, 1000, TICK, TICK)
    assert np.flatnonzero(valid).tolist() == [*range(100, 400), *range(500, 900)]


def test_a_slow_record_counts_only_where_it_has_samples() -> None:
    _, valid = to_ticks(AT[::10], np.arange(100.0), 1000, TICK, 0.01)
    assert np.flatnonzero(valid).tolist() == list(range(0, 1000, 10))


def test_time_that_runs_backwards_is_an_error_with_its_row() -> None:
    clock, remarks = check_clock(0, np.r_[AT[:200], AT[150:450]], TICK, 1.0)
    assert clock is None
    assert remarks[-1].severity == "error"
    assert "from row 199 (0.199 s) to row 200 (0.15 s)" in remarks[-1].text


def test_a_few_repeated_stamps_are_a_stated_loss_and_many_an_error() -> None:
    t = AT[:500].copy()
    t[100] = t[99]
    clock, remarks = check_clock(0, t, TICK, 1.0)
    assert len(clock.t) == 499
    assert (np.diff(clock.t) > 0).all()
    assert [r.severity for r in remarks if "same stamp" in r.text] == ["loss"]
    many = check_clock(0, np.round(AT[:500], 2), TICK, 1.0)[1]
    assert [r.severity for r in many if "same stamp" in r.text] == ["error"]


@pytest.mark.parametrize("rate", [500.0, 1000.0, 2500.0])
@pytest.mark.parametrize(
    ("unit", "factor"),
    [("ms", 1e-3), ("us", 1e-6), ("min", 60.0), ("h", 3600.0), ("d", 86400.0)],
)
def test_stamps_in_another_unit_are_told_by_its_name_and_exact_factor(
    unit: str, factor: float, rate: float
) -> None:
    """Whatever the rate of the log: a power of ten near the factor would leave the forces wrong."""
    clock, remarks = check_clock(0, np.arange(600) / rate / factor, 1e-3, 0.6)
    assert clock is None
    assert f"{{t: {{unit: {unit}}}}}" in remarks[-1].fix
    assert f"{{scale: {factor:g}}}" in remarks[-1].fix


def test_time_scaled_twice_is_found_too() -> None:
    clock, remarks = check_clock(0, AT * 1e-3, TICK, 1.0)
    assert clock is None
    # seconds by a unit in the channel map, which counts before one that the file states
    assert "converted from ms on top, channels: {t: {unit: s}} without a scale" in remarks[-1].fix


@pytest.mark.parametrize(
    ("first", "shift", "said"),
    [(0.0, 0.0, []), (0.2, 0.0, ["loss"]), (1.7e9, 1.7e9, ["note"])],
)
def test_a_wall_clock_counts_from_its_first_row_and_a_late_record_is_not_moved(
    first: float, shift: float, said: list[str]
) -> None:
    found, remarks = start_of_run(0, first, TICK, 1.0)
    assert found == shift
    assert [remark.severity for remark in remarks] == said


def test_uneven_sampling_and_gaps_are_stated() -> None:
    t = AT + 1e-4 * np.random.default_rng(2).standard_normal(1000)
    assert any("unevenly" in r.text for r in check_clock(0, t, TICK, 1.0)[1])
    t = np.delete(AT, slice(300, 350))
    gap = next(r for r in check_clock(0, t, TICK, 1.0)[1] if "gap" in r.text)
    assert "about 50 samples" in gap.text


@pytest.mark.parametrize("rows", [0, 1])
def test_a_record_needs_two_rows(rows: int) -> None:
    clock, remarks = check_clock(0, np.zeros(rows), TICK, 1.0)
    assert clock is None
    assert remarks[0].severity == "error"


@pytest.mark.parametrize("period", [60.0, 3600.0, 86400.0, 2.0**32 * 1e-6])
def test_a_clock_that_starts_again_goes_on(period: float) -> None:
    t = period - 0.3 + np.arange(600) * 1e-3
    found, remarks = unrolled(0, np.asarray(t % period, dtype=np.float64))
    np.testing.assert_allclose(found, t, atol=1e-9 * period)
    assert f"from zero at {period:.9g} s" in remarks[0].text


def test_a_second_record_in_the_file_is_not_taken_for_one() -> None:
    t = np.arange(600) * 0.1  # of a minute, twice
    found, remarks = unrolled(0, np.r_[t, t])
    assert (np.diff(found) < 0).any()
    assert not remarks
