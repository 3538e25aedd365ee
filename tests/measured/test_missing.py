"""Values that stand for a missing sample are recognised, readings are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hiltestbed.measured import examine
from hiltestbed.measured.values import outliers

from . import bounce

T = np.arange(1200) / 2000.0
NOISE = 0.3 * np.random.default_rng(2).standard_normal(len(T))
# [N] a half sine of 0.2 s, as of a spring
FORCE = np.where((T > 0.1) & (T < 0.3), 190.0 * np.sin(np.pi * (T - 0.1) / 0.2), 0.0)


def with_value(rows: int | list[int], value: float, digits: int = 9) -> np.ndarray:
    out = np.round(FORCE + NOISE, digits)
    out[rows] = value
    return out


ROWS = [600], [600, 601], [0], [400], [5, 300, 1199], list(range(700, 800))


@pytest.mark.parametrize("value", [-9999.0, -999.25, 1e30, 9.969209968386869e36, -32768.0, 1e20])
@pytest.mark.parametrize("rows", ROWS)
def test_a_value_that_no_sensor_reads_is_found_wherever_it_is(
    value: float, rows: list[int]
) -> None:
    (found,) = outliers(with_value(rows, value))
    assert found.code
    assert found.value == value
    assert np.flatnonzero(found.rows).tolist() == rows


@pytest.mark.parametrize(("digits", "rows"), [(9, [400]), (2, [400]), (2, [350, 420, 421])])
def test_a_zero_among_large_forces_is_missing_and_among_small_ones_a_reading(
    digits: int, rows: list[int]
) -> None:
    (found,) = outliers(with_value([*rows, 900], 0.0, digits))
    assert found.code
    assert np.flatnonzero(found.rows).tolist() == rows


def test_a_spike_with_digits_of_its_own_may_have_been_measured() -> None:
    (found,) = outliers(with_value(700, 812.31745293))
    assert not found.code


def _dead_zone(x: np.ndarray) -> np.ndarray:
    return np.where(np.abs(x) > 20.0, x, 0.0)


RING = 400.0 * np.sin(2 * np.pi * 12.0 * T) * np.exp(-2.0 * T)
HEALTHY = {
    "noise with heavy tails": FORCE + np.random.default_rng(4).standard_t(3, len(T)),
    "a contact": FORCE + NOISE,
    "a contact without noise": FORCE,
    "a ring-down in a dead zone": _dead_zone(RING),
    "a noisy ring-down in a dead zone": _dead_zone(RING + NOISE),
    "steps of a converter": 2.0 * np.round((FORCE + NOISE) / 2.0),
    "a converter at rest": 0.1 * np.round(NOISE / 0.5),
    "clipped": np.minimum(FORCE + NOISE, 150.0),
    "separation for three rows": np.maximum(60.0 * np.sin(2 * np.pi * 300.0 * T) + 58.0, 0.0),
    "a command in steps": np.repeat(np.arange(12.0), 100),
    "a command that begins": np.where(T > 0.1, 0.02, 0.0),
    "a command held for uneven times": np.round(
        2e-3 * np.sin(300.0 * np.sort(np.random.default_rng(1).choice(T, len(T)))), 6
    ),
    "rows that are held": np.repeat((FORCE + NOISE)[::4], 4),
}


@pytest.mark.parametrize("what", HEALTHY)
def test_readings_are_no_missing_samples(what: str) -> None:
    assert not [found for found in outliers(HEALTHY[what]) if found.code]


def test_what_is_taken_for_missing_is_said_with_the_key_that_keeps_it(tmp_path: Path) -> None:
    """One remark names value, rows, run and channel; the dataset may declare a value, or keep all
    of them.
    """
    table = bounce.columns()
    table["wrench_meas.fz"][[400, 401]] = -9999.0
    path = bounce.write_dataset(tmp_path, bounce.columns(), table)
    text = path.read_text()
    said = [str(r) for r in examine(path).remarks if "taken as missing" in r.text]
    assert len(said) == 1
    assert "run_1.parquet: wrench_meas.fz: is -9999 in 2 of 600 rows" in said[0]
    assert "{missing: [-9999]}" in said[0]
    missing = {}
    for key in ("", "missing: [-9999]\n", "channels: {wrench_meas.fz: {missing: []}}\n"):
        path.write_text(text + key)
        column = examine(path).runs[1].record.column("wrench_meas.fz")
        missing[key] = np.flatnonzero(np.isnan(column)).tolist()
    assert list(missing.values()) == [[400, 401], [400, 401], []]
