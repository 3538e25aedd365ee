"""What effects of the contact do to the force that a plant feels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hiltestbed.platform.plant import Plant
from hiltestbed.scenario import Scenario, scenario_from
from tests.platform.rigs import C, K, Press, pose, scenario


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


def linear(
    x: np.ndarray, v: np.ndarray, k: float = K, c: float = C, extra: Any = 0.0, least: float = 0.0
) -> np.ndarray:
    return np.asarray(np.where(x > 0.0, np.maximum(k * x + c * v + extra, least), 0.0))


def stopped(x: np.ndarray, v: np.ndarray) -> np.ndarray:
    return linear(x, v) + 3.0e5 * np.maximum(x - 1.0e-3, 0.0)


@pytest.mark.parametrize(
    ("kind", "size", "law"),
    [
        ("contact.stiffness", {"factor": 1.3}, lambda x, v: linear(x, v, k=1.3 * K)),
        ("contact.damping", {"factor": 0.4}, lambda x, v: linear(x, v, c=0.4 * C)),
        ("contact.touch_offset", {"offset": 3.0e-4}, lambda x, v: linear(x - 3.0e-4, v)),
        # against the motion; a preload is not
        (
            "contact.dry_friction",
            {"force": 20.0},
            lambda x, v: linear(x, v, extra=20.0 * np.tanh(v / 2e-4)),
        ),
        ("contact.preload", {"force": 15.0}, lambda x, v: linear(x, v, extra=15.0)),
        ("contact.hard_stop", {"position": 1.0e-3, "stiffness": 3.0e5}, stopped),
        # it may pull, no more than its force
        ("contact.adhesion", {"force": 5.0}, lambda x, v: linear(x, v, least=-5.0)),
        # a spring in series: F = k (x - F/k_f) + c v, so that F = (k x + c v)/(1 + k/k_f)
        ("frame.compliance", {"stiffness": 5.0e5}, lambda x, v: linear(x, v) / (1.0 + K / 5.0e5)),
    ],
)
def test_the_force_follows_the_law(
    kind: str, size: dict[str, float], law: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> None:
    x, v, force = pressed({"kind": kind, **size})
    close = 1e-6 if kind == "frame.compliance" else 1e-9
    np.testing.assert_allclose(force, law(x, v), atol=close)
    assert kind != "contact.adhesion" or force.min() < -4.0


def test_surface_friction_takes_the_place_of_the_one_believed() -> None:
    s = with_effect({"kind": "contact.surface_friction", "coefficient": 0.3})
    plant, twist = Plant([s]), np.array([[0.05, 0.0, 0.0, 0.0, 0.0, 0.0]])
    plant.reset(pose(z=1e-3), twist)
    force = plant.wrench_sub[0, -1]
    assert force[0] / force[2] == pytest.approx(0.3, rel=1e-5)


def test_a_tilted_port_pushes_along_its_own_normal() -> None:
    plant = Plant([with_effect({"kind": "contact.misalignment", "angles_deg": [2.0, -3.0]})])
    plant.reset(pose(z=1e-3), np.zeros((1, 6)))
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
    plant.reset(pose(z=1e-3), still)
    goal, force = pose(z=1e-3), []
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
