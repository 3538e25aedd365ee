"""The numerical model against Newton and Euler by another route."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from hiltestbed import load_scenario
from hiltestbed.numerical_model.kernels import TARGET
from hiltestbed.numerical_model.model import NumericalModel
from tests.physics.closed_forms import newton_euler, pair_momentum

SCENARIO = "05-off-centre"


def test_the_start_is_what_approach_says() -> None:
    scenario = load_scenario(SCENARIO)
    craft = NumericalModel([scenario])
    a = scenario.approach
    np.testing.assert_allclose(craft.pose[0, :3], [*a.offset, -a.gap], atol=1e-15)
    np.testing.assert_allclose(craft.twist[0], [*a.velocity, *np.radians(a.rate_deg)], atol=1e-15)
    np.testing.assert_allclose(craft.v[0, TARGET], 0.0)
    attitude = Rotation.from_euler("xyz", a.attitude_deg, degrees=True).as_quat()
    assert abs(attitude @ craft.pose[0, 3:]) == pytest.approx(1.0, abs=1e-15)


def _newton_euler(scenario, wrench, duration):
    """Both bodies under a constant wrench in P at P's origin, by an eighth-order integrator."""
    craft = NumericalModel([scenario])
    bodies = (scenario.spacecraft.chaser, scenario.spacecraft.target)
    port = Rotation.from_euler("xyz", bodies[TARGET].port.attitude_deg, degrees=True)

    def rates(_, y):
        state = y.reshape(2, 13)
        target = Rotation.from_quat(state[TARGET, 3:7])
        force, torque = (target * port).apply(wrench[:3]), (target * port).apply(wrench[3:])
        point = state[TARGET, :3] + target.apply(bodies[TARGET].port.position)
        return newton_euler(bodies, state, force, torque, point)

    start = np.concatenate([craft.q[0], craft.v[0]], axis=1).ravel()
    found = solve_ivp(rates, (0.0, duration), start, method="DOP853", rtol=1e-12, atol=1e-14)
    return found.y[:, -1].reshape(2, 13)


def test_the_step_converges_to_newton_and_euler_in_first_order() -> None:
    wrench, duration, errors = np.array([20.0, -10.0, 100.0, 3.0, 2.0, -4.0]), 0.5, []
    for rate in (1000, 2000, 4000):
        scenario = load_scenario(SCENARIO, set={"rate": rate, "physics_rate": rate})
        craft = NumericalModel([scenario])
        for _ in range(round(duration * rate)):
            craft.advance(wrench[None])
        truth = _newton_euler(scenario, wrench, duration)
        errors.append(
            np.abs(craft.q[0, :, :3] - truth[:, :3]).max() + np.abs(craft.v[0] - truth[:, 7:]).max()
        )
    assert errors[-1] < 2e-5
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.1)
    assert errors[1] / errors[2] == pytest.approx(2.0, abs=0.1)


def test_the_relative_twist_is_the_derivative_of_the_relative_pose() -> None:
    scenario = load_scenario(
        SCENARIO, set={"rate": 100000, "physics_rate": 100000, "duration": 0.01}
    )
    craft = NumericalModel([scenario])
    craft.v[0, TARGET, 3:] = [0.02, -0.03, 0.01]  # P turns: the rate is that of the components in P
    craft.advance(np.zeros((1, 6)))
    before = craft.pose.copy()
    craft.advance(np.zeros((1, 6)))
    slope = (craft.pose[0, :3] - before[0, :3]) * scenario.rate
    np.testing.assert_allclose(slope, craft.twist[0, :3], atol=1e-6)
    turn = Rotation.from_quat(craft.pose[0, 3:]) * Rotation.from_quat(before[0, 3:]).inv()
    np.testing.assert_allclose(turn.as_rotvec() * scenario.rate, craft.twist[0, 3:], atol=1e-6)


def test_no_wrench_changes_the_momentum_of_the_pair() -> None:
    craft = NumericalModel([load_scenario(SCENARIO)])
    before = pair_momentum(craft.mass, craft.inertia, craft.q, craft.v)
    rng = np.random.default_rng(3)
    for _ in range(1000):
        craft.advance(rng.normal(scale=[[30, 30, 300, 5, 5, 5]]))
    after = pair_momentum(craft.mass, craft.inertia, craft.q, craft.v)
    scale = 300.0  # N s: a thousand random steps of 300 N over half a second, and arms of a metre
    assert np.abs(after - before)[0, :3].max() < 1e-12 * scale
    assert np.abs(after - before)[0, 3:].max() < 1e-6 * scale
