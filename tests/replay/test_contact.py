"""What the plant feels under an effect of the contact is what the effect's own record says it should."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hiltestbed.effects.access import effects_of
from hiltestbed.contact.law import contact_parameters, replay_contact
from hiltestbed.platform.plant import Plant
from hiltestbed.scenario import Scenario, scenario_from
from tests.rig.rigs import C, K, scenario

EFFECTS: list[dict[str, Any]] = [
    {"kind": "contact.stiffness", "factor": 1.3},
    {"kind": "contact.power_law", "exponent": 1.5, "stiffness": 3.0e6},
    {"kind": "contact.hunt_crossley", "alpha": 3.0},
    {"kind": "contact.dry_friction", "force": 20.0},
    {"kind": "contact.preload", "force": 15.0},
    {"kind": "contact.hard_stop", "position": 1.0e-3, "stiffness": 3.0e5},
    {"kind": "contact.relaxation", "stiffness": 4.0e4, "time_constant": 0.02},
    {"kind": "contact.adhesion", "force": 30.0},
    {"kind": "contact.surface_friction", "coefficient": 0.3},
    {"kind": "contact.touch_offset", "offset": -3.0e-4},
    {"kind": "contact.touch_offset", "offset": 3.0e-4},
    {"kind": "frame.compliance", "stiffness": 5.0e6},
    {"kind": "frame.mode", "frequency": 60.0, "damping_ratio": 0.02, "mass": 80.0},
]


def with_effect(effect: dict[str, Any], tracking: str = "ideal", **more: Any) -> Scenario:
    base = scenario(tracking, **more).model_dump(mode="json")
    return scenario_from(base | {"effects": [effect], "approach": base["approach"] | {"gap": 2e-3}})


def press(plant: Plant, ticks: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """In and out at 2.5 Hz, no touch on a tick, drifting sideways: positions (N, 3), the one before, wrenches (N, m, 6)."""
    h, w = 1.0 / 2000.0, 2.0 * np.pi * 2.5
    at = [np.array([0.01 * k * h, 0.0, 1.3e-5 - 2e-3 * np.cos(w * k * h)]) for k in range(-1, ticks)]
    start = np.array([[*at[1], 0.0, 0.0, 0.0, 1.0]])
    plant.reset(start, np.concatenate([(at[1] - at[0]) / h, np.zeros(3)])[None])
    wrench = [plant.wrench_sub[0].copy()]
    for p in at[2:]:
        plant.advance(np.array([[*p, 0.0, 0.0, 0.0, 1.0]]), np.zeros((1, 6)), np.zeros((1, 6)))
        wrench.append(plant.wrench_sub[0].copy())
    return np.array(at[1:]), at[0], np.array(wrench)


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e["kind"])
def test_the_plant_feels_what_the_record_of_the_effect_says(effect: dict[str, Any]) -> None:
    """Two implementations of one law, one inside the loop and one over a record: equal to round-off."""
    s = with_effect(effect)
    position, before, felt = press(Plant([s]), 700)
    parameters = contact_parameters(K, C, 0.0, False, effects_of(s, "contact"))
    replayed = np.zeros_like(felt)
    replay_contact(position, before, s.tick, np.arange(1, s.substeps + 1) / s.substeps, parameters, replayed)
    assert np.abs(replayed).max() > 50.0
    np.testing.assert_allclose(felt[1:], replayed[1:], atol=1e-6 * np.abs(replayed).max())


def test_without_the_effect_the_record_is_another() -> None:
    """The comparison above could fail: a stiffness of 1.3 times shows as 30 % of the force."""
    s = with_effect({"kind": "contact.stiffness", "factor": 1.3})
    position, before, felt = press(Plant([s]), 700)
    nominal = np.zeros_like(felt)
    replay_contact(position, before, s.tick, np.arange(1, s.substeps + 1) / s.substeps, contact_parameters(K, C, 0.0, False, []), nominal)
    assert np.abs(felt - nominal).max() > 0.2 * np.abs(nominal).max()


def test_a_tilted_port_pushes_along_its_own_normal() -> None:
    s = with_effect({"kind": "contact.misalignment", "angles_deg": [2.0, -3.0]})
    plant = Plant([s])
    plant.reset(np.array([[0.0, 0.0, 1e-3, 0.0, 0.0, 0.0, 1.0]]), np.zeros((1, 6)))
    force = plant.wrench_sub[0, -1, :3]
    normal = np.array([np.sin(np.radians(-3.0)) * np.cos(np.radians(2.0)), -np.sin(np.radians(2.0)), 0.0])
    np.testing.assert_allclose(force[:2] / np.linalg.norm(force), normal[:2], atol=1e-9)


@pytest.mark.parametrize("tracking", ["ideal", "servo"])
def test_a_platform_effect_moves_the_platform(tracking: str) -> None:
    """A transport delay of 3 ms at 0.03 m/s leaves the platform 90 um behind its command, and the force with it."""
    s = with_effect({"kind": "platform.delay", "delay": 3e-3}, tracking)
    plant, v = Plant([s]), 0.03
    twist = np.array([[0.0, 0.0, v, 0.0, 0.0, 0.0]])
    plant.reset(np.array([[0.0, 0.0, -2e-3, 0.0, 0.0, 0.0, 1.0]]), twist)
    for k in range(100):
        goal = np.array([[0.0, 0.0, -2e-3 + v * (k + 1) * s.tick, 0.0, 0.0, 0.0, 1.0]])
        plant.advance(goal, twist, np.zeros((1, 6)))
    assert goal[0, 2] - plant.pose_act[0, 2] == pytest.approx(v * 3e-3, rel=2e-2)
