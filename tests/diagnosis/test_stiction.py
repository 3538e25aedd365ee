"""A platform with stiction is found with its stick, the instants at which it moves, and how late
its pose is stamped.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hiltestbed.diagnosis.links import LinkRun, PlatformLink, Timing
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.diagnosis.stiction import Sticking, sticking
from hiltestbed.frames import Array
from tests.slow import SLOW, slow

from .made import POSE_NOISE, H, bounce, effect, link_run, noisy, platform_link, scenario

Change = Callable[[LinkRun, Array], LinkRun]  # of a run, and what its link shows of it


def sticks(instants: int, stick: float, phase: float = 0.0) -> list:
    return [effect("platform.friction", {"instants": instants, "phase": phase}, stick=stick)]


def approaching(effects: list, speeds: tuple[float, ...]) -> PlatformLink:
    """Poses of a platform with `effects` and noise, in runs that each begin where, and as fast as,
    their scenario says.
    """
    paths, runs = [bounce(speed=v) for v in speeds], []
    for path, v in zip(paths, speeds, strict=True):
        believed = scenario()
        approach = believed.approach.model_copy(
            update={"gap": -float(path[0, 2]), "velocity": (0.0, 0.0, v)}
        )
        s = believed.model_copy(update={"approach": approach})
        runs.append(link_run(s, len(path) - 1, POSE_NOISE))
    commands, still = [p[1:] for p in paths], [np.zeros((len(p) - 1, 6)) for p in paths]
    shown = PlatformLink(runs, commands, still).shown_in_all(effects)
    return PlatformLink(noisy(runs, shown, POSE_NOISE, 2), commands, still)


def left_by(link: PlatformLink, found: Sticking) -> tuple[float, float]:
    """Chi-square of the best of the starts, and that start [m]."""
    residual = Residual(link if found.timing is None else link.with_timing(found.timing))
    return min(
        (square(residual(sticks(m, s, phase))), s)
        for (m, phase), near in found.starts.items()
        for s in near
    )


def allowed(link: PlatformLink) -> float:
    """Chi-square that noise does not exceed but in one case of some 30,000."""
    count = np.count_nonzero(Residual(link)(()))
    return count + 4.0 * math.sqrt(2.0 * count)


def test_a_stick_is_found_to_where_the_last_jump_ends() -> None:
    stick = 8.37e-5
    link = platform_link(sticks(20, stick))
    found = sticking(link, POSE_NOISE, 4)
    # 9.5 mm in and out at 0.06 m/s are some 230 jumps: a noise of 2 um at their end is
    # 2e-6/230/stick = 1e-4 of the stick.
    assert found.starts[20, 0.0][0] == pytest.approx(stick, rel=1e-4)
    assert left_by(link, found)[0] < allowed(link)


@pytest.mark.parametrize(("instants", "stick"), [(2, 1.1e-4), (7, 9.1e-5), (57, 8.46e-5)])
def test_a_stick_is_found_however_finely_a_tick_is_divided(instants: int, stick: float) -> None:
    link = platform_link(sticks(instants, stick))
    assert left_by(link, sticking(link, POSE_NOISE, 4))[0] < allowed(link)


@pytest.mark.parametrize(("instants", "phase", "late"), [(5, 0.3, 0.62), slow(31, 0.5, -1.2)])
def test_a_stick_is_found_whenever_the_platform_obeys_and_the_pose_is_stamped(
    instants: int, phase: float, late: float
) -> None:
    """The jumps tell it: chi-square comes within a tenth of what the true instants leave, which
    differ from those found by what noise hides. A platform that moves at few instants shows in its
    rows only between which of them it is late.
    """
    stick, whole = 9.3e-5, math.floor(late)
    timing = Timing(obeyed=(late - whole) * H, delay=whole * H)
    hidden = sticks(instants, stick, phase)
    link = approaching([*hidden, timing], (0.01, 0.016, 0.025))
    found = sticking(link, POSE_NOISE, 4)
    assert (found.timing.obeyed + found.timing.delay) / H == pytest.approx(
        late, abs=0.05 + 0.5 / instants
    )
    there = square(Residual(link.with_timing(timing))(hidden))
    assert there < allowed(link)
    best, stick_found = left_by(link, found)
    assert best < 1.1 * there
    assert stick_found == pytest.approx(stick, rel=1e-3)


def loud(run: LinkRun, _: Array) -> LinkRun:
    """Third differences take the jumps for noise of ten times the size; while the axis is held,
    differences show what it is.
    """
    return replace(run, sigma=10.0 * run.sigma)


def with_rows_lost(run: LinkRun, _: Array) -> LinkRun:
    measured, sigma = run.measured.copy(), run.sigma.copy()
    sigma[40:60], measured[40:60] = np.inf, 0.0
    return replace(run, sigma=sigma, measured=measured)


def with_an_axis_at(level: float) -> Change:
    """That was not measured, or is at rest: what round-off makes of it is no noise of the one that
    moves.
    """

    def change(run: LinkRun, _: Array) -> LinkRun:
        measured, sigma = run.measured.copy(), run.sigma.copy()
        measured[:, 0] = 1e-17 * np.random.default_rng(6).standard_normal(run.rows)
        sigma[:, 0] = level
        return replace(run, measured=measured, sigma=sigma)

    return change


def exact(run: LinkRun, shown: Array) -> LinkRun:
    return replace(run, measured=shown)


@pytest.mark.parametrize(
    ("change", "noise"),
    [
        (loud, 10.0 * POSE_NOISE),
        (with_rows_lost, POSE_NOISE),
        (with_an_axis_at(np.inf), POSE_NOISE),
        (with_an_axis_at(POSE_NOISE), POSE_NOISE),
        (exact, 0.0),
        (exact, POSE_NOISE),
    ],
)
def test_a_stick_is_found_whatever_else_is_in_the_record(change: Change, noise: float) -> None:
    hidden = sticks(20, 8.37e-5)
    made = platform_link(hidden)
    runs = [change(run, made.shown(i, hidden)) for i, run in enumerate(made.runs)]
    link = PlatformLink(runs, made.commands, made.deflection)
    found = sticking(link, noise, 4)
    assert found.starts[20, 0.0][0] == pytest.approx(8.37e-5, rel=1e-4)
    if change is exact and noise:
        assert list(found.starts) == [(20, 0.0)]
        assert left_by(link, found)[0] == 0.0


@SLOW
def test_a_stick_of_some_three_times_the_noise_is_found_by_all_its_rows() -> None:
    """No row lies six times the noise away; the mean square of them all is twice that of the noise
    and more.
    """
    stick = 3.3 * POSE_NOISE
    link = platform_link(sticks(20, stick), speeds=(0.0011, 0.0017))
    departed = max(
        float(np.abs(run.measured - link.shown(i)).max()) for i, run in enumerate(link.runs)
    )
    assert departed < 7.0 * POSE_NOISE
    left, best = left_by(link, sticking(link, POSE_NOISE, 4))
    assert left < allowed(link)
    # a command so slow tells little of the instants a tick
    assert best == pytest.approx(stick, rel=0.01)


def test_a_platform_that_follows_its_command_has_no_stick() -> None:
    assert sticking(platform_link(), POSE_NOISE, 4) == Sticking({})
