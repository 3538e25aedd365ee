"""The platform on recorded commands gives the poses that the rig reached."""

from __future__ import annotations

import numpy as np
import pytest

from hiltestbed.effects import EFFECTS
from hiltestbed.platform.parameters import PlatformParameters
from hiltestbed.replay import follows_exactly, replay_platform
from tests.effects.examples import example
from tests.replay.recorded import record, scenario

ROUND_OFF = 1e-14  # [m]: a response is advanced exactly, in the loop at each instant of the physics, in the replay once a tick
PLATFORM = [kind for kind, cls in EFFECTS.items() if cls.link == "platform"]


@pytest.mark.parametrize("rig", ["bumper with friction", "latched"])
def test_every_effect_of_the_platform_acts_in_the_replay_as_in_the_loop(rig: str) -> None:
    scenarios = [scenario(rig, changes={"effects": [example(k)]}) for k in PLATFORM]
    recorded = record(scenarios)
    parameters = [PlatformParameters.believed(s).with_effects(s.effects) for s in scenarios]
    reached = replay_platform(scenarios, parameters, recorded["pose_cmd"], recorded.lanes)
    assert np.abs(reached - recorded["pose_act"][..., :3]).max() < ROUND_OFF
    lagging = np.abs(recorded["pose_act"][:, 1:, :3] - recorded["pose_cmd"][:, :-1, :3]).max(axis=(1, 2))
    assert (lagging > 1e-6).sum() >= len(PLATFORM) - 1, "a limit of the speed need not show"


def test_without_an_effect_the_pose_is_the_command_a_tick_later() -> None:
    recorded = record([scenario("bumper with friction")])
    s = recorded.scenarios[0]
    assert follows_exactly(s)
    reached = replay_platform([s], [PlatformParameters.believed(s)], recorded["pose_cmd"], recorded.lanes)
    assert np.abs(reached[0, 1:] - recorded["pose_cmd"][0, :-1, :3]).max() < 1e-16
    assert np.abs(reached[0] - recorded["pose_act"][0, :, :3]).max() < 1e-16


def test_of_two_responses_in_a_row_the_second_sees_the_first_bend_within_a_tick() -> None:
    """It takes the path between two instants for straight. A lag of 30 Hz that starts at its command brakes by 1.4 w v = 10 m/s^2 at
    0.04 m/s: a h^2/8 = 3e-7 m."""
    several = [example(k) for k in ("platform.delay", "platform.lag", "platform.mode", "platform.scale")]
    s = scenario("bumper with friction", changes={"effects": several})
    recorded = record([s])
    reached = replay_platform([s], [PlatformParameters.believed(s).with_effects(s.effects)], recorded["pose_cmd"], recorded.lanes)
    assert np.abs(reached - recorded["pose_act"][..., :3]).max() < 3e-7
