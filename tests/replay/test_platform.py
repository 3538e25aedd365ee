"""The platform on recorded commands gives the poses that the rig reached."""

from __future__ import annotations

import numpy as np
import pytest

from hiltestbed.effects import EFFECTS
from hiltestbed.platform.parameters import PlatformParameters
from hiltestbed.platform.response import PlatformResponse
from hiltestbed.replay import follows_exactly, replay_platform
from tests.effects.examples import example
from tests.replay.recorded import record, scenario

BESIDE_STICTION = {
    "stiction alone": (),
    "lag": ("platform.lag",),
    "mode": ("platform.mode",),
    "play": ("platform.backlash",),
    "play behind a lag": ("platform.lag", "platform.backlash"),
    "play behind a mode": ("platform.mode", "platform.backlash"),
    "speed limit": ("platform.speed_limit",),
    "speed limit and lag": ("platform.speed_limit", "platform.lag"),
    "lag and mode": ("platform.lag", "platform.mode"),
}
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


@pytest.mark.parametrize("beside", BESIDE_STICTION)
@pytest.mark.parametrize("ticks_late", [0.0, 2.0, 0.03, 1.37, 0.98])
def test_a_platform_with_stiction_stands_still_exactly_as_long_as_in_the_loop(beside: str, ticks_late: float) -> None:
    """The loop looks at every instant whether the platform moves; the replay only in ticks in which it may. Commands, sizes and instants
    are drawn at random, over three orders of magnitude of travel within a tick per width of the stiction."""
    rng = np.random.default_rng([list(BESIDE_STICTION).index(beside), round(100 * ticks_late)])
    s, held, moved = scenario("bumper with friction"), 0, 0
    for _ in range(6):
        p, ticks = PlatformParameters(s.tick), 400
        p.delay, p.stick, p.instants = ticks_late * s.tick, 10.0 ** rng.uniform(-5.0, -3.0), int(rng.integers(1, 40))
        for kind in BESIDE_STICTION[beside]:
            if kind == "platform.lag":
                p.lag = [(2.0 * np.pi * 10.0 ** rng.uniform(0.0, 2.0), rng.uniform(0.3, 2.0))]
            elif kind == "platform.mode":
                p.mode = [(2.0 * np.pi * 10.0 ** rng.uniform(0.5, 2.5), rng.uniform(0.0, 0.9))]
            elif kind == "platform.backlash":
                p.play = 10.0 ** rng.uniform(-5.0, -3.0)
            else:
                p.speed = 10.0 ** rng.uniform(-2.5, 0.0)
        pose = np.zeros((1, ticks, 7))
        sizes, w = 10.0 ** rng.uniform(-4.5, -2.5, (3, 4)), 2.0 * np.pi * 10.0 ** rng.uniform(-0.5, 1.7, (3, 4))
        t = (1 + np.arange(ticks)) * s.tick
        start = np.array([*s.approach.offset, -s.approach.gap])
        pose[0, :, :3] = start + (sizes[..., None] * (1.0 - np.cos(w[..., None] * t))).sum(axis=1).T
        response = PlatformResponse([s], [p], p.instants)
        response.begin(0, start, np.zeros(3))
        still = s.model_copy(update={"approach": s.approach.model_copy(update={"velocity": (0.0, 0.0, 0.0)})})
        path = np.array([response.advance(k, pose[:, k])[0, -1].copy() for k in range(ticks - 1)])
        reached = replay_platform([still], [p], pose, np.zeros(1, int))[0]
        assert np.abs(reached[1:] - path).max() < 1e-13
        steps = np.diff(reached, axis=0)
        held, moved = held + int((steps == 0.0).sum()), moved + int((steps != 0.0).sum())
    assert held > 100, "some of the platforms stick"
    assert moved > 100, "and move"


def test_of_two_responses_in_a_row_the_second_sees_the_first_bend_within_a_tick() -> None:
    """It takes the path between two instants for straight. A lag of 30 Hz that starts at its command brakes by 1.4 w v = 10 m/s^2 at
    0.04 m/s: a h^2/8 = 3e-7 m."""
    several = [example(k) for k in ("platform.delay", "platform.lag", "platform.mode", "platform.scale")]
    s = scenario("bumper with friction", changes={"effects": several})
    recorded = record([s])
    reached = replay_platform([s], [PlatformParameters.believed(s).with_effects(s.effects)], recorded["pose_cmd"], recorded.lanes)
    assert np.abs(reached - recorded["pose_act"][..., :3]).max() < 3e-7
