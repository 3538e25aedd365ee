"""What leads a search to a cause: effects with a vector, a varying delay, a hidden tone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from hiltestbed.diagnosis import search
from hiltestbed.diagnosis.adequacy import Leftover
from hiltestbed.diagnosis.fit import fit, null_fit
from hiltestbed.diagnosis.jitter_and_hum import hum_beside, jitter_beside, lines
from hiltestbed.diagnosis.links import ModelLink, WrenchLink
from hiltestbed.diagnosis.links.base import Effects, Lane
from hiltestbed.diagnosis.rating import rate
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.diagnosis.search import Search
from hiltestbed.diagnosis.settings import MIN_EXCESS_TO_GROW
from hiltestbed.diagnosis.stamps import used_readings
from hiltestbed.effects import EFFECTS
from hiltestbed.effects.search import candidate
from hiltestbed.frames import Array
from tests.slow import SLOW

from .made import NOISE, SCALES, H, bounce, contact_link, effect, link_run, reread, scenario


class Along(ModelLink):
    """A link whose output is a vector's components, each on a channel of its own, in units of the
    noise.
    """

    name, channels = "dynamics", ("x", "y", "z")

    def __init__(self, measured: Array) -> None:
        self.runs = [link_run(scenario(), measured)]

    def _replay(self, lanes: Sequence[Lane]) -> list[Array]:
        each = [[e.parameters()["offset"] for e in effects] for _, effects in lanes]
        sums = [1e3 * np.sum(offsets, axis=0) if offsets else np.zeros(3) for offsets in each]
        return [np.tile(one, (self.runs[0].rows, 1)) for one in sums]


@pytest.mark.parametrize("direction", [(1, 1, 1), (1, -1, 0), (-1, -1, 2), (0, 1, -1)])
def test_a_vector_is_found_in_whichever_direction_it_points(
    direction: tuple[int, int, int],
) -> None:
    measured = np.tile(1e3 * 0.02 * np.array(direction, dtype=float), (10, 1))
    residual = Residual(Along(measured))
    starts = [(0, 0, 0), (0.05, 0.05, 0.05)]
    c = candidate(
        EFFECTS["dynamics.port_offset"],
        {f"offset.{j}": [0.0] for j in range(3)},
        starts=starts,
        body="chaser",
    )
    # weighed first: at a start it may make things worse
    found = Search((c,)).extend(residual, null_fit(residual))
    assert len(found) == 1
    assert found[0].theta == pytest.approx(0.02 * np.array(direction), abs=1e-8)


def test_below_a_bound_on_an_error_nothing_departs_though_an_effect_fits() -> None:
    """A hundred rows off by the same 0.8 of a level: in noise of that level they are an effect,
    below a bound on an error they are none.
    """
    residual = Residual(Along(np.full((100, 3), 0.8)))
    c = candidate(
        EFFECTS["dynamics.port_offset"],
        {f"offset.{j}": [0.0] for j in range(3)},
        starts=[(0, 0, 0)],
        body="chaser",
    )

    def judge(of: Residual, effects: Effects) -> dict[str, Leftover]:
        return {"x": Leftover(square(of(effects)) / 300.0, 0.0, 1.0, 1.0, 100)}

    assert Search((c,), judge).explain(residual).departs
    assert not Search((c,), judge, bounded=True).explain(residual).departs
    beyond = Residual(Along(np.full((100, 3), 1.5)))
    assert Search((c,), judge, bounded=True).explain(beyond).departs


def test_a_drift_is_found_up_to_the_size_of_the_contact() -> None:
    drifts = list(EFFECTS["sensor.drift"].candidates(SCALES))
    assert len(drifts) == 3  # an axis each
    assert all(c.low[0] <= -300.0 / 0.5 and c.high[0] >= 300.0 / 0.5 for c in drifts)


@pytest.mark.parametrize("ticks", [3.4, 6.4, 9.7, 16.6])
def test_a_delay_is_found_where_the_mechanism_moves_in_jumps(ticks: float) -> None:
    """At each jump of 0.15 mm within a tick the damper gives a peak of a tick: a delay that is a
    tick off fits no better than none.
    """
    path = bounce()
    path[:, 2] = 1.5e-4 * np.round(path[:, 2] / 1.5e-4)
    clean = WrenchLink(contact_link(seed=None).runs, [path])
    late = clean.shown(0, [effect("sensor.delay", delay=ticks * H)])
    residual = Residual(
        reread(clean, [late + NOISE * np.random.default_rng(5).standard_normal(late.shape)])
    )
    candidates = tuple(EFFECTS["sensor.delay"].candidates(replace(SCALES, jumps=True)))
    found = Search(candidates).explain(residual)
    assert found.adequate
    assert found.chosen.theta == pytest.approx(ticks * H, abs=1e-2 * H)


def test_a_reading_that_is_late_throughout_is_no_varying_delay() -> None:
    late = Residual(contact_link([effect("sensor.delay", delay=0.3e-3)]))
    assert jitter_beside(late, null_fit(late)) is None


def test_a_delay_that_varies_is_found_with_its_size() -> None:
    sigma, link, rng = 0.4e-3, contact_link(), np.random.default_rng(3)
    slope = link.slopes(())[0]
    residual = Residual(
        reread(link, [link.runs[0].measured - slope * sigma * rng.standard_normal((len(slope), 1))])
    )
    found = jitter_beside(residual, null_fit(residual))
    assert found is not None
    # Some 300 rows in contact: 1/sqrt(2 x 300) is a relative error of 0.04 of the deviation; three
    # of them, and the edges.
    assert found.theta[-1] == pytest.approx(sigma, rel=0.15)


@pytest.mark.parametrize("outliers", [0, 6])
def test_a_delay_that_grows_with_the_force_is_no_jitter_whatever_a_few_samples_leave(
    outliers: int,
) -> None:
    """Neighbouring samples follow one another; samples that are far off, as at a touch, do not hide
    it.
    """
    link, rng = contact_link(), np.random.default_rng(4)
    run, slope = link.runs[0], link.slopes(())[0]
    force = np.abs(run.measured[:, 2:3])
    # about which it varies without a trend in the rate of the reading
    mean = np.sum(slope**2 * force) / np.sum(slope**2)
    measured = (
        run.measured
        - slope * 0.4e-3 * (force - mean) / force.max()
        + NOISE * rng.standard_normal(slope.shape)
    )
    far = rng.choice(np.flatnonzero(force[:, 0] > 0.5 * force.max()), outliers, replace=False)
    measured[far, 2] += 30.0 * NOISE * rng.choice([-1, 1], outliers)
    residual = Residual(reread(link, [measured]))
    assert jitter_beside(residual, null_fit(residual)) is None


def test_a_hum_shows_as_a_line_outside_contacts() -> None:
    hum = effect("sensor.hum", frequency=61.0, amplitude=0.5, phase=0.3, axis="z")
    assert lines(contact_link()) == {}
    frequency, amplitude, _ = lines(contact_link([hum]))["z"]
    assert frequency == pytest.approx(61.0, abs=0.5)  # 0.2 s without contact, in two pieces
    assert amplitude == pytest.approx(0.5, rel=0.1)


def test_a_hum_of_what_is_held_throughout_shows_as_a_line_within_the_contact() -> None:
    link = contact_link([effect("sensor.hum", frequency=61.0, amplitude=0.5, phase=0.3, axis="z")])
    assert not link.runs[0].touching.all()
    link.runs = [replace(run, touching=np.ones_like(run.touching)) for run in link.runs]
    frequency, amplitude, _ = lines(link)["z"]
    assert frequency == pytest.approx(61.0, abs=0.1)
    assert amplitude == pytest.approx(0.5, rel=0.05)


def test_a_hum_behind_a_dead_zone_is_found_in_the_contact() -> None:
    zone = effect("sensor.deadzone", width=30.0)
    hum = effect("sensor.hum", frequency=130.0, amplitude=1.5, phase=0.4, axis="z")
    residual = Residual(contact_link([zone, hum]))
    base = fit(
        residual, (candidate(EFFECTS["sensor.deadzone"], {"width": [25.0, 30.0]}),), [(30.0,)]
    )
    found = hum_beside(residual, base)
    assert found is not None
    # 300 rows: the frequency of a tone 15 times the noise is known to sqrt(6)/(pi T 15 sqrt(300)) =
    # 0.01 Hz in T = 0.3 s.
    second = found.effects()[1].parameters()
    assert second["frequency"] == pytest.approx(130.0, abs=0.05)
    assert second["amplitude"] == pytest.approx(1.5, rel=0.05)


@pytest.mark.parametrize("variant", [{}, {"reread": True}])
def test_a_record_stamped_whole_ticks_late_is_the_record_so_many_rows_on(
    variant: dict[str, bool],
) -> None:
    link = contact_link()
    hum = effect("sensor.hum", frequency=61.0, amplitude=2.0, phase=0.3, axis="z")
    stamped = link.shown(0, [hum, effect("log.skew", variant, delay=3 * H)])
    assert stamped[50:] == pytest.approx(link.shown(0, [hum])[47:-3], abs=1e-9)


def test_what_the_loop_read_is_had_from_a_late_record_across_a_touch() -> None:
    link = contact_link()
    skew = effect("log.skew", {"reread": True}, delay=2.7e-3)
    noise = NOISE * np.random.default_rng(4).standard_normal((500, 6))
    in_time, late = link.shown(0), link.shown(0, [skew])
    run = replace(link.runs[0], measured=late + np.concatenate([np.zeros((3, 6)), noise[:-3]]))
    used = used_readings(run, late, in_time, 3)
    # beyond which nothing is taken for noise
    assert used[:-3] == pytest.approx((in_time + noise)[:-3], abs=4.0 * NOISE)
    kept = np.abs(noise[:-3]) < 4.0 * NOISE
    assert used[:-3][kept] == pytest.approx((in_time + noise)[:-3][kept], abs=1e-9)


def test_where_a_reading_lies_on_the_steps_of_the_facility_the_data_bear_it_out() -> None:
    """A damper's force jumps from tick to tick: between two instants a reading is on neither side
    of the jump, or on the line across.
    """
    delay, grid = 2.7 * H, 2  # in the first half of a tick, whose start the line crosses
    exact = contact_link(seed=None)
    stepped = exact.interpreted(grid=grid)
    c = candidate(EFFECTS["sensor.delay"], {"delay": [2.0 * H, 2.8 * H]})
    for own, other in ((exact, stepped), (stepped, exact)):
        measured = [own.shown(0, [effect("sensor.delay", delay=delay)])]
        right, wrong = (
            fit(Residual(reread(link, measured)), (c,), c.grid) for link in (own, other)
        )
        assert right.theta[0] == pytest.approx(delay, rel=1e-4)
        assert right.chi2 < 1e-3 * wrong.chi2


def count(replayed: list[int], i: int, lanes: Sequence[Lane]) -> None:
    replayed[i] += len(lanes)


def test_with_another_timing_a_costly_search_is_made_again_unless_it_is_as_far_off(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its causes are fitted again where they leave ten times the noise there too; else others are
    sought as well.
    """
    monkeypatch.setattr(WrenchLink, "costly", True)
    link = contact_link([effect("contact.stiffness", factor=1.3)])
    wanted = tuple(
        c for kind in ("contact.stiffness", "sensor.lag") for c in EFFECTS[kind].candidates(SCALES)
    )
    lags = Search(tuple(c for c in wanted if c.kind == "sensor.lag"))
    found = lags.explain(Residual(link))
    assert found.worst > MIN_EXCESS_TO_GROW
    tried: list[str] = []
    seek = Search(wanted, progress=tried.append).after(found)
    off = seek.explain(Residual(link))
    assert not tried
    assert off.chosen.kinds == found.chosen.kinds
    assert off.chosen.score == pytest.approx(found.chosen.score, rel=1e-6)
    assert not off.adequate
    near = seek.explain(Residual(contact_link([effect("contact.stiffness", factor=1.0003)])))
    assert tried
    assert near.chosen.kinds == ("contact.stiffness",)


@pytest.mark.parametrize("speed", [0.002, 0.05, 0.3])
def test_a_damping_that_grows_with_depth_is_sought_to_where_little_is_left_of_a_rebound(
    speed: float,
) -> None:
    """e of F = k x (1 + alpha v): with y = alpha v it is where y - ln(1 + y) has the value of the
    approach, whatever mass and spring.
    """
    (c,) = EFFECTS["contact.hunt_crossley"].candidates(replace(SCALES, slow=speed, fast=speed))
    most = float(c.high[0]) * speed
    gone: Any = brentq(lambda y: y + math.log1p(-y) + most - math.log1p(most), 1e-12, 1.0 - 1e-12)
    assert gone / most < 0.2
    assert c.low[0] == 0.0
    # starts of small losses and of large ones
    assert [1.0 - 2.0 / 3.0 * s[0] * speed > 0.9 for s in c.grid] == [True, True, False, False]


@SLOW
def test_a_costly_link_is_explained_as_any_other_from_fewer_replays(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Fits on a few runs come first; what all runs then give is the same."""
    hidden = [effect("contact.stiffness", factor=1.3), effect("contact.dry_friction", force=8.0)]
    residual = Residual(contact_link(hidden, speeds=(0.01, 0.02, 0.03, 0.04, 0.05, 0.06)))
    candidates = tuple(
        c for e in EFFECTS.values() if e.link in ("contact", "sensor") for c in e.candidates(SCALES)
    )
    replayed, found, replay = [0, 0], [], WrenchLink._replay
    for i, costly in enumerate((False, True)):
        monkeypatch.setattr(WrenchLink, "costly", costly)
        monkeypatch.setattr(
            WrenchLink,
            "_replay",
            lambda self, lanes, i=i: count(replayed, i, lanes) or replay(self, lanes),
        )
        found.append(Search(candidates).explain(residual))
    monkeypatch.undo()
    assert replayed[1] < 0.9 * replayed[0]
    assert found[0].adequate
    assert found[1].adequate
    assert (
        sorted(found[1].chosen.kinds)
        == sorted(found[0].chosen.kinds)
        == ["contact.dry_friction", "contact.stiffness"]
    )
    np.testing.assert_allclose(
        found[1].chosen.of(found[0].chosen.causes), found[0].chosen.theta, rtol=1e-4
    )
    assert found[1].chosen.chi2 == pytest.approx(found[0].chosen.chi2, abs=0.1)


def test_a_cause_is_continued_with_the_variant_that_leaves_more_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A power law whose damper acts, felt late: alone, one without a damper comes nearer, and
    beside that one a lag gains nothing. Here no other cause is continued.
    """
    monkeypatch.setattr(search, "BEAM_WIDTH", 1)
    hidden = (
        effect("contact.power_law", exponent=1.41, stiffness=1.6e6),
        effect("sensor.lag", time_constant=0.007),
        effect("sensor.crosstalk", ratio=-0.06, source="z", axis="x"),
    )
    kinds = [e.kind for e in hidden]
    residual = Residual(contact_link(hidden, speeds=(0.02, 0.04, 0.08)))
    candidates = [
        c
        for kind in (*kinds, "contact.relaxation", "contact.dry_friction")
        for c in EFFECTS[kind].candidates(SCALES)
    ]
    found = Search(tuple(candidates)).explain(residual)
    alone = [f for f in found.singles if f.kinds == ("contact.power_law",)]
    assert alone[0].causes[0].variant == {"damper": "none"}
    assert sorted(found.chosen.kinds) == sorted(kinds)
    assert found.adequate


@pytest.mark.parametrize(("sigma", "counts"), [(1e-3, True), (0.2, False)])
def test_a_jitter_at_the_end_of_its_search_is_none(sigma: float, counts: bool) -> None:
    """It would explain any misfit: here noise in proportion to the rate of the reading, ten times
    as large as the largest jitter's.
    """
    link, rng = contact_link(), np.random.default_rng(5)
    shaken = [
        r.measured + sigma * s * rng.standard_normal((len(s), 1))
        for r, s in zip(link.runs, link.slopes(()), strict=True)
    ]
    residual = Residual(reread(link, shaken))
    found = jitter_beside(residual, null_fit(residual))
    assert (found is not None) == counts
    assert found is None or found.theta[0] == pytest.approx(sigma, rel=0.2)


@pytest.mark.parametrize("damping", [1.0, 1.4])
def test_a_cause_that_only_led_to_a_better_estimate_of_another_is_none(damping: float) -> None:
    """A stiffness and a damping fitted together, where the damping is hidden as well, and where it
    is not.
    """
    hidden = [
        effect("contact.stiffness", factor=1.3),
        *([effect("contact.damping", factor=damping)] if damping > 1.0 else []),
    ]
    residual = Residual(contact_link(hidden))
    causes = [
        next(iter(EFFECTS[kind].candidates(SCALES)))
        for kind in ("contact.stiffness", "contact.damping")
    ]
    found = Search(tuple(causes)).needed(residual, fit(residual, causes, [[1.2, 1.1]]))
    assert found.kinds == tuple(e.kind for e in hidden)
    assert found.theta[0] == pytest.approx(1.3, rel=1e-3)


class Late(Along):
    """As many ticks late as a hypothesis says: n v of the first channel, and n^2 w of the second,
    little of it.
    """

    def _replay(self, lanes: Sequence[Lane]) -> list[Array]:
        counts = [effects[0].parameters()["ticks"] if effects else 0 for _, effects in lanes]
        return [np.tile([1e3 * n, n**2, 0.0], (len(self.runs[0].measured), 1)) for n in counts]


def test_a_number_of_ticks_is_rated_by_what_it_explains_as_it_stands() -> None:
    """Twelve ticks lie best in the direction of what is on record, and are seven too many: a number
    of ticks has no other size.
    """
    residual = Residual(Late(np.tile([5e3, 60.0, 0.0], (10, 1))))
    rated = rate(
        residual, null_fit(residual), tuple(EFFECTS["dynamics.step_delay"].candidates(SCALES)), 3
    )
    assert [c.fixed["ticks"] for _, c, _ in rated[:3]] in ([5, 4, 6], [5, 6, 4])
    assert rated[0][0] == pytest.approx(10 * (5e3**2 + 60.0**2 - 35.0**2))
