"""What effects of the contact do to the force that a plant feels."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hiltestbed.platform.plant import Plant
from hiltestbed.scenario import Scenario, scenario_from
from tests.platform.rigs import C, K, Press, scenario


def with_effect(effect: dict[str, Any], **more: Any) -> Scenario:
    return scenario_from(scenario("ideal", **more).model_dump(mode="json") | {"effects": [effect]})


def pressed(effect: dict[str, Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Depth, rate and force of a bumper that is pressed in by 2 mm and drawn out at 2.5 Hz, but for
    the instants at which x = 0.
    """
    s = with_effect(effect)
    depth, rate, wrench = Press(Plant([s]), s.rate).run(800).columns()
    assert wrench[:, 2].max() > 50.0
    apart_or_in = np.abs(depth) > 1e-12
    return depth[apart_or_in], rate[apart_or_in], wrench[apart_or_in, 2]


def linear(x: np.ndarray, v: np.ndarray) -> np.ndarray:
    return np.asarray(np.where(x > 0.0, np.maximum(K * x + C * v, 0.0), 0.0))


def test_stiffness_and_damping_are_multiplied() -> None:
    x, v, force = pressed({"kind": "contact.stiffness", "factor": 1.3})
    np.testing.assert_allclose(
        force, np.where(x > 0.0, np.maximum(1.3 * K * x + C * v, 0.0), 0.0), atol=1e-9
    )
    x, v, force = pressed({"kind": "contact.damping", "factor": 0.4})
    np.testing.assert_allclose(
        force, np.where(x > 0.0, np.maximum(K * x + 0.4 * C * v, 0.0), 0.0), atol=1e-9
    )


def test_a_touch_that_is_off_shifts_the_law() -> None:
    x, v, force = pressed({"kind": "contact.touch_offset", "offset": 3.0e-4})
    np.testing.assert_allclose(force, linear(x - 3.0e-4, v), atol=1e-9)


def test_dry_friction_opposes_the_motion_and_a_preload_does_not() -> None:
    x, v, force = pressed({"kind": "contact.dry_friction", "force": 20.0})
    expected = np.where(x > 0.0, np.maximum(K * x + C * v + 20.0 * np.tanh(v / 2e-4), 0.0), 0.0)
    np.testing.assert_allclose(force, expected, atol=1e-9)
    x, v, force = pressed({"kind": "contact.preload", "force": 15.0})
    np.testing.assert_allclose(
        force, np.where(x > 0.0, np.maximum(K * x + C * v + 15.0, 0.0), 0.0), atol=1e-9
    )


def test_a_hard_stop_is_a_second_spring() -> None:
    x, v, force = pressed({"kind": "contact.hard_stop", "position": 1.0e-3, "stiffness": 3.0e5})
    np.testing.assert_allclose(force, linear(x, v) + 3.0e5 * np.maximum(x - 1.0e-3, 0.0), atol=1e-9)


def test_adhesion_lets_the_contact_pull_no_more_than_its_force() -> None:
    x, v, force = pressed({"kind": "contact.adhesion", "force": 5.0})
    np.testing.assert_allclose(
        force, np.where(x > 0.0, np.maximum(K * x + C * v, -5.0), 0.0), atol=1e-9
    )
    assert force.min() < -4.0


def test_a_frame_that_gives_is_a_spring_in_series() -> None:
    """F = k (x - F/k_f) + c v, so that F = (k x + c v)/(1 + k/k_f)."""
    x, v, force = pressed({"kind": "frame.compliance", "stiffness": 5.0e5})
    np.testing.assert_allclose(force, linear(x, v) / (1.0 + K / 5.0e5), atol=1e-6)


def test_a_held_relaxation_fades_with_its_time_constant() -> None:
    """A Maxwell branch that was drawn out fast keeps k_b x exp(-t/T)."""
    s = with_effect(
        {"kind": "contact.relaxation", "stiffness": 4.0e4, "time_constant": 0.05}, damping=0.0
    )
    plant, still = Plant([s]), np.zeros((1, 6))
    plant.reset(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]), still)
    goal = np.array([[0.0, 0.0, 1e-3, 0.0, 0.0, 0.0, 1.0]])
    extra = []
    for _ in range(400):
        plant.advance(goal, still, still)
        extra.append(plant.wrench_sub[0, -1, 2] - K * 1e-3)
    fade = np.exp(-np.arange(400) * s.tick / 0.05)
    np.testing.assert_allclose(extra, extra[0] * fade, rtol=1e-9)
    assert extra[0] == pytest.approx(40.0, rel=0.02)


def test_surface_friction_takes_the_place_of_the_one_believed() -> None:
    s = with_effect({"kind": "contact.surface_friction", "coefficient": 0.3})
    plant, twist = Plant([s]), np.array([[0.05, 0.0, 0.0, 0.0, 0.0, 0.0]])
    plant.reset(np.array([[0.0, 0.0, 1e-3, 0.0, 0.0, 0.0, 1.0]]), twist)
    force = plant.wrench_sub[0, -1]
    assert force[0] / force[2] == pytest.approx(0.3, rel=1e-5)


def test_a_tilted_port_pushes_along_its_own_normal() -> None:
    plant = Plant([with_effect({"kind": "contact.misalignment", "angles_deg": [2.0, -3.0]})])
    plant.reset(np.array([[0.0, 0.0, 1e-3, 0.0, 0.0, 0.0, 1.0]]), np.zeros((1, 6)))
    force = plant.wrench_sub[0, -1, :3]
    normal = np.array(
        [np.sin(np.radians(-3.0)) * np.cos(np.radians(2.0)), -np.sin(np.radians(2.0)), 0.0]
    )
    np.testing.assert_allclose(force[:2] / np.linalg.norm(force), normal[:2], atol=1e-9)


def test_a_frame_that_rings_moves_at_its_own_frequency() -> None:
    """Struck by 1 mm that stays, an undamped frame swings about its rest at sqrt(w^2 + k/m)."""
    s = with_effect(
        {"kind": "frame.mode", "frequency": 20.0, "damping_ratio": 1e-4, "mass": 80.0}, damping=0.0
    )
    plant, still = Plant([s]), np.zeros((1, 6))
    plant.reset(np.array([[0.0, 0.0, 1e-3, 0.0, 0.0, 0.0, 1.0]]), still)
    goal, force = np.array([[0.0, 0.0, 1e-3, 0.0, 0.0, 0.0, 1.0]]), []
    for _ in range(2000):
        plant.advance(goal, still, still)
        force.append(plant.wrench_sub[0, -1, 2])
    swing = np.array(force) - np.mean(force)
    up = np.flatnonzero((swing[:-1] < 0.0) & (swing[1:] >= 0.0))
    at = [k + swing[k] / (swing[k] - swing[k + 1]) for k in up]
    found = (len(at) - 1) / ((at[-1] - at[0]) * s.tick)
    assert found == pytest.approx(
        np.sqrt((2.0 * np.pi * 20.0) ** 2 + K / 80.0) / (2.0 * np.pi), rel=2e-3
    )
