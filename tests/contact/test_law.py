"""The force law of one contact, row by row, against closed forms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from hiltestbed.contact.law import STATES, contact_force
from hiltestbed.contact.parameters import PARAMETERS, ContactParameters
from hiltestbed.contact.wrench import LATCH_RADIUS, latch_wrench
from hiltestbed.effects import EFFECTS
from hiltestbed.frames import Array

# [m] up to 10 mm and back to 4 mm, 10 um apart; [m/s] the rate
TURN, RATE = (
    np.concatenate([np.linspace(0, 10e-3, 1001)[1:], np.linspace(10e-3, 4e-3, 601)[1:]]),
    np.full(1600, 0.1),
)


PLAY = {"contact.backlash": {"width": 2e-3}}


def law(
    effects: dict[str, dict[str, Any]],
    x: Array,
    v: Array,
    k: float = 1e5,
    c: float = 0.0,
    held: bool = False,
) -> Array:
    """(N,) forces at penetrations x [m] and rates v [m/s], 0.1 ms apart."""
    row = (
        ContactParameters(k, c)
        .with_effects([EFFECTS[kind].hypothesis({}, **p) for kind, p in effects.items()])
        .row()
    )
    assert row.shape == (PARAMETERS,)
    state = np.zeros(STATES)
    return np.array(
        [contact_force(a, b, 1e-4, row, state, held) for a, b in zip(x, v, strict=True)]
    )


def friction(force: float, stiffness: float) -> dict[str, dict[str, Any]]:
    return {"contact.dry_friction": {"force": force, "stiffness": stiffness}}


def test_a_maxwell_branch_relaxes_with_its_time_constant() -> None:
    t = np.arange(1, 4001) * 1e-4
    ramp = np.minimum(t, 0.1) * 0.01
    branch = {"contact.relaxation": {"stiffness": 5e4, "time_constant": 0.05}}
    got = law(branch, ramp, np.where(t <= 0.1, 0.01, 0.0)) - 1e5 * ramp
    peak = 5e4 * 0.01 * 0.05 * (1 - math.exp(-0.1 / 0.05))
    assert got[999] == pytest.approx(peak, rel=1e-9)
    assert got[-1] == pytest.approx(peak * math.exp(-0.3 / 0.05), rel=1e-9)


def test_friction_that_gives_before_it_slips_turns_round_in_twice_its_stretch() -> None:
    """The spring of 1e6 N/m holds 500 N after 0.5 mm, and -500 N 1 mm after the turn."""
    got = law(friction(500.0, 1e6), TURN, RATE, k=0.0, held=True)
    up, back = np.minimum(1e6 * TURN, 500.0), np.maximum(500.0 - 1e6 * (10e-3 - TURN), -500.0)
    expected = np.where(np.arange(1600) < 1000, up, back)
    np.testing.assert_allclose(got, expected, atol=1e-6)


def test_play_before_a_slider_travels_with_it() -> None:
    """2 mm of play: after the turn at 10 mm the force falls to nothing in 0.5 mm, stays there for 2
    mm, and grows the other way.
    """
    got = law(friction(500.0, 1e6) | PLAY, TURN, RATE, k=0.0, held=True)
    back = 10e-3 - TURN[1000:]
    let, take = np.maximum(500.0 - 1e6 * back, 0.0), np.maximum(-1e6 * (back - 2.5e-3), -500.0)
    expected = np.where(back < 2.5e-3, let, take)
    np.testing.assert_allclose(got[1000:], expected, atol=1e-6)
    assert np.all(got[:90] == 0.0)
    assert got[999] == pytest.approx(500.0)


def test_a_slow_push_on_a_frame_with_a_mode_meets_its_static_stiffness() -> None:
    t = np.arange(1, 20001) * 1e-4
    mode = {"frequency": 20.0, "damping_ratio": 0.3, "mass": 40.0}
    force = law({"frame.mode": mode}, 1e-3 * np.minimum(t, 1.0), np.where(t <= 1.0, 1e-3, 0.0))
    frame = 40.0 * (2 * math.pi * 20.0) ** 2
    assert force[-1] == pytest.approx(1e-3 * 1e5 * frame / (1e5 + frame), rel=1e-4)


def test_a_table_with_a_kink_is_a_hard_stop() -> None:
    x = np.linspace(1e-5, 3e-3, 300)
    table = ((0.0, 0.0), (1e-3, 0.0), (2e-3, 400.0))
    curve = {"contact.map": {"penetration": table}}
    stop = {"contact.hard_stop": {"position": 1e-3, "stiffness": 4e5}}
    got, expected = (law(e, x, np.zeros(300), c=300.0) for e in (curve, stop))
    np.testing.assert_allclose(got, expected, rtol=1e-12)


def test_a_straight_line_over_the_rate_is_a_damper_and_a_part_of_the_spring_that_grows_with_it_hunt_crossley() -> (
    None
):
    x, v = np.linspace(1e-4, 3e-3, 100), np.linspace(0.05, -0.05, 100)
    damper = law({"contact.map": {"rate": ((-0.1, -40.0), (0.1, 40.0))}}, x, v)
    np.testing.assert_allclose(damper, law({}, x, v, c=400.0), rtol=1e-9)
    grown = law({"contact.map": {"spring_rate": ((-0.1, -0.3), (0.1, 0.3))}}, x, v)
    np.testing.assert_allclose(
        grown, law({"contact.hunt_crossley": {"alpha": 3.0}}, x, v), rtol=1e-9
    )
    softer = law({"contact.map": {"spring": ((0.0, -0.2), (1.0, -0.2))}}, x, v)
    np.testing.assert_allclose(softer, law({"contact.stiffness": {"factor": 0.8}}, x, v), rtol=1e-9)


@pytest.mark.parametrize("held", [True, False])
def test_a_straight_line_over_the_stretch_is_friction_that_gives_before_it_slips(
    held: bool,
) -> None:
    curve = {"contact.map": {"stretch": ((-5e-4, -500.0), (5e-4, 500.0))}}
    got, expected = (law(e, TURN, RATE, held=held) for e in (curve, friction(500.0, 1e6)))
    np.testing.assert_allclose(got, expected, atol=1e-6)


def test_a_dead_zone_in_the_curve_over_the_stretch_is_play_that_travels_with_the_slider() -> None:
    table = ((-1.5e-3, -500.0), (-1e-3, 0.0), (1e-3, 0.0), (1.5e-3, 500.0))
    got = law({"contact.map": {"stretch": table}}, TURN, RATE, k=0.0, held=True)
    play = law(friction(500.0, 1e6) | PLAY, TURN, RATE, k=0.0, held=True)
    np.testing.assert_allclose(got, play, atol=1e-6)


HALF = 1e-3  # [-] of the turn of a latch
TURNED = HALF, -HALF, 2 * HALF, math.sqrt(1.0 - 6 * HALF**2)


def exerted(parameters: ContactParameters, place: tuple, twist: tuple) -> Array:
    """(6,) wrench of a latch that holds the origin, at a pose (7,) and twist (6,)."""
    out, hold = np.empty(6), np.array([0.0, 0, 0, 0, 0, 0, 1])
    seen = np.array(place), np.array(twist), hold, np.zeros(STATES), np.empty((4, 7))
    latch_wrench(parameters.row(), 1e-4, *seen, out)
    return out


def test_a_latch_that_turns_freely_bears_forces_alone() -> None:
    twist = 0.0, 0.0, 0.02, 0.1, 0.2, 0.3
    bound, free = (
        exerted(ContactParameters(1e5, 900.0, ring=ring), (0.0, 0.0, 0.0, *TURNED), twist)
        for ring in (1.0, 0.0)
    )
    turn = 2.0 * math.asin(math.sqrt(6.0) * HALF) / math.sqrt(6.0) * np.array([1.0, -1.0, 2.0])
    expected = LATCH_RADIUS**2 * (1e5 * turn + 900.0 * np.array(twist[3:]))
    np.testing.assert_allclose(bound[3:], expected, rtol=1e-9)
    np.testing.assert_array_equal(free, [0.0, 0.0, 900.0 * 0.02, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("variant", [{}, {"damper": "in series"}, {"damper": "whole rate"}])
def test_a_frame_gives_way_along_the_insertion_alone(variant: dict[str, str]) -> None:
    """Forces across and moments are those of a rigid frame, however its damper is read."""
    stiffness, frame = 1e5, 4e5
    rigid = ContactParameters(stiffness, 900.0)
    gives = ContactParameters(stiffness, 900.0).with_effects(
        [EFFECTS["frame.compliance"].hypothesis(variant, stiffness=frame)]
    )
    across = (2e-3, -1e-3, 0.0, *TURNED), (0.01, 0.02, 0.0, 0.1, 0.2, 0.3)
    along = (0.0, 0.0, 1e-3, 0.0, 0.0, 0.0, 1.0), (0.0,) * 6
    np.testing.assert_allclose(exerted(gives, *across), exerted(rigid, *across), rtol=1e-12)
    assert exerted(gives, *along)[2] == pytest.approx(
        stiffness * frame / (stiffness + frame) * 1e-3, rel=1e-9
    )
