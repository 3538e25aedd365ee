"""The second rig's compensation methods against what they promise of forces and motions in closed
form.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from tests.equipment.independent_rig.compensation import (
    ENERGY,
    METHODS,
    Compensator,
    Memory,
    drive,
    memory,
)

H, DELAY = 1e-3, 0.004
LEAD = Compensator(DELAY + 5e-4, 5e-4, delay=DELAY)


def _drive(
    comp: Compensator,
    force: Callable[[np.ndarray], np.ndarray],
    pose: Callable[[np.ndarray], np.ndarray] | None = None,
    ticks: int = 400,
    model_twist: np.ndarray | None = None,
    latched: bool = False,
) -> tuple[np.ndarray, np.ndarray, Memory]:
    """What a method makes of the axial force of time, beside the axial position of time: t, (ticks,
    6), and what it remembers.
    """
    t = np.arange(ticks) * H
    keep, out, found = memory(comp, H), np.zeros(6), np.zeros((ticks, 6))
    z = np.zeros(ticks) if pose is None else pose(t)
    f = force(t)
    for k in range(ticks):
        at, twist = np.array([0.01, -0.02, z[k], 0.0, 0.0, 0.0, 1.0]), np.zeros(6)
        twist[2] = (z[k] - z[k - 1]) / H if k else 0.0
        reading = np.array([0.0, 0.0, f[k], at[1] * f[k], -at[0] * f[k], 0.0])
        drive(
            comp,
            k,
            reading,
            at,
            twist,
            twist if model_twist is None else model_twist,
            latched,
            H,
            keep,
            out,
        )
        found[k] = out
    return t, found, keep


def _late(shape: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    return lambda t: shape(t - DELAY)


def test_no_compensation_hands_the_force_on() -> None:
    t, out, _ = _drive(LEAD._replace(method=METHODS["none"]), np.sin)
    np.testing.assert_array_equal(out[:, 2], np.sin(t))


def test_the_first_order_lead_makes_up_for_the_delay_of_a_ramp() -> None:
    t, out, _ = _drive(LEAD._replace(method=METHODS["phase_lead"]), _late(lambda t: 50.0 * t))
    np.testing.assert_allclose(out[100:, 2], 50.0 * t[100:], rtol=1e-9)


def test_the_second_order_lead_makes_up_for_the_delay_of_a_parabola() -> None:
    t, out, _ = _drive(
        LEAD._replace(method=METHODS["second_order_lead"]), _late(lambda t: 50.0 * t**2)
    )
    error = out[100:, 2] - 50.0 * t[100:] ** 2
    # Backward differences are late by half a tick each: what is left does not grow with time, and
    # is of first order in the tick.
    assert np.ptp(error) < 1e-9 + 1e-3 * 50.0 * (t[-1] - t[100])
    assert np.abs(error).max() < 50.0 * 2.0 * DELAY * H


@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_polynomial_makes_up_for_the_delay_of_a_power_of_its_order(order: int) -> None:
    t, out, _ = _drive(
        LEAD._replace(method=METHODS["polynomial"], order=order),
        _late(lambda t: (10.0 * t) ** order),
    )
    np.testing.assert_allclose(out[50:, 2], (10.0 * t[50:]) ** order, rtol=1e-9)


def test_a_dead_zone_takes_small_forces_and_the_torques_with_them() -> None:
    comp = LEAD._replace(method=METHODS["dead_zone"], width=1.0)
    keep, out = memory(comp, H), np.zeros(6)
    drive(
        comp,
        0,
        np.array([0.5, -2.0, 0.9, 0.1, 0.2, 0.3]),
        np.zeros(7),
        np.zeros(6),
        np.zeros(6),
        False,
        H,
        keep,
        out,
    )
    np.testing.assert_array_equal(out, [0.0, -2.0, 0.0, 0.1, 0.2, 0.3])
    drive(
        comp,
        1,
        np.array([0.5, -0.2, 0.9, 0.1, 0.2, 0.3]),
        np.zeros(7),
        np.zeros(6),
        np.zeros(6),
        False,
        H,
        keep,
        out,
    )
    np.testing.assert_array_equal(out, np.zeros(6))


def _bounce(t: np.ndarray) -> np.ndarray:
    return 1e-3 * np.sin(2.0 * math.pi * 4.0 * (t - 0.05)) * ((t > 0.05) & (t < 0.175))


def _spring(t: np.ndarray, stiffness: float = 5e4, damping: float = 100.0) -> np.ndarray:
    z, before = _bounce(t), _bounce(t - H)
    return np.where(z > 0.0, np.maximum(stiffness * z + damping * (z - before) / H, 0.0), 0.0)


@pytest.mark.parametrize("lead_rest", [False, True])
def test_a_smith_predictor_that_knows_the_contact_gives_its_force_without_delay(
    lead_rest: bool,
) -> None:
    comp = LEAD._replace(
        method=METHODS["smith_predictor"], stiffness=5e4, damping=100.0, lead_rest=lead_rest
    )
    t, out, _ = _drive(comp, _late(_spring), _bounce)
    np.testing.assert_allclose(out[:, 2], _spring(t), atol=1e-9)
    assert np.abs(out[:, 3] + 0.02 * out[:, 2]).max() < 1e-9  # at A, which lies beside P's axis


def test_a_virtual_contact_is_a_spring_and_damper_beside_the_force() -> None:
    t, out, _ = _drive(
        LEAD._replace(method=METHODS["virtual_contact"], stiffness=2e3, damping=50.0),
        lambda t: 0.0 * t,
        _bounce,
    )
    z, before = _bounce(t), np.append(0.0, _bounce(t)[:-1])
    np.testing.assert_allclose(
        out[:, 2], np.where(z > 0.0, 2e3 * z + 50.0 * (z - before) / H, 0.0), atol=1e-9
    )


def test_passivity_control_lets_the_contact_give_no_more_than_it_took() -> None:
    comp = LEAD._replace(method=METHODS["passivity_control"], inverse_mass=1.0 / 400.0)
    twist = np.array([0.0, 0.0, -0.02, 0.0, 0.0, 0.0])
    _, out, keep = _drive(comp, lambda t: np.where(t < 0.1, -50.0, 50.0), model_twist=twist)
    np.testing.assert_allclose(out[:100, 2], -50.0, atol=1e-9)  # it takes energy: nothing is added
    assert keep.tally[ENERGY] > -1e-9
    taken = np.cumsum(out[:, 2] * twist[2] * H)
    assert taken.min() > -1e-9


def test_reconstruction_identifies_the_contact_and_gives_its_force_without_delay() -> None:
    comp = LEAD._replace(method=METHODS["reconstruction"], threshold=1.0)
    t, out, keep = _drive(comp, _late(_spring), _bounce)
    np.testing.assert_allclose(keep.found[2], [5e4, 100.0], rtol=1e-6)
    assert np.isnan(keep.found[0, 0])  # an axis that nothing moves
    inside = (t > 0.09) & (t < 0.16)
    np.testing.assert_allclose(out[inside, 2], _spring(t)[inside], rtol=1e-6)


def test_the_dead_zone_of_the_loop_comes_before_the_method() -> None:
    comp = LEAD._replace(method=METHODS["polynomial"], deadzone=5.0, order=1)
    _, out, _ = _drive(comp, lambda t: 0.0 * t + 4.0)
    assert not out[:, :3].any()
    assert out[:, 3:5].any()  # torques have none
