"""The platform on recorded commands gives the poses that the rig reached."""

from __future__ import annotations

import numpy as np
import pytest

from hiltestbed.effects import EFFECTS
from hiltestbed.frames import Array
from hiltestbed.numerical_model.bodies import approach_state, approach_states
from hiltestbed.platform.parameters import PlatformParameters
from hiltestbed.platform.response import PlatformResponse
from hiltestbed.replay import follows_exactly, replay_platform
from hiltestbed.replay.stiction import Followed, Obeying, all_paths
from hiltestbed.scenario import Scenario
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
# [m]: a response is advanced exactly, in the loop at each instant of the physics, in the replay
# once a tick
ROUND_OFF = 1e-14
PLATFORM = [kind for kind, cls in EFFECTS.items() if cls.link == "platform"]


def place_of(s: Scenario, p: PlatformParameters, pose: Array, late: Array | None = None) -> Array:
    """(N, 3) of one run; late: (1,) [s] by which its commands are obeyed late."""
    start = approach_states([s.approach])
    return np.asarray(replay_platform([p], start, [s.substeps], pose, np.zeros(1, int), late)[0])


def test_every_effect_of_the_platform_acts_in_the_replay_as_in_the_loop() -> None:
    scenarios = [
        scenario("bumper with friction", changes={"effects": [example(k)]}) for k in PLATFORM
    ]
    recorded = record(scenarios)
    parameters = [PlatformParameters(s.tick).with_effects(s.effects) for s in scenarios]
    start, substeps = (
        approach_states(s.approach for s in scenarios),
        [s.substeps for s in scenarios],
    )
    commands = recorded["pose_cmd"]
    reached = replay_platform(parameters, start, substeps, commands, recorded.lanes)
    assert np.abs(reached - recorded["pose_act"][..., :3]).max() < ROUND_OFF
    lagging = np.abs(recorded["pose_act"][:, 1:, :3] - recorded["pose_cmd"][:, :-1, :3]).max(
        axis=(1, 2)
    )
    assert (lagging > 1e-6).sum() >= len(PLATFORM) - 1, "a limit of the speed need not show"


def test_without_an_effect_the_pose_is_the_command_a_tick_later() -> None:
    recorded = record([scenario("bumper with friction")])
    s = recorded.scenarios[0]
    assert follows_exactly(s.rig, s.compensation)
    reached = place_of(s, PlatformParameters(s.tick), recorded["pose_cmd"])[None]
    assert np.abs(reached[0, 1:] - recorded["pose_cmd"][0, :-1, :3]).max() < 1e-16
    assert np.abs(reached[0] - recorded["pose_act"][0, :, :3]).max() < 1e-16


@pytest.mark.parametrize("beside", BESIDE_STICTION)
@pytest.mark.parametrize("ticks_late", [0.0, 1.37])
def test_a_platform_with_stiction_stands_still_exactly_as_long_as_in_the_loop(
    beside: str, ticks_late: float
) -> None:
    """The loop looks at every instant whether the platform moves; the replay only in ticks in which
    it may. Commands, sizes and instants are drawn at random, over three orders of magnitude of
    travel within a tick per width of the stiction.
    """
    rng = np.random.default_rng([list(BESIDE_STICTION).index(beside), round(100 * ticks_late)])
    s, held, moved = scenario("bumper with friction"), 0, 0
    for _ in range(6):
        p, ticks = PlatformParameters(s.tick), 400
        p.delay, p.stick, p.instants = (
            ticks_late * s.tick,
            10.0 ** rng.uniform(-5.0, -3.0),
            int(rng.integers(1, 40)),
        )
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
        sizes, w = (
            10.0 ** rng.uniform(-4.5, -2.5, (3, 4)),
            2.0 * np.pi * 10.0 ** rng.uniform(-0.5, 1.7, (3, 4)),
        )
        t = (1 + np.arange(ticks)) * s.tick
        start = np.array([*s.approach.offset, -s.approach.gap])
        pose[0, :, :3] = start + (sizes[..., None] * (1.0 - np.cos(w[..., None] * t))).sum(axis=1).T
        response = PlatformResponse([p], approach_state(s.approach)[None], p.instants)
        response.begin(0, start, np.zeros(3))
        still = s.model_copy(
            update={"approach": s.approach.model_copy(update={"velocity": (0.0, 0.0, 0.0)})}
        )
        path = np.array([response.advance(k, pose[:, k])[0, -1].copy() for k in range(ticks - 1)])
        reached = place_of(still, p, pose)
        assert np.abs(reached[1:] - path).max() < 1e-13
        steps = np.diff(reached, axis=0)
        held, moved = held + int((steps == 0.0).sum()), moved + int((steps != 0.0).sum())
    assert held > 100, "some of the platforms stick"
    assert moved > 100, "and move"


@pytest.mark.parametrize("late", [0.0, 0.62, 2.0])
def test_each_path_of_a_stick_is_that_of_every_stick_up_to_the_next(late: float) -> None:
    """All paths in a range cover it without a gap, and chi-square of each is that of the replay for
    any stick in between; also where the instants at which the platform may move are no even parts
    of the tick, and the command is obeyed between two ticks.
    """
    s, pose = approaching(120)
    rng, low, high = np.random.default_rng(5), 2e-5, 2e-4
    p = PlatformParameters(s.tick, instants=9, phase=0.4)
    commands = pose[:, :, :3].copy()
    goal, moves = (
        commands + 1e-5 * rng.standard_normal(commands.shape),
        np.array([[False, False, True]]),
    )
    start, velocity = (
        np.array([[*s.approach.offset, -s.approach.gap]]),
        np.array([s.approach.velocity]),
    )
    out, rows = np.empty((5000, 3)), np.array([commands.shape[1]])
    followed = Followed(commands, goal, np.full_like(goal, 2e-5), rows, start, velocity, moves)
    obeying = Obeying(s.tick, late, 9, 0.4)
    count, _ = all_paths(followed, obeying, (low, high), np.inf, np.inf, np.inf, 1e-5, np.inf, out)
    found = out[:count]
    assert len(found) > 100
    assert found[0, 0] == low
    assert found[-1, 1] == high
    assert np.array_equal(found[1:, 0], found[:-1, 1])
    for stick in rng.uniform(low, high, 40):
        p.stick = stick
        z = (goal[0, :, 2] - place_of(s, p, pose, np.array([late * s.tick]))[:, 2]) / 2e-5
        held = found[np.searchsorted(found[:, 0], stick, side="right") - 1]
        assert float(z @ z) == pytest.approx(held[2], rel=1e-9)


def test_of_two_responses_in_a_row_the_second_sees_the_first_bend_within_a_tick() -> None:
    """It takes the path between two instants for straight. A lag of 30 Hz that starts at its
    command brakes by 1.4 w v = 10 m/s^2 at
    0.04 m/s: a h^2/8 = 3e-7 m.
    """
    several = [
        example(k) for k in ("platform.delay", "platform.lag", "platform.mode", "platform.scale")
    ]
    s = scenario("bumper with friction", changes={"effects": several})
    recorded = record([s])
    parameters = PlatformParameters(s.tick).with_effects(s.effects)
    reached = place_of(s, parameters, recorded["pose_cmd"])
    assert np.abs(reached - recorded["pose_act"][0, :, :3]).max() < 3e-7


def approaching(ticks: int = 300) -> tuple[Scenario, Array]:
    """A scenario that approaches along z, and a command (1, N, 7) a tick ahead that brakes."""
    s = scenario("bumper with friction")
    t = (1 + np.arange(ticks)) * s.tick
    along = np.array(s.approach.velocity)[:, None] * (
        t - 0.5 * np.maximum(t - 0.5 * ticks * s.tick, 0.0)
    )
    pose = np.zeros((1, ticks, 7))
    pose[0, :, :3] = (np.array([*s.approach.offset, -s.approach.gap])[:, None] + along).T
    return s, pose


def test_what_is_obeyed_late_joins_what_is_obeyed_at_once() -> None:
    """With a delay of its own beside it, the platform is where that delay has it at the start."""
    s, pose = approaching()
    p = PlatformParameters(s.tick)
    p.mode, p.delay = [(2.0 * np.pi * 20.0, 0.02)], 1.4 * s.tick
    at_once, hardly = (place_of(s, p, pose, np.array([e * s.tick])) for e in (0.0, 1e-6))
    assert np.abs(hardly - at_once).max() < 1e-5 * s.tick * np.abs(s.approach.velocity).max()
