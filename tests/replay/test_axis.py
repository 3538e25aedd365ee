"""Along one axis the short replay gives what the whole one does."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hiltestbed import load_scenario
from hiltestbed.effects import EFFECTS, Effect
from hiltestbed.numerical_model.parameters import DynamicsParameters, stack
from hiltestbed.replay import Departing, replay_axis, replay_model

SCENARIO = load_scenario(
    Path(__file__).parents[2] / "scenarios" / "02-bumper.yaml",
    set={"approach.velocity": [0, 0, 0.03]},
)
ROUND_OFF = 1e-13  # [m] of centimetres, through 3000 steps
FORCE: dict[str, Any] = {
    "viscous": 90.0,
    "coulomb": 3.0,
    "offset": 0.4,
    "static": 4.0,
    "coulomb_back": 2.0,
}


def effect(kind: str, **parameters: Any) -> Effect:
    return EFFECTS[kind](**parameters)


@pytest.mark.parametrize(
    "effects",
    [
        [],
        [effect("dynamics.mass", factor=1.3), effect("dynamics.force", **FORCE)],
        [
            effect("dynamics.force", body="chaser", **FORCE),
            effect("dynamics.force", body="target", **FORCE),
            effect("dynamics.force", **FORCE),
        ],
        [
            effect("dynamics.appendage", mass_ratio=0.2, frequency=2.0, damping_ratio=0.05),
            effect("dynamics.force", viscous=50.0),
        ],
        [
            effect("dynamics.step_delay", ticks=3),
            effect("dynamics.integrator", scheme="explicit_euler"),
        ],
    ],
    ids=["believed", "mass and friction", "three frictions", "slosh", "late and explicit"],
)
def test_the_short_replay_is_the_whole_one(effects: list[Effect]) -> None:
    rng = np.random.default_rng(1)
    wrench = np.zeros((1, 3000, 6))
    wrench[0, :, 2] = 30.0 * np.sin(np.arange(3000) / 150.0) + rng.standard_normal(3000)
    model = Departing([SCENARIO], stack([DynamicsParameters.of(effects)]))
    whole = replay_model(model, wrench, np.array([0]))[0, :, 2]
    short = replay_axis(model, wrench[:, :, 2], whole[:1], np.array([0.03]), np.array([0]), [3000])[
        0
    ]
    assert np.abs(short - whole).max() < ROUND_OFF


def test_a_stamp_shows_the_place_of_another_instant() -> None:
    """Half a tick late: half of the way of a tick less."""
    force = np.full((1, 200), 5.0)
    late = [
        EFFECTS["dynamics.force"].hypothesis({"stamp": s * SCENARIO.tick}) for s in (0.0, 0.5, 1.0)
    ]
    models = Departing([SCENARIO] * 3, stack([DynamicsParameters.of([e]) for e in late]))
    now, half, whole = replay_axis(
        models, force, np.zeros(1), np.full(1, 0.03), np.zeros(3, dtype=int), [200]
    )
    np.testing.assert_allclose(half - half[0], 0.5 * (now - now[0] + whole - whole[0]), atol=1e-9)
    np.testing.assert_allclose(np.diff(whole)[1:], np.diff(now)[:-1], atol=1e-12)
