"""Where between tip and surface the force acts is chosen under what was found, and is no departure
by itself.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hiltestbed.diagnosis.fit import Fit, fit, null_fit
from hiltestbed.diagnosis.links import Timing, WrenchLink
from hiltestbed.diagnosis.readings import (
    choose_lever,
    choose_ring,
    choose_steps,
    lever_under,
    other_lever,
    ring_under,
    with_time_grid,
    wrench_link_of,
)
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.diagnosis.search import Explanation, Search
from hiltestbed.effects import EFFECTS
from hiltestbed.effects.search import Candidate, Scales
from hiltestbed.scenario import scenario_from

from .made import NOISE, STIFFNESS, H, bounce, contact_link, effect, link_run, reread, scenario

# of 3 mm of depth and 29 N of friction: 0.09 N m between surface and tip
FRICTION, ACTS_AT = 0.1, 0.0
TORQUE_NOISE = 1e-3  # [N m]
LATE = 0.0028  # [s]
SCALES = Scales(
    force=300.0, depth=3e-3, stiffness=STIFFNESS, tick=H, noise=NOISE, slow=0.03, fast=0.03
)


def sliding(lever: float) -> WrenchLink:
    """A late sensor on a tip that slides across the surface while it pushes; read with the force at
    ``lever``, which acts at ACTS_AT.
    """
    told = scenario().model_dump(mode="json")
    told["mechanism"]["contact"]["friction"] = FRICTION
    s = scenario_from(told)
    path = bounce()
    path[:, 0] = 0.02 * np.sin(7.0 * H * np.arange(len(path)))
    sigma = np.tile([NOISE] * 3 + [TORQUE_NOISE] * 3, (len(path), 1))
    link = WrenchLink([link_run(s, len(path), sigma, path[:, 2] > 0.0)], [path])
    shown = link.interpreted(ACTS_AT).shown(0, [effect("sensor.delay", delay=LATE)])
    return reread(
        link, [shown + sigma * np.random.default_rng(3).standard_normal(shown.shape)]
    ).interpreted(lever)


def candidates(*kinds: str) -> tuple[Candidate, ...]:
    return tuple(c for kind in kinds for c in EFFECTS[kind].candidates(SCALES))


def alone(residual: Residual, kind: str) -> Fit:
    (c,) = candidates(kind)
    return fit(residual, (c,), c.grid)


def test_the_lever_is_chosen_under_the_cause_that_was_found() -> None:
    link = sliding(1.0)
    residual = Residual(link)
    found = lever_under(residual, alone(residual, "sensor.delay"))
    assert isinstance(found.link, WrenchLink)
    assert found.link.lever == pytest.approx(ACTS_AT, abs=0.03)
    assert alone(found, "sensor.delay").theta[0] == pytest.approx(LATE, abs=5e-6)


def test_a_lever_that_is_borne_out_already_stays() -> None:
    residual = Residual(sliding(ACTS_AT))
    assert lever_under(residual, alone(residual, "sensor.delay")) is residual


def test_a_friction_that_is_the_believed_one_is_not_named_for_the_lever_that_it_brings() -> None:
    link = sliding(1.0)
    search = Search(candidates("sensor.delay", "contact.surface_friction"))
    without = search.explain(Residual(link))
    # as if the friction departed
    assert set(without.chosen.kinds) == {"sensor.delay", "contact.surface_friction"}
    found = replace(search, reread=lever_under).explain(Residual(link))
    assert found.chosen.kinds == ("sensor.delay",)
    assert found.adequate


def test_a_cause_that_pays_for_its_lever_alone_is_found_at_the_end_too() -> None:
    residual = Residual(sliding(1.0))
    pair = (
        *candidates("sensor.delay"),
        next(
            c for c in candidates("contact.surface_friction") if c.variant.get("lever") == ACTS_AT
        ),
    )
    both = fit(residual, pair, [(LATE, FRICTION)])
    explanation = Explanation(residual, pair, null_fit(residual), both, True, True, {}, {})
    other = other_lever(explanation)
    assert other is not None
    assert other.lever == ACTS_AT


def test_a_friction_that_departs_is_not_taken_for_a_lever() -> None:
    link = sliding(1.0)
    more = effect("contact.surface_friction", {"lever": ACTS_AT}, coefficient=2.0 * FRICTION)
    residual = Residual(reread(link, [link.shown(0, [more])]).interpreted(1.0))
    (c,) = [c for c in candidates("contact.surface_friction") if c.variant.get("lever") == ACTS_AT]
    found = fit(residual, (c,), c.grid)
    assert (
        other_lever(Explanation(residual, (c,), null_fit(residual), found, True, True, {}, {}))
        is None
    )


def test_without_friction_there_is_no_lever_to_choose() -> None:
    link = sliding(1.0)
    smooth = [replace(run, scenario=scenario()) for run in link.runs]
    same = WrenchLink(smooth, link.paths)
    assert choose_lever(same) is same


@pytest.mark.parametrize("ring", [0.0, 1.0])
def test_whether_a_latch_resists_turning_is_what_the_torques_bear_out(ring: float) -> None:
    told = scenario().model_dump(mode="json")
    told["mechanism"] |= {"kind": "latched"}
    path = bounce()
    path[:, 3], path[:, 6] = 1e-4 * np.sin(7.0 * H * np.arange(len(path))), 1.0
    sigma = np.tile([NOISE] * 3 + [TORQUE_NOISE] * 3, (len(path), 1))
    link = WrenchLink([link_run(scenario_from(told), len(path), sigma)], [path])
    shown = link.interpreted(ring=ring).shown(0)
    data = reread(link, [shown + sigma * np.random.default_rng(3).standard_normal(shown.shape)])
    assert choose_ring(data).ring == ring
    wrong = Residual(data.interpreted(ring=1.0 - ring))
    assert wrench_link_of(ring_under(wrong, alone(wrong, "sensor.delay"))).ring == ring


def mounted(instants: int, damping: float | None = None) -> WrenchLink:
    """A bounce on a mount that is stepped ``instants`` times a tick, with the scenario's
    ``damping`` [N s/m] of the contact or another.
    """
    told = scenario().model_dump(mode="json")
    told["mechanism"]["contact"]["damping"] = (
        told["mechanism"]["contact"]["damping"] if damping is None else damping
    )
    told["mechanism"]["mount"] = {
        "stiffness": [3e5, 3e5, 1e5, 2e4, 2e4, 2e4],
        "damping": [2e3, 2e3, 1e3, 200.0, 200.0, 200.0],
    }
    told["physics_rate"] = instants * told["rate"]
    path = bounce()
    run = link_run(scenario_from(told), len(path), NOISE, path[:, 2] > 0.0)
    return WrenchLink([run], [path])


def test_a_mount_is_right_whatever_its_steps_where_the_data_bear_that_out() -> None:
    """Steps of first order miss half a step of the swing; a leapfrog is of second order, and what
    it misses is extrapolated.
    """
    link, true = (
        mounted(4),
        mounted(1024).shown(0) + (mounted(1024).shown(0) - mounted(256).shown(0)) / 3.0,
    )
    missed = np.abs(link.shown(0) - true).max()
    assert np.abs(link.interpreted(exact=True).shown(0) - true).max() < 0.01 * missed
    assert choose_steps(reread(link, [true])).exact
    assert not choose_steps(reread(link, [link.shown(0)])).exact
    assert not choose_steps(contact_link()).exact


def test_a_touch_that_a_facilitys_steps_put_elsewhere_is_no_departure() -> None:
    """(a u)^2 / (1 + u^2) is less than a^2 for a nuisance of u standard deviations of the noise and
    an amplitude a, here 1.5, on each channel; a stiffness that is 2 % off has another shape, and
    stays.
    """
    link = mounted(4, damping=6000.0).interpreted(exact=True)
    unknown = link.with_unknown_steps()
    terms = unknown.runs[0].nuisances
    assert terms is not None
    assert terms.shape[2] == 2  # of the correction, and of the one touch
    late = Residual(reread(link, [link.shown(0) + 1.5 * terms[:, :, 1]]))
    assert square(late(())) > 100.0
    assert (
        square(Residual(reread(unknown, [link.shown(0) + 1.5 * terms[:, :, 1]]))(())) < 6.0 * 1.5**2
    )
    stiffer = link.shown(0, [effect("contact.stiffness", factor=1.02)])
    assert square(Residual(reread(unknown, [stiffer]))(())) > 0.8 * square(
        Residual(reread(link, [stiffer]))(())
    )


def test_what_a_mounts_steps_miss_is_stamped_as_the_reading_is() -> None:
    """A reading that is stamped 0.3 rows before its contact is that of 0.7 rows after it, a row
    earlier, corrected or not.
    """
    link = mounted(4)
    tick, delay = link.runs[0].scenario.tick, link.runs[0].scenario.sensor.delay
    before, after = (
        link.with_timing(Timing(delay=rows * tick - delay)).interpreted(exact=True)
        for rows in (-0.3, 0.7)
    )
    np.testing.assert_allclose(before.shown(0)[:-1], after.shown(0)[1:], rtol=0, atol=1e-9)


def test_what_a_refit_gains_far_from_noise_is_no_reason_to_read_between_instants() -> None:
    """Without a delay every reading is at an instant, so that both interpretations predict the
    same: the gain is that of the refit alone.

    An estimate d off its optimum costs (d/s)^2 in chi-square, s being its standard deviation by the
    noise. At d = 20 s a refit gains 400. A swing of 50 times the noise on one of six channels
    leaves a chi-square of 2500/6 a sample, and 2 ln 2 times that is more than 400.
    """
    link = contact_link()
    swing = 50.0 * NOISE * math.sqrt(2.0) * np.sin(0.37 * np.arange(link.runs[0].rows))
    along = swing[:, None] * [0, 0, 1, 0, 0, 0]
    residual = Residual(reread(link, [link.shown(0) + along]))
    (c,) = [c for c in candidates("contact.stiffness") if not c.variant]
    best = fit(residual, (c,), c.grid)
    width = float(best.theta[0]) / math.sqrt(square(best.jacobian[:, 0]))
    theta = best.theta + 20.0 * width
    off = replace(
        best, theta=theta, chi2=square(residual([c.at(theta)])), residual=residual([c.at(theta)])
    )
    assert off.chi2 - best.chi2 > 100.0
    assert off.chi2 > 100.0 * np.count_nonzero(off.residual)
    assert (
        with_time_grid(Explanation(residual, (c,), null_fit(residual), off, False, True, {}, {}))
        is None
    )


def test_a_late_sensor_and_a_late_record_are_rivals_where_nothing_shows_what_became_of_the_force() -> (
    None
):
    residual = Residual(contact_link([effect("sensor.delay", delay=LATE)]))
    both = Search(candidates("sensor.delay", "log.skew", "contact.stiffness")).explain(residual)
    assert both.adequate
    assert {both.chosen.kinds, both.rivals[0][0].kinds} == {("sensor.delay",), ("log.skew",)}
    alone = Search(candidates("sensor.delay", "contact.stiffness")).explain(residual)
    assert (alone.chosen.kinds, alone.rivals) == (("sensor.delay",), ((),))
