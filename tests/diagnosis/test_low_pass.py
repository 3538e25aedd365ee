"""A logger's filter is found by what the loop computed, and only where there is one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from hiltestbed.diagnosis.find import judge
from hiltestbed.diagnosis.investigate import investigate
from hiltestbed.diagnosis.low_pass import LowPass, low_pass_between
from hiltestbed.frames import Array
from hiltestbed.replay.wrench import shifted
from tests.slow import SLOW, slow

from .recorded import drawn

ROWS, FINER = 1500, 16


def forces(seed: int, finer: int = 1) -> Array:
    """(N, 2) a contact in noise that is white from row to row; ``finer``: samples a row."""
    rng = np.random.default_rng(seed)
    t = np.arange(ROWS * finer) / (ROWS * finer)
    bounce = 100.0 * np.sin(np.pi * np.clip((t - 0.3) / 0.4, 0.0, 1.0))
    return np.column_stack([bounce, 0.2 * bounce]) + np.repeat(
        rng.standard_normal((ROWS, 2)), finer, axis=0
    )


@pytest.mark.parametrize(
    ("order", "cutoff", "prompt"),
    [(2, 0.02, True), slow(2, 0.02, False), slow(4, 0.02, True), (6, 0.1, False)],
)
def test_an_analogue_filter_is_found(order: int, cutoff: float, prompt: bool) -> None:
    """Sixteen samples a row stand for a filter before the converter: near half the rate a digital
    one of the next order is the same.
    """
    fine = forces(1, FINER)
    sections = signal.butter(order, cutoff / FINER, fs=1.0, output="sos")
    start = signal.sosfilt_zi(sections)[:, :, None] * fine[0]
    through = np.asarray(signal.sosfilt(sections, fine, axis=0, zi=start)[0])
    late = round(FINER * LowPass(order, cutoff).delay) if prompt else 0
    behind = np.concatenate([through[late:], np.repeat(through[-1:], late, axis=0)])[
        FINER - 1 :: FINER
    ]
    before = fine[FINER - 1 :: FINER]
    found = low_pass_between([before], [behind], [np.ones(ROWS, dtype=bool)])
    assert found is not None
    assert abs(found.order - order) <= (cutoff > 0.05)
    assert found.prompt == prompt
    assert found.cutoff == pytest.approx(cutoff, rel=0.05)
    assert np.std(behind - found(before)) < 0.15 * np.std(behind - before)


def test_its_delay_is_the_group_delay_of_slow_changes() -> None:
    for order in (1, 3, 4):
        sections = signal.butter(order, 0.06, fs=1.0, output="sos")
        phase = float(np.angle(np.asarray(signal.sosfreqz(sections, worN=[1e-4], fs=1.0)[1]))[0])
        assert LowPass(order, 0.06).delay == pytest.approx(-phase / (2.0 * np.pi * 1e-4), rel=1e-4)


def test_behind_it_white_noise_has_its_colour() -> None:
    one = LowPass(4, 0.05)
    through = one(np.random.default_rng(2).standard_normal((200_000, 1)))[1000:-1000, 0]
    density = np.mean([np.mean(block) ** 2 for block in through.reshape(-1, 1000)]) * 1000.0
    # 198 blocks tell a root of a variance to a tenth
    assert one.colour == pytest.approx(np.sqrt(density / np.var(through)), rel=0.15)


def _late(values: Array) -> Array:
    return np.concatenate([np.repeat(values[:1], 3, axis=0), values[:-3]])


def _other_noise(values: Array) -> Array:
    return values + 0.5 * np.random.default_rng(9).standard_normal(values.shape)


def _held_back(values: Array) -> Array:
    return np.where(np.abs(values) > 5.0, values, 0.0)


def _between_rows(values: Array) -> Array:
    return shifted(values, -0.46, held=False)


@pytest.mark.parametrize("change", [np.copy, _late, _other_noise, _held_back, slow(_between_rows)])
def test_where_there_is_none_none_is_found(change: Callable[[Array], Array]) -> None:
    before = forces(3)
    assert low_pass_between([before], [change(before)], [np.ones(ROWS, dtype=bool)]) is None


def test_at_the_end_nothing_is_known_of_what_its_delay_was_taken_off() -> None:
    one, values = LowPass(4, 0.05), forces(4)
    assert np.isinf(one.missed(values)[-9:]).all()
    assert np.isfinite(one.missed(values)[:-9]).all()
    assert np.isfinite(LowPass(4, 0.05, prompt=False).missed(values)).all()


def test_where_no_row_is_known_there_is_nothing_to_find() -> None:
    assert low_pass_between([forces(1)], [forces(1)], [np.zeros(ROWS, dtype=bool)]) is None
    assert low_pass_between([], [], []) is None


@SLOW
def test_the_error_of_its_delay_is_no_late_record_though_all_runs_share_it(tmp_path: Path) -> None:
    dataset = drawn(tmp_path, 601_261, noise=("anti_aliasing", 50.0))
    assert judge(investigate(dataset)).verdict.verdict == "no_discrepancy"
