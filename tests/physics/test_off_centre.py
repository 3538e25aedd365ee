"""Hits beside the axis against an integration that shares nothing with the loop: eighth order,
adaptive, contact in closed form.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from hiltestbed import load_scenario
from hiltestbed.loop import Loop
from hiltestbed.numerical_model.bodies import approach_state
from hiltestbed.numerical_model.kernels import CHASER, TARGET
from hiltestbed.scenario import Scenario
from tests.physics.closed_forms import newton_euler

SCENARIO = "05-off-centre"
TIP = 0.02  # [m] radius of the bumper's tip, models/bumper


class TwoBodies:
    """A sphere on one body, a plane on the other: state (p, q, v, w) each, w in the body."""

    def __init__(self, scenario: Scenario) -> None:
        self.bodies = (scenario.spacecraft.chaser, scenario.spacecraft.target)
        self.ports = [
            Rotation.from_euler("xyz", b.port.attitude_deg, degrees=True) for b in self.bodies
        ]
        self.contact = scenario.mechanism.contact

    def start(self, scenario: Scenario) -> np.ndarray:
        approach = approach_state(scenario.approach)
        state = np.zeros((2, 13))
        turn = self.ports[TARGET].inv()
        state[TARGET, 3:7] = turn.as_quat()
        state[TARGET, :3] = -turn.apply(self.bodies[TARGET].port.position)
        turn = Rotation.from_quat(approach[3:7]) * self.ports[CHASER].inv()
        arm = turn.apply(self.bodies[CHASER].port.position)
        state[CHASER] = np.concatenate(
            [
                approach[:3] - arm,
                turn.as_quat(),
                approach[7:10] - np.cross(approach[10:], arm),
                turn.inv().apply(approach[10:]),
            ]
        )
        return state.ravel()

    def wrench(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Force on the target, and its point."""
        turns = [Rotation.from_quat(s[3:7]) for s in state]
        plane = turns[TARGET] * self.ports[TARGET]
        origin = state[TARGET, :3] + turns[TARGET].apply(self.bodies[TARGET].port.position)
        port = turns[CHASER] * self.ports[CHASER]
        centre = (
            state[CHASER, :3]
            + turns[CHASER].apply(self.bodies[CHASER].port.position)
            - TIP * port.apply([0, 0, 1])
        )
        normal = plane.apply([0, 0, 1])
        depth = normal @ (centre - origin) + TIP
        point = centre + (TIP - 0.5 * depth) * normal
        rates = [turn.apply(s[10:]) for turn, s in zip(turns, state, strict=True)]
        speeds = [
            s[7:10] + np.cross(rate, point - s[:3]) for rate, s in zip(rates, state, strict=True)
        ]
        relative = speeds[CHASER] - speeds[TARGET]
        push = self.contact.stiffness * depth + self.contact.damping * (normal @ relative)
        push = max(push, 0.0) if depth > 0.0 else 0.0
        slip = relative - (normal @ relative) * normal
        drag = self.contact.friction * push * slip / math.sqrt(slip @ slip + 1e-8)
        return push * normal + drag, point

    def rates(self, _: float, y: np.ndarray) -> np.ndarray:
        state = y.reshape(2, 13)
        force, point = self.wrench(state)
        return newton_euler(self.bodies, state, force, np.zeros(3), point)

    def rebound(self, scenario: Scenario) -> np.ndarray:
        y = solve_ivp(
            self.rates,
            (0.0, scenario.duration),
            self.start(scenario),
            method="DOP853",
            rtol=1e-9,
            atol=1e-12,
            max_step=2e-3,
        )
        return y.y[:, -1].reshape(2, 13)


@pytest.mark.parametrize(
    "changes",
    [
        {"mechanism.contact.friction": 0.2},
        {"mechanism.contact.friction": 0.0, "approach.offset": [0.21, 0.21]},  # 0.3 m off the axis
    ],
    ids=["sliding", "far off the axis"],
)
def test_the_rebound_of_both_bodies_is_that_of_an_independent_integration(
    changes: dict[str, Any],
) -> None:
    ideal = {
        "rig.platform.tracking": "ideal",
        "sensor": {},
        "compensation.force": {"kind": "none"},
        "approach.gap": 0.001,
        "duration": 0.35,
    }
    scenario = load_scenario(SCENARIO, set=ideal | {"rate": 8000, "physics_rate": 16000} | changes)
    loop = Loop([scenario])
    for _ in range(scenario.ticks):
        loop.step()
    truth = TwoBodies(scenario).rebound(scenario)
    craft = loop.model
    start = TwoBodies(scenario).start(scenario).reshape(2, 13)
    assert loop.tally.contacts[0] == 1
    assert not loop.plant.contact[0]
    for body in (CHASER, TARGET):
        for part, ours in (
            (slice(7, 10), craft.v[0, body, :3]),
            (slice(10, 13), craft.v[0, body, 3:]),
        ):
            change = np.linalg.norm(truth[body, part] - start[body, part])  # what the hit did
            assert np.linalg.norm(ours - truth[body, part]) < 5e-3 * change
