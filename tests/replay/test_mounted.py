"""A mount along a recorded path by a leapfrog: against the matrix exponential, and against MuJoCo's
steps, extrapolated to no length.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from hiltestbed.contact.mount_dynamics import MountDynamics
from hiltestbed.frames import Array
from hiltestbed.replay import Felt, replay_wrench
from hiltestbed.replay.mounted import LAST, PathMount, advance, struck
from hiltestbed.scenario import Scenario
from tests.replay.recorded import felt, lane, record, scenario

STIFFNESS, DAMPING = (
    np.array([2e5, 3e5, 1e5, 2e4, 1e4, 3e4]),
    np.array([2000.0, 1000.0, 3000.0, 200.0, 100.0, 300.0]),
)
MASS = 80.0
BODY = np.concatenate([[MASS], np.zeros(3), np.diag([5.0, 6.0, 3.0]).ravel()])
INERTIA = np.array([MASS, MASS, MASS, 5.0, 6.0, 3.0])


def mount(
    stiffness: Array = STIFFNESS, damping: Array = DAMPING, leapfrog: bool = True
) -> PathMount:
    dynamics = MountDynamics(stiffness[None], damping[None], BODY)
    return PathMount(stiffness, damping, BODY, leapfrog, dynamics.mobility)


def pushed(steps: int, time: float, leapfrog: bool) -> tuple[Array, Array]:
    """Deflection and rate after ``time`` [s] under a wrench too small to turn the axes."""
    q, qd, rate, last = np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(LAST)
    for _ in range(steps):
        advance(mount(leapfrog=leapfrog), time / steps, np.full(6, 1e-3), q, qd, rate, last)
    return q, rate


def test_a_leapfrog_is_of_second_order_where_mujocos_steps_are_of_first() -> None:
    """x(t) of M x'' + C x' + K x = f by the matrix exponential of each axis: half the steps, a
    quarter of the error, instead of half.
    """
    time, true = 0.02, np.empty((2, 6))
    for j in range(6):
        a = np.array(
            [
                [0.0, 1.0, 0.0],
                [-STIFFNESS[j] / INERTIA[j], -DAMPING[j] / INERTIA[j], 1e-3 / INERTIA[j]],
                [0.0, 0.0, 0.0],
            ]
        )
        true[:, j] = (expm(a * time) @ [0.0, 0.0, 1.0])[:2]
    for leapfrog, order in ((True, 2), (False, 1)):
        coarse, fine = (np.abs(np.array(pushed(n, time, leapfrog)) - true) for n in (400, 800))
        np.testing.assert_allclose(coarse / fine, 2.0**order, rtol=0.1)


def test_the_slowest_swing_of_separate_axes_is_that_of_each_alone() -> None:
    """Weakly damped, x'' + (c/m) x' + (k/m) x = 0 falls by exp(-c t/(2 m)); axes are separate where
    the centre of mass is the origin.
    """
    assert MountDynamics(STIFFNESS[None], DAMPING[None], BODY).slowest() == pytest.approx(
        2.0 * np.max(INERTIA / DAMPING), rel=1e-9
    )
    assert MountDynamics(STIFFNESS[None], np.zeros((1, 6)), BODY).slowest() > 1e6


@pytest.mark.parametrize("part", [0.1, 0.5, 0.9])
def test_a_force_that_begins_within_a_step_acts_for_the_part_that_is_left(part: float) -> None:
    """F/m times the time since it began, at the end of that step and of the next."""
    dt, free = 1e-3, mount(np.zeros(6), np.zeros(6))
    force = np.array([0.0, 0.0, 7.0, 0.0, 0.0, 0.0])
    q, qd, rate, last = np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(LAST)
    for _ in range(3):
        advance(free, dt, np.zeros(6), q, qd, rate, last)
    struck(free, dt, part, force, np.zeros(6), q, qd, rate)
    np.testing.assert_allclose(rate[2], 7.0 / MASS * part * dt, rtol=1e-12)
    advance(free, dt, force, q, qd, rate, last)
    np.testing.assert_allclose(rate[2], 7.0 / MASS * (part + 1.0) * dt, rtol=1e-12)


def refined(shared: Felt, s: Scenario) -> tuple[Callable[..., Array], Array]:
    """The reading with so many times the steps, and with steps of no length."""

    def stepped(times: int, leapfrog: bool = False) -> Array:
        finer = replace(shared, substeps=times * s.substeps, leapfrog=leapfrog)
        return replay_wrench(finer, [lane(s, 0)], grid=s.substeps)[0]

    fine, finest = stepped(64), stepped(256)
    return stepped, finest + (finest - fine) / 3.0


@pytest.mark.parametrize(
    ("rig", "tracking"),
    [
        ("bumper on a mount", "ideal"),
        ("bumper on a mount", "servo"),
        ("probe and cone with latch on a mount", "servo"),
        ("latched on a mount", "servo"),
    ],
)
def test_along_a_path_with_touches_friction_and_a_latch_it_misses_a_seventh_of_what_mujocos_steps_miss(
    rig: str, tracking: str
) -> None:
    """Where forces jump (at a touch, as a latch closes, with the command's rate at each tick) a
    plain leapfrog would be of first order.
    """
    recorded = record([scenario(rig, tracking)])
    stepped, true = refined(felt(recorded), recorded.scenarios[0])
    missed = float(np.abs(stepped(1) - true).max())
    assert float(np.abs(stepped(1, leapfrog=True) - true).max()) < 0.15 * missed
    assert float(np.abs(stepped(4, leapfrog=True) - true).max()) < 0.04 * missed


def test_a_record_that_begins_in_contact_begins_with_half_a_kick() -> None:
    """The force acts from the first row on, on a mount that is at rest there."""
    recorded = record([scenario("bumper on a mount")])
    whole, s = felt(recorded), recorded.scenarios[0]
    start = int(np.argmax(recorded["wrench_meas"][0, :, 2] > 100.0))
    shared = replace(whole, poses=whole.poses[:, start:], before=whole.poses[:, start - 1])
    stepped, true = refined(shared, s)
    assert np.abs(stepped(1, leapfrog=True) - true).max() < 0.05 * np.abs(stepped(1) - true).max()


def test_a_stuck_contact_follows_where_friction_is_stiffer_than_a_step_can_take() -> None:
    """0.9 of the normal force over the creep of friction, 1e-4 m/s, is 2e6 N s/m here: explicit
    steps of a whole tick would diverge.
    """
    recorded = record([scenario("bumper on a mount", changes={"mechanism.contact.friction": 0.9})])
    shared, s = felt(recorded), recorded.scenarios[0]
    coarse = replace(shared, substeps=1, leapfrog=True)
    true, found = (
        replay_wrench(f, [lane(s, 0)], grid=n)[0]
        for f, n in ((replace(shared, substeps=256), 256), (coarse, 1))
    )
    assert np.abs(found - true).max() < 0.01 * np.abs(true).max()
