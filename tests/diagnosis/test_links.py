"""A link on measured inputs: the replays of the blocks, each lane with what departs in it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from hiltestbed.diagnosis.link_model import LinkModel
from hiltestbed.diagnosis.links import (
    CompensationLink,
    DynamicsLink,
    Timing,
    WrenchLink,
    flat_pose,
)
from hiltestbed.diagnosis.links.platform import poses_of
from hiltestbed.effects import Effect
from hiltestbed.effects.table import EFFECTS
from hiltestbed.inference.model import Hypothesis
from hiltestbed.numerical_model.model import NumericalModel
from hiltestbed.replay.wrench import shifted
from hiltestbed.scenario import scenario_from

from .made import (
    POSE_NOISE,
    STIFFNESS,
    H,
    bounce,
    candidates,
    contact_link,
    effect,
    explained,
    link_run,
    platform_link,
    scenario,
)


def compensated(method: dict) -> CompensationLink:
    s = scenario_from(
        scenario().model_dump(mode="json")
        | {"compensation": {"force": method, "motion": {"kind": "none"}}}
    )
    return CompensationLink([link_run(s, 10)], [np.zeros((10, 6))], {})


def test_what_nothing_departs_in_is_the_block_as_believed() -> None:
    s = scenario()
    wrench = np.random.default_rng(1).normal(0, [30, 20, 200, 5, 8, 3], (300, 6))
    model, poses = NumericalModel([s]), []
    for w in wrench:
        model.advance(w[None])
        poses.append(model.pose[0].copy())
    link = DynamicsLink([link_run(s, 300)], [wrench])
    np.testing.assert_allclose(link.shown(0), flat_pose(np.array(poses)), rtol=0, atol=1e-12)


def test_a_body_with_an_appendage_keeps_the_momentum_of_the_whole() -> None:
    wrench = np.zeros((4000, 6))
    wrench[:100, 2] = 50.0
    link = DynamicsLink([link_run(scenario(), 4000)], [wrench])
    swing = effect(
        "dynamics.appendage", mass_ratio=0.2, frequency=2.0, damping_ratio=0.3, body="chaser"
    )
    rebound = [np.diff(link.shown(0, effects)[-2:, 2])[0] for effects in ([], [swing])]
    # damped out, both parts move as one body of the believed mass
    assert rebound[1] == pytest.approx(rebound[0], rel=1e-6)


def test_a_lag_trails_a_ramp_by_its_own_delay() -> None:
    link = platform_link()
    late = link.shown(0)[:, 2] - link.shown(0, [effect("platform.lag", bandwidth=40.0)])[:, 2]
    before = 90  # rows of a uniform approach at 0.03 m/s, long after 1/40 s
    assert late[before] == pytest.approx(0.03 * 2 * 0.7 / (2 * math.pi * 40.0), rel=1e-3)


def test_runs_of_different_length_are_each_replayed_to_their_end() -> None:
    link = platform_link()
    commands = [link.commands[0], link.commands[1][:200]]
    short = type(link)(
        [link.runs[0], link_run(scenario(), 200)],
        commands,
        [np.zeros((len(c), 6)) for c in commands],
    )
    shown = short.predict([(0, ()), (1, ()), (1, [effect("platform.delay", delay=2 * H)])])
    assert [len(s) for s in shown] == [len(commands[0]), 200, 200]
    np.testing.assert_array_equal(shown[1], link.shown(1)[:200])


def test_a_late_record_is_the_record_read_earlier() -> None:
    link = contact_link(seed=None)
    plain, late = link.shown(0), link.shown(0, [effect("log.skew", delay=3 * H)])
    np.testing.assert_allclose(late[3:], plain[:-3], rtol=0, atol=1e-9)
    np.testing.assert_allclose(shifted(late, 3.0)[:-6], plain[:-6], rtol=0, atol=1e-9)


def slope(link: WrenchLink, effects: Sequence[Effect] = ()) -> np.ndarray:
    """(N, 6) rate of the reading of the first run, which a late sample multiplies."""
    early, late = (link.shown(0, [*effects, Timing(delay=d)]) for d in (-0.5 * H, 0.5 * H))
    return (early - late) / H


def test_the_rate_of_a_reading_is_its_slope() -> None:
    """Off the touch, where it steps by c v: here the slope of k x + c v of half a sine."""
    link = contact_link(seed=None)
    found = slope(link, [effect("contact.damping", factor=0.0)])[:, 2]
    x = bounce()[:, 2]
    inside = np.arange(150, 350)
    back = 5  # rows of the sensor's delay
    expected = STIFFNESS * np.gradient(x, H)[inside - back]
    np.testing.assert_allclose(found[inside], expected, atol=2e-3 * np.abs(expected).max())


def test_a_reading_hangs_on_the_facilitys_instants_where_one_lies_at_the_touch() -> None:
    """The step of c v = 12 N at the touch, 0.7 ms before a row: 0.6 ms late, a reading lies 0.1 ms
    after it, the instant before it not.
    """
    link = contact_link(seed=None)
    clear, near = link.doubt(0, ()), link.doubt(0, [effect("sensor.delay", delay=0.6 * H)])
    touch = int(np.argmax(bounce()[:, 2] > 0.0)) + 5
    assert near[touch, 2] == pytest.approx(12.0, rel=0.1)
    assert near[touch + 1 : touch + 150, 2].max() < 0.2
    assert clear[: touch + 150, 2].max() < 0.2


@pytest.mark.parametrize("grid", [None, 20])
def test_a_reading_that_is_stamped_before_its_contact_is_one_read_later_but_not_interpolated(
    grid: int | None,
) -> None:
    """Of the step of c v = 12 N at the touch, 0.7 ms before a row, interpolation between rows would
    give a part. The sensor is late by 5 rows: a shift of -5.3 reads 0.3 ms after the row's contact,
    as one of -0.3 does 5 rows later.
    """
    link = contact_link(seed=None).interpreted(grid=grid)
    before, after = (link.with_timing(Timing(delay=-rows * H)) for rows in (5.3, 0.3))
    np.testing.assert_allclose(before.shown(0)[:-5], after.shown(0)[5:], rtol=0, atol=1e-9)
    doubts = [link.doubt(0, ()) for link in (before, after)]
    np.testing.assert_allclose(doubts[0][:-5], doubts[1][5:], rtol=0, atol=1e-9)
    np.testing.assert_allclose(slope(before)[:-5], slope(after)[5:], rtol=0, atol=1e-6)


def test_a_reading_at_the_edge_of_a_dead_zone_hangs_on_the_noise() -> None:
    """The spread of 400,000 draws of the noise about the reading without noise, to some parts of
    sigma/w, which its size differs from w.
    """
    sigma, width = 2.0, 60.0
    link = contact_link(seed=None)
    runs = [replace(run, sigma=np.full_like(run.sigma, sigma)) for run in link.runs]
    zone = effect("sensor.deadzone", width=width)
    plain, read = link.shown(0)[:, 2], link.shown(0, [zone])[:, 2]
    spread = WrenchLink(runs, link.paths).doubt(0, [zone])
    # there it hangs on the instant, too
    crosses = np.diff(read > 0.0, prepend=False) | np.diff(read > 0.0, append=False)
    edge = np.flatnonzero((np.abs(plain - width) < 3.5 * sigma) & ~crosses)
    assert len(edge) > 2
    noisy = plain[edge] + sigma * np.random.default_rng(4).standard_normal((400_000, len(edge)))
    off = np.where(np.abs(noisy) < width, 0.0, noisy) - read[edge]
    expected = np.sqrt(np.mean(off**2, axis=0))
    np.testing.assert_allclose(
        np.hypot(spread[edge, 2], np.where(read[edge] > 0.0, sigma, 0.0)), expected, rtol=0.12
    )
    assert spread[plain < width - 8.0 * sigma, 2].max() < 2e-6  # 60 N times the root of Q(8)


def test_a_pose_there_and_back() -> None:
    rng = np.random.default_rng(2)
    flat = np.concatenate([rng.normal(size=(20, 3)), 0.02 * rng.normal(size=(20, 3))], axis=1)
    np.testing.assert_allclose(flat_pose(poses_of(flat)), flat, atol=1e-12)
    # q and -q are one attitude
    np.testing.assert_allclose(
        flat_pose(-poses_of(flat) * [-1, -1, -1, 1, 1, 1, 1]), flat, atol=1e-12
    )


def test_a_record_that_was_read_again_between_the_loops_rows_is_late_by_its_own_part_of_a_row() -> (
    None
):
    """A spring and damper's force, read 3.7 rows late with the noise of four rows before: all of it
    shifted alike leaves a quarter of a row of the force, or of the noise.
    """
    rng, rows, late = np.random.default_rng(5), 500, 3.7

    def force(row: np.ndarray) -> np.ndarray:
        inside = np.clip(row - 120.4, 0.0, 300.0) * math.pi / 300.0
        touches = (inside > 0.0) & (inside < math.pi)
        return np.where(touches, 600.0 * np.sin(inside) + 20.0 * np.cos(inside), 0.0)

    s = scenario_from(
        scenario().model_dump(mode="json") | {"compensation": {"force": {"kind": "phase_lead"}}}
    )
    runs, logged = [], []
    for _ in range(3):
        noise = 0.2 * rng.standard_normal((rows + 4, 6))
        read, again = noise[4:].copy(), noise[:-4].copy()
        read[:, 2] += force(np.arange(rows))
        again[:, 2] += force(np.arange(rows) - late)
        touching = force(np.arange(rows)) != 0.0
        used = CompensationLink([link_run(s, rows)], [read], {}).shown(0)
        runs.append(link_run(s, used, 0.07, touching))
        logged.append(again)
    found = explained(CompensationLink(runs, logged, {}), "log.skew", "loop.deadzone")
    assert found.adequate
    assert found.kinds == ("log.skew",)
    assert found.causes[0].estimates[0].value == pytest.approx(late * H, abs=0.05 * H)


def test_noise_is_raised_as_the_weights_of_the_extrapolation_say() -> None:
    """4 F_0 - 6 F_1 + 4 F_2 - F_3: the root of 16 + 36 + 16 + 1."""
    assert compensated({"kind": "polynomial", "order": 3}).noise_gain() == pytest.approx(
        np.sqrt(69.0), rel=1e-9
    )
    assert compensated({"kind": "none"}).noise_gain() == pytest.approx(1.0)


def test_noise_of_a_method_that_looks_at_more_than_the_reading_is_not_raised() -> None:
    assert compensated({"kind": "resynchronised"}).noise_gain() == 1.0


def test_where_nobody_measured_the_pose_the_platforms_effects_are_felt_in_the_force() -> None:
    effects = [effect("platform.lag", bandwidth=20.0)]
    platform = platform_link(speeds=(0.03,))
    commands, s = platform.commands, platform.runs[0].scenario
    runs = [link_run(s, len(c)) for c in commands]
    reached, believed = platform.paths(effects), platform.paths([])
    delay = effect("sensor.delay", delay=0.002)
    link = WrenchLink(runs, believed).commanded(commands, [np.zeros((len(c), 6)) for c in commands])
    felt = WrenchLink(runs, reached).shown(0, [delay])
    np.testing.assert_allclose(link.shown(0, [*effects, delay]), felt, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(
        link.shown(0, [delay]), WrenchLink(runs, believed).shown(0, [delay])
    )
    assert np.abs(felt - link.shown(0, [delay])).max() > 1.0


@pytest.mark.parametrize("part", [0.25, 0.5])
def test_a_response_between_rows_takes_off_what_it_averages_of_a_rounded_command(
    part: float,
) -> None:
    """Of (1 - p) e_k + p e_(k-1) the variance is 1 - 2 p (1 - p) of that of e."""
    link, rounding = platform_link(), 1e-6  # [m]
    errors = [np.full((len(c), 3), rounding) for c in link.commands]
    model = LinkModel(link.with_rounding(errors))
    counted = 3 * sum(map(len, link.commands))
    expected = 2.0 * part * (1.0 - part) * counted * (rounding / POSE_NOISE) ** 2
    (late,) = (c for c in candidates("platform.delay") if not c.variant)

    def away(model: LinkModel, delay: float) -> float:
        return model._smoothed_away(Hypothesis((late,), np.array([delay]), np.zeros(0)))

    assert away(model, part * H) == pytest.approx(expected, rel=0.1)
    assert away(model, H) == pytest.approx(0.0, abs=0.01 * expected)
    assert away(LinkModel(link), part * H) == 0.0


@pytest.mark.parametrize("factor", [1.0, 3.0])
def test_rounding_errors_of_a_path_pass_through_spring_and_damper(factor: float) -> None:
    """Of k e_k + c (e_k - e_(k-1)) / h the variance is (k + c/h)^2 + (c/h)^2 times that of e."""
    link = contact_link(seed=None)
    rounded, contact = 1e-6, link.runs[0].scenario.mechanism.contact  # [m]
    passed = link.with_rounding(
        [np.full((len(p), 3), rounded) for p in link.paths]
    ).passed_from_input(0, [effect("contact.damping", factor=factor)])
    inside = link.runs[0].measured[:, 2] > 20.0
    slope = factor * contact.damping / H
    expected = ((contact.stiffness + slope) ** 2 + slope**2) * rounded**2
    assert passed[inside, 2].mean() == pytest.approx(expected, rel=0.2)  # four copies of 287 rows
    assert link.passed_from_input(0, ()) is None


def test_an_interpretation_can_be_taken_back() -> None:
    """Else a search that takes one up under a wrong cause keeps it under the right one."""
    link = contact_link(seed=None)
    others = [other for group in link.interpretations() for other in group]
    assert others
    for other in others:
        assert other.reads != link.reads
        back = [x.reads for group in other.interpretations() for x in group]
        assert link.reads in back


def test_an_unknown_rate_is_worth_a_tick_of_the_damping_force() -> None:
    """The readings of rates taken a tick later differ by c a h, with a = -x w^2 in contact and the
    damping c = 400 N s/m.
    """
    link = contact_link(seed=None).with_unknown_rate()
    term, back = link.runs[0].nuisances, 5  # rows of the sensor's delay
    assert term.shape == (500, 6, 1)
    inside = np.arange(150, 350)
    expected = -400.0 * H * (math.pi / 0.3) ** 2 * bounce()[inside - back, 2]
    np.testing.assert_allclose(
        term[inside, 2, 0], expected, rtol=0, atol=0.03 * np.abs(expected).max()
    )
    assert np.abs(term[:90, 2, 0]).max() == 0.0  # the approach is uniform
    assert link.with_unknown_rate().runs[0].nuisances.shape == (500, 6, 2)  # type: ignore[union-attr]


def test_the_starts_of_one_shape_change_a_reading_alike() -> None:
    """A search looks at one of them: what it changes goes with its parameter, but for the rows at
    whose ends a contact separates, and but for second order where a frame gives. To first order it
    then promises at least the square of the cosine, 0.94, of what the best of them does.
    """
    link = contact_link(seed=None)
    nominal, shapes = link.shown(0), 0
    acting = [kind for kind, cls in EFFECTS.items() if cls.link in ("contact", "sensor")]
    for c in candidates(*acting):
        for start in c.shapes() if c.linear else ():
            each = [link.shown(0, [c.at(np.array(s))]) - nominal for s in c.of_shape(start)]
            middle = link.shown(0, [c.at(np.array(start))]) - nominal
            lengths = [np.linalg.norm(change) * np.linalg.norm(middle) for change in each]
            along = [abs(np.sum(change * middle)) for change in each]
            assert np.all(np.array(along) >= 0.97 * np.array(lengths)), c.key
            shapes += len(each) > 1 and bool(middle.any())
    assert shapes > 20
