"""A force that resists motion: closed forms, and an independent integrator of another order."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hiltestbed import Scenario, load_scenario
from hiltestbed.numerical_model.kernels import CHASER, TARGET
from hiltestbed.numerical_model.model import NumericalModel
from hiltestbed.numerical_model.resistance import (
    COULOMB,
    COULOMB_BACK,
    RESISTANCE,
    VISCOUS,
    VISCOUS_BACK,
    resisting,
)
from tests.physics.closed_forms import pair_momentum

HEAVY = {
    "spacecraft.target": {
        "mass": 1e12,
        "inertia": [1e12, 1e12, 1e12],
        "port": {"position": [0, 0, -1.0]},
    }
}


def moving(
    speed: float, mass: float = 100.0, rate: int = 1000, fixed: bool = True, **force: Any
) -> Scenario:
    changes = {
        "effects": [{"kind": "dynamics.force", **force}],
        "spacecraft.chaser.mass": mass,
        "rate": rate,
        "physics_rate": rate,
    }
    return load_scenario(
        "02-bumper", set=changes | {"approach.velocity": [0, 0, speed]} | (HEAVY if fixed else {})
    )


def course(scenario: Scenario, seconds: float, push: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Way [m] and speed [m/s] of A along z after each tick, a force pushing A on."""
    model, start = NumericalModel([scenario]), -scenario.approach.gap
    wrench, out = np.array([[0.0, 0.0, -push, 0.0, 0.0, 0.0]]), []
    for _ in range(round(seconds * scenario.rate)):
        model.advance(wrench)
        out.append((model.pose[0, 2] - start, model.twist[0, 2]))
    way, speed = np.array(out).T
    return way, speed


def test_free_decay_under_viscous_friction_is_exponential() -> None:
    """v = v0 exp(-c t/m), whatever the step."""
    way, speed = course(moving(0.05, viscous=200.0), 1.5)
    t = np.arange(1, len(speed) + 1) * 1e-3
    # the foundation weighs 1e12 kg
    np.testing.assert_allclose(speed, 0.05 * np.exp(-2.0 * t), rtol=1e-9)
    assert way[-1] == pytest.approx(0.05 * 100.0 / 200.0 * (1.0 - np.exp(-3.0)), rel=2e-3)


def test_dry_friction_stops_a_mass_after_m_v2_over_2f() -> None:
    way, speed = course(moving(0.05, coulomb=5.0), 2.0)
    # the pose moves with the speed after a tick
    assert way[-1] == pytest.approx(100.0 * 0.05**2 / (2.0 * 5.0) - 0.5e-3 * 0.05, rel=1e-5)
    assert np.flatnonzero(speed < 1e-3)[0] * 1e-3 == pytest.approx(100.0 * 0.049 / 5.0, abs=2e-3)


@pytest.mark.parametrize("mass", [0.05, 1.0, 100.0])
def test_at_rest_nothing_chatters_however_light_the_mass(mass: float) -> None:
    """A tick of 20 N is 0.4 m/s for 50 g, and 200 N s/m turn its motion four times over."""
    for viscous in (0.0, 200.0):
        _, speed = course(moving(0.05, mass=mass, coulomb=20.0, viscous=viscous), 1.0)
        assert (speed > -1e-12).all()
        assert (np.diff(speed) <= 1e-12).all()
        assert abs(speed[-1]) < 1e-12


def test_below_dry_friction_it_holds_and_above_it_goes() -> None:
    for push in (10.0, -19.99):
        way, speed = course(moving(0.0, coulomb=20.0), 1.0, push=push)
        assert np.abs(speed).max() < 1e-15
        assert np.abs(way).max() < 1e-15
    _, speed = course(moving(0.0, coulomb=20.0, viscous=200.0), 5.0, push=60.0)
    assert speed[-1] == pytest.approx(40.0 / 200.0, rel=1e-3)


def exactly(
    v: float, drive: float, mass: float, viscous: float, dry: float, seconds: float
) -> float:
    """[m/s] after ``seconds`` of a constant force, by Radau's method from stop to stop."""
    while seconds > 0.0:
        if v == 0.0 and abs(drive) <= dry:
            return 0.0
        s = np.sign(v) if v else np.sign(drive)

        def rate(t: float, y: np.ndarray, s: float = s) -> list[float]:
            return [(drive - viscous * y[0] - s * dry) / mass]

        def stands(t: float, y: np.ndarray) -> float:
            return y[0]

        stands.terminal, stands.direction = True, -s  # type: ignore[attr-defined]
        found = solve_ivp(
            rate, (0.0, seconds), [v], method="Radau", rtol=1e-11, atol=1e-14, events=stands
        )
        seconds -= found.t[-1]
        v = 0.0 if found.status == 1 else float(found.y[0, -1])
        if found.status == 0:
            return v
    return v


@pytest.mark.parametrize("drive", [-90.0, -20.0, 15.0, 90.0])
@pytest.mark.parametrize("v", [-2e-4, 0.0, 7e-5, 0.05])
def test_a_tick_in_which_the_motion_stops_or_turns_is_exact(v: float, drive: float) -> None:
    """95 kg against 200 N s/m and 20 N: the force takes it from its speed to the exact one."""
    mass, h = 95.0, 1e-3
    laws = np.zeros((1, RESISTANCE))
    laws[0, [VISCOUS, VISCOUS_BACK]], laws[0, [COULOMB, COULOMB_BACK]] = 200.0, 20.4
    given = resisting(laws, 0, v, v + h / mass * drive, h / mass)
    assert v + h / mass * (drive - given) == pytest.approx(
        exactly(v, drive, mass, 200.0, 20.4, h), rel=1e-7, abs=1e-11
    )


def test_each_direction_has_its_own_friction() -> None:
    force: dict[str, Any] = {
        "viscous": 250.0,
        "viscous_asymmetry": 0.6,
        "coulomb": 5.0,
        "coulomb_back": 15.0,
        "offset": 2.0,
    }
    _, forward = course(moving(0.0, **force), 8.0, push=30.0)
    _, back = course(moving(0.0, **force), 8.0, push=-30.0)
    assert forward[-1] == pytest.approx((30.0 - 2.0 - 5.0) / 100.0, rel=2e-3)
    assert back[-1] == pytest.approx((-30.0 - 2.0 + 15.0) / 400.0, rel=2e-3)


def test_it_converges_to_an_independent_integration_with_its_stribeck_dip() -> None:
    """Against Radau of the same law, at three rates: the error falls with the step."""
    law: dict[str, Any] = {
        "viscous": 150.0,
        "coulomb": 12.0,
        "static": 18.0,
        "stribeck_speed": 0.01,
        "offset": 1.5,
    }

    def rates(t: float, y: np.ndarray) -> list[float]:
        dry = 12.0 + 6.0 * np.exp(-((y[1] / 0.01) ** 2))
        return [y[1], (25.0 - 1.5 - 150.0 * y[1] - dry) / 100.0]  # it never stands

    exact = solve_ivp(rates, (0.0, 1.0), [0.0, 0.04], method="Radau", rtol=1e-10, atol=1e-13).y[
        :, -1
    ]
    errors = []
    for rate in (500, 1000, 2000):
        way, speed = course(moving(0.04, rate=rate, **law), 1.0, push=25.0)
        errors.append(max(abs(way[-1] - exact[0]), abs(speed[-1] - exact[1])))
    assert errors[0] < 2e-4
    assert errors[1] < 0.6 * errors[0]
    assert errors[2] < 0.6 * errors[1]


def test_between_the_bodies_it_keeps_their_momentum_off_centre_too() -> None:
    effects = [
        {"kind": "dynamics.force", "viscous": 300.0, "coulomb": 1.0, "offset": 0.5, "axis": a}
        for a in "xyz"
    ]
    scenario = load_scenario("05-off-centre", set={"effects": effects})
    model = NumericalModel([scenario])
    before = pair_momentum(model.mass, model.inertia[0], model.q[0], model.v[0])
    for _ in range(500):
        model.advance(np.zeros((1, 6)))
    after = pair_momentum(model.mass, model.inertia[0], model.q[0], model.v[0])
    np.testing.assert_allclose(
        after.ravel()[:3], before.ravel()[:3], atol=1e-12 * np.abs(before).max()
    )
    np.testing.assert_allclose(after.ravel()[3:], before.ravel()[3:], rtol=2e-4, atol=2e-3)
    assert np.linalg.norm(model.twist[0, :3]) < 0.9 * np.linalg.norm(scenario.approach.velocity)


def test_on_one_body_it_acts_in_inertial_space_and_leaves_the_other() -> None:
    scenario = moving(0.05, fixed=False, viscous=300.0, body="chaser")
    model = NumericalModel([scenario])
    for _ in range(1000):
        model.advance(np.zeros((1, 6)))
    assert model.v[0, CHASER, 2] == pytest.approx(0.05 * np.exp(-3.0), rel=5e-3)
    assert not model.v[0, TARGET].any()
