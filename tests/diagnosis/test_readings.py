"""How a facility computes its contact, where its description leaves that open, is no departure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hiltestbed.diagnosis.investigate import with_other_clock
from hiltestbed.diagnosis.links import Timing, WrenchLink
from hiltestbed.diagnosis.paths import choose_lever, choose_ring, choose_steps
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.scenario import scenario_from

from .made import NOISE, H, bounce, contact_link, effect, explained, link_run, reread, scenario

# of 3 mm of depth and 29 N of friction: 0.09 N m between surface and tip
FRICTION, ACTS_AT = 0.1, 0.0
TORQUE_NOISE = 1e-3  # [N m]
LATE = 0.0028  # [s]


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
    shown = link.interpreted(lever=ACTS_AT).shown(0, [effect("sensor.delay", delay=LATE)])
    return reread(
        link, [shown + sigma * np.random.default_rng(3).standard_normal(shown.shape)]
    ).interpreted(lever=lever)


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
    assert choose_ring(data).reads.ring == ring


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
    assert choose_steps(reread(link, [true])).reads.exact
    assert not choose_steps(reread(link, [link.shown(0)])).reads.exact
    assert not choose_steps(contact_link()).reads.exact


def test_a_touch_that_a_facilitys_steps_put_elsewhere_is_no_departure() -> None:
    """(a u)^2 / (1 + u^2) is less than a^2 for a nuisance of u standard deviations of the noise and
    an amplitude a, here 1.5, on each channel; a stiffness that is 2 % off has another shape, and
    stays.
    """
    link = mounted(4, damping=6000.0).interpreted(exact=True)
    unknown = link.with_unknown_steps()
    terms = unknown.runs[0].nuisances
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


def test_a_friction_that_is_the_believed_one_is_not_named_for_the_lever_that_it_brings() -> None:
    """Believed at the tip, where the force acts at the surface; a late force misleads the choice."""
    found = explained(sliding(1.0), "sensor.delay", "contact.surface_friction")
    assert [c.cause.kind for c in found.causes] == ["sensor.delay"]
    assert found.adequate
    # a stamp that is not known to a row shares it, to a hundredth of a row
    assert found.causes[0].estimates[0].value == pytest.approx(LATE, abs=1e-5)


def test_a_late_sensor_and_a_late_record_are_rivals_where_nothing_shows_what_became_of_the_force() -> (
    None
):
    link = contact_link([effect("sensor.delay", delay=LATE)])
    both = with_other_clock(explained(link, "sensor.delay", "log.skew", "contact.stiffness"))
    assert both.adequate
    assert {*both.kinds, *both.causes[0].rivals} == {"sensor.delay", "log.skew"}
    assert both.causes[0].probability == pytest.approx(0.5, abs=0.1)
    alone = explained(link, "sensor.delay", "contact.stiffness")
    assert (alone.kinds, alone.causes[0].rivals) == (("sensor.delay",), ())
