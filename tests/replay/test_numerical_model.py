"""The numerical model on recorded wrenches gives the poses that the loop commanded."""

from __future__ import annotations

import numpy as np
import pytest

from hiltestbed.effects import EFFECTS
from hiltestbed.numerical_model.bodies import approach_states
from hiltestbed.numerical_model.parameters import DynamicsParameters, stack
from hiltestbed.replay import Departing, replay_model
from tests.effects.examples import example
from tests.replay.recorded import Recorded, record, scenario

# [m, -]: positions of a centimetre and quaternions, in which 1e-16 is one bit, through 700 steps
ROUND_OFF = 1e-15
DYNAMICS = [kind for kind, cls in EFFECTS.items() if cls.link == "dynamics"]


def replayed(recorded: Recorded, effects: bool = True) -> np.ndarray:
    numbers = stack(
        [
            DynamicsParameters().with_effects(s.effects if effects else ())
            for s in recorded.scenarios
        ]
    )
    scenarios = recorded.scenarios
    start = approach_states(s.approach for s in scenarios)
    models = Departing([s.spacecraft for s in scenarios], start, scenarios[0].tick, numbers)
    return np.asarray(replay_model(models, recorded["wrench_comp"], recorded.lanes))


@pytest.mark.parametrize("force", ["phase_lead", "resynchronised"])
@pytest.mark.parametrize("tracking", ["ideal", "servo"])
def test_the_recorded_wrench_takes_the_model_where_the_loop_was(tracking: str, force: str) -> None:
    recorded = record(
        [scenario("bumper with friction", tracking, {"compensation.force": {"kind": force}})]
    )
    assert np.abs(replayed(recorded) - recorded["pose_cmd"]).max() < ROUND_OFF


def test_every_effect_of_the_numerical_model_acts_in_the_replay_as_in_the_loop() -> None:
    both = [[example(k)] for k in DYNAMICS] + [
        [example(k) for k in DYNAMICS],
        [example("dynamics.appendage")] * 2,
    ]
    both += [
        [example("dynamics.appendage") | {"place": [0.3, -0.2, 0.1]}],
        [example("dynamics.appendage") | {"place": [0.3, 0.0, 0.2]}] * 2,
    ]
    recorded = record(
        [scenario("bumper with friction", changes={"effects": effects}) for effects in both]
    )
    assert np.abs(replayed(recorded) - recorded["pose_cmd"]).max() < ROUND_OFF
    shown = np.abs(replayed(recorded, effects=False) - recorded["pose_cmd"]).max(axis=(1, 2))
    assert (shown > 1e-5).all()
