"""Each kind of noise has the statistics that it claims."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal, stats

from tests.equipment.independent_rig import NOISE_KINDS, Log
from tests.equipment.independent_rig.noise_kinds import HARMONICS, LONGEST_HOLD, MAINS

ROWS, RATE = 20_000, 1000.0
SPEED = 0.0312345  # m/s
SIGMA = np.array([0.5, 0.5, 0.5, 0.02, 0.02, 0.02])


def _log(force: float = 0.0, rows: int = ROWS) -> Log:
    """A log with a constant force and a uniform motion."""
    t = np.arange(rows) / RATE
    pose = np.zeros((rows, 7))
    pose[:, 6], pose[:, 2] = 1.0, SPEED * t
    wrench = np.zeros((rows, 6))
    wrench[:, 2] = force
    return Log(t, pose, pose.copy(), wrench, wrench.copy(), 1.0 / RATE, SIGMA)


def _noise(name: str, strength: float, force: float = 0.0, seed: int = 1) -> np.ndarray:
    log = _log(force)
    return (
        NOISE_KINDS[name](log, strength, np.random.default_rng(seed)).wrench_meas - log.wrench_meas
    )


def _neighbours(noise: np.ndarray) -> np.ndarray:
    return np.array([np.corrcoef(noise[1:, j], noise[:-1, j])[0, 1] for j in range(6)])


def test_the_standard_deviation_is_what_the_strength_says() -> None:
    """In each axis, about the mean of the run; a tare is such a mean, another in each run."""
    share = NOISE_KINDS["proportional"].strengths[-1]
    grown = SIGMA.copy()
    grown[2] = np.hypot(SIGMA[2], share * 400.0)
    offsets = np.array([_noise("tare", 4.0, seed=s).mean(axis=0) for s in range(60)])
    cases = {
        "proportional": (np.std(_noise("proportional", share, force=400.0), axis=0), grown, 0.05),
        "tare": (np.std(_noise("tare", 4.0), axis=0), SIGMA, 0.05),
        "tares": (np.std(offsets, axis=0), 4.0 * SIGMA, 0.35),
        "pink": (np.std(_noise("pink", 3.0), axis=0), 3.0 * SIGMA, 1e-9),
    }
    for name in ("white", "student_t", "coloured"):
        weak = NOISE_KINDS[name].strengths[0]
        cases[name] = (np.std(_noise(name, weak), axis=0), SIGMA, 0.05)
    wrong = [n for n, (is_, said, within) in cases.items() if not np.allclose(is_, said, within)]
    assert not wrong


def test_coloured_noise_is_first_order() -> None:
    correlation = 0.6
    noise = _noise("coloured", correlation)
    np.testing.assert_allclose(_neighbours(noise), correlation, atol=4.0 / np.sqrt(ROWS))
    second = np.array([np.corrcoef(noise[2:, j], noise[:-2, j])[0, 1] for j in range(6)])
    np.testing.assert_allclose(second, correlation**2, atol=4.0 / np.sqrt(ROWS))
    first_rows = np.array([_noise("coloured", correlation, seed=s)[0, 2] for s in range(200)])
    assert np.std(first_rows) == pytest.approx(SIGMA[2], rel=0.2)  # as if it had run for ever


def test_white_noise_is_white_and_normal() -> None:
    noise = _noise("white", 2.0)
    np.testing.assert_allclose(np.std(noise, axis=0), 2.0 * SIGMA, rtol=0.05)
    assert np.abs(_neighbours(noise)).max() < 4.0 / np.sqrt(ROWS)
    assert abs(stats.kurtosis(noise[:, 2])) < 0.2


def test_pink_noise_falls_as_one_over_the_frequency() -> None:
    noise = _noise("pink", 3.0)
    f, power = signal.welch(noise[:, 2], RATE, nperseg=4096)
    inside = (f > 2.0) & (f < 300.0)
    slope = np.polyfit(np.log(f[inside]), np.log(power[inside]), 1)[0]
    assert slope == pytest.approx(-1.0, abs=0.1)


def test_students_t_has_its_tails() -> None:
    dof = 6.0
    noise = _noise("student_t", dof)[:, :3].ravel() / (SIGMA[0] * np.sqrt((dof - 2.0) / dof))
    assert stats.kstest(noise, stats.t(dof).cdf).pvalue > 1e-3
    assert stats.kstest(noise / np.std(noise), "norm").pvalue < 1e-3


def test_spikes_are_as_many_and_as_large_as_they_say() -> None:
    share = NOISE_KINDS["spikes"].strengths[-1]
    noise = _noise("spikes", share)[:, :3] / SIGMA[:3]
    far = np.abs(noise) > 6.0
    assert far.mean() == pytest.approx(share, rel=0.25)
    assert np.abs(noise).max() < 36.0
    assert np.std(noise[~far]) == pytest.approx(1.0, rel=0.05)


def test_a_slow_drift_begins_at_nought_and_is_slower_than_the_run() -> None:
    noise = _noise("slow_drift", 4.0)
    smooth = np.asarray(signal.savgol_filter(noise, 501, 2, axis=0))
    assert np.abs(smooth[0]).max() < 0.5 * SIGMA.max()
    assert (np.ptp(smooth, axis=0) < 4.6 * SIGMA).all()
    assert (np.ptp(smooth, axis=0) > 0.3 * SIGMA).all()
    x = np.linspace(-1.0, 1.0, ROWS)
    left = (
        noise - np.polynomial.polynomial.polyval(x, np.polynomial.polynomial.polyfit(x, noise, 6)).T
    )
    np.testing.assert_allclose(np.std(left, axis=0), SIGMA, rtol=0.05)


def test_mains_are_lines_at_the_harmonics() -> None:
    strength = 2.0
    noise = _noise("mains", strength)[:, 2]
    spectrum = np.abs(np.fft.rfft(noise)) / (ROWS / 2)
    f = np.fft.rfftfreq(ROWS, 1.0 / RATE)
    for n in HARMONICS:
        assert spectrum[np.argmin(np.abs(f - n * MAINS))] == pytest.approx(
            strength / n * SIGMA[2], abs=4.0 * SIGMA[2] / np.sqrt(ROWS)
        )


@pytest.mark.parametrize("cutoff", NOISE_KINDS["anti_aliasing"].strengths)
def test_an_anti_aliasing_filter_takes_what_lies_above_it_and_nothing_of_what_lies_below(
    cutoff: float,
) -> None:
    log = _log()
    slow = 100.0 * np.sin(2.0 * np.pi * 2.0 * log.t)
    log = replace(log, wrench_meas=np.stack([slow] * 6, axis=1))
    noisy = NOISE_KINDS["white"](log, 1.0, np.random.default_rng(4))
    filtered = NOISE_KINDS["anti_aliasing"](noisy, cutoff, np.random.default_rng(5)).wrench_meas
    left = (filtered - log.wrench_meas)[200:-200]
    # White noise through a fourth-order Butterworth low-pass keeps 1.026 fc/(rate/2) of its power;
    # part rows take a little more.
    np.testing.assert_allclose(
        np.std(left, axis=0), SIGMA * np.sqrt(1.026 * cutoff / (0.5 * RATE)), rtol=0.1
    )
    swing = np.abs(np.fft.rfft(filtered[:, 2]))
    # 2 Hz in 20 s; the phase is in `left`
    assert swing[int(40 * 2.0 / 2.0)] / (ROWS / 2) == pytest.approx(100.0, rel=1e-3)


def test_held_rows_repeat_the_row_before() -> None:
    log = NOISE_KINDS["white"](_log(), 1.0, np.random.default_rng(1))
    held = NOISE_KINDS["held_rows"](log, 0.05, np.random.default_rng(2)).wrench_meas
    same = np.all(held[1:] == held[:-1], axis=1)
    assert same.mean() == pytest.approx(0.05, rel=0.15)
    runs = np.diff(np.flatnonzero(np.diff(np.concatenate([[0], same.astype(int), [0]]))))[::2]
    assert runs.max() <= 2 * LONGEST_HOLD


def test_every_kind_has_two_strengths_or_more_and_leaves_the_log_that_it_was_given() -> None:
    for name, kind in NOISE_KINDS.items():
        assert len(kind.strengths) >= 2, name
        log = _log(100.0, rows=400)
        before = {c: rows.copy() for c, rows in log.channels().items()}
        for strength in kind.strengths:
            kind(log, strength, np.random.default_rng(1))
        for channel, rows in log.channels().items():
            np.testing.assert_array_equal(rows, before[channel], err_msg=f"{name}: {channel}")
