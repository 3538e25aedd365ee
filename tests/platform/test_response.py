"""What effects of the platform, and platforms that are a response alone, make of a command."""

from __future__ import annotations

from itertools import pairwise
from typing import Literal

import numpy as np
import pytest
from scipy.signal import TransferFunction, lsim, lti

from hiltestbed.platform.build import plant_of
from hiltestbed.platform.drive import STATE
from hiltestbed.platform.facilities.response import ResponsePath
from hiltestbed.platform.kinds import ResponseSettings
from hiltestbed.platform.response import MEMORY, follow, second_order
from hiltestbed.scenario import scenario_from
from tests.platform.rigs import scenario


@pytest.mark.parametrize("tracking", ["ideal", "servo"])
def test_a_delay_leaves_the_platform_behind_its_command(tracking: str) -> None:
    """3 ms at 0.03 m/s are 90 um."""
    base = scenario(tracking).model_dump(mode="json")
    effect = {"kind": "platform.delay", "delay": 3e-3}
    s = scenario_from(base | {"effects": [effect], "approach": base["approach"] | {"gap": 2e-3}})
    plant, v = plant_of([s]), 0.03
    twist = np.array([[0.0, 0.0, v, 0.0, 0.0, 0.0]])
    plant.reset(np.array([[0.0, 0.0, -2e-3, 0.0, 0.0, 0.0, 1.0]]), twist)
    for k in range(100):
        goal = np.array([[0.0, 0.0, -2e-3 + v * (k + 1) * s.tick, 0.0, 0.0, 0.0, 1.0]])
        plant.advance(goal, twist, np.zeros((1, 6)))
    assert goal[0, 2] - plant.pose_act[0, 2] == pytest.approx(v * 3e-3, rel=2e-2)


@pytest.mark.parametrize("base", [0.0, 1.0])
@pytest.mark.parametrize("zeta", [0.02, 1.0, 1.6])
def test_the_exact_advance_is_the_linear_systems_own(zeta: float, base: float) -> None:
    """Over a path of straight pieces, against SciPy's simulation of the same transfer function."""
    w, dt = 2.0 * np.pi * 12.0, 1e-3
    t = np.arange(400) * dt
    u = np.interp(t, [0.0, 0.05, 0.12, 0.3, 0.4], [0.0, 1.0, -0.5, 0.2, 0.2])
    kernel, none, free = np.empty((1, 5)), np.zeros((0, 5)), (np.inf, 0.0, 0.0)
    second_order(w, zeta, dt, base, kernel[0])
    state = np.zeros((1, 2)), np.zeros((0, 2)), np.zeros(MEMORY), np.zeros(STATE)
    ours = [0.0, *(follow(a, b, dt, free, kernel, none, state) for a, b in pairwise(u))]
    system = TransferFunction([2.0 * zeta * w * base, w * w], [1.0, 2.0 * zeta * w, w * w])
    np.testing.assert_allclose(ours, lsim(system, u, t)[1], atol=2e-6)


def test_a_limit_of_the_speed_does_not_hang_on_how_finely_a_tick_is_divided() -> None:
    """A command that turns faster than the platform may go: it is met on the way back, within a
    tick, and left behind at once.
    """
    limit, dt = 0.06, 1e-3
    rng = np.random.default_rng(4)
    command = np.cumsum(np.repeat(rng.uniform(-0.2, 0.2, 60), 7)) * dt

    def reached(parts: int) -> np.ndarray:
        none, nothing, out = np.zeros((0, 5)), np.zeros((0, 2)), []
        state = nothing, nothing, np.zeros(MEMORY), np.zeros(STATE)
        for before, after in pairwise(command):
            for a, b in pairwise(np.linspace(before, after, parts + 1)):
                at = follow(a, b, dt / parts, (limit, 0.0, 0.0), none, none, state)
            out.append(at)
        return np.array(out)

    whole = reached(1)
    np.testing.assert_allclose(reached(7), whole, atol=1e-13)
    # so finely that where within a part it meets its command does not matter
    fine, at, n = [], 0.0, 1000
    for before, after in pairwise(command):
        for u in np.linspace(before, after, n + 1)[1:]:
            at += min(max(u - at, -limit * dt / n), limit * dt / n)
        fine.append(at)
    turns = 5  # each is off by 2 v dt/n at most, until the command is met again
    np.testing.assert_allclose(fine, whole, atol=2.0 * turns * limit * dt / n)


H = 1e-3


def command(k: np.ndarray) -> np.ndarray:
    """``(n, 7)`` a smooth motion on several axes."""
    out = np.zeros((len(k), 7))
    out[:, 0], out[:, 2] = 0.01 * np.sin(40 * k * H), 0.02 * (1 - np.cos(25 * k * H))
    angle = 0.03 * np.sin(30 * k * H)
    out[:, 4], out[:, 6] = np.sin(angle / 2), np.cos(angle / 2)
    return out


def reached(settings: ResponseSettings, substeps: int, ticks: int = 400) -> np.ndarray:
    path = ResponsePath([settings], H, substeps)
    path.begin(command(np.array([0.0])), np.zeros((1, 6)))
    return np.array([path.advance(command(np.array([k]))).copy()[0] for k in range(1, ticks + 1)])


@pytest.mark.parametrize("order", [2, 3])
def test_it_does_not_depend_on_how_a_tick_is_divided(order: Literal[2, 3]) -> None:
    settings = ResponseSettings(
        order=order, bandwidth=12.0, damping_ratio=0.6, gain=40.0, delay=0.0033
    )
    np.testing.assert_allclose(reached(settings, 1)[:, -1], reached(settings, 7)[:, -1], atol=1e-12)


def test_it_is_the_exact_answer_to_a_command_that_is_linear_over_a_tick() -> None:
    """Against scipy's own simulation with first-order hold, and against the second order of the
    platform's effects.
    """
    settings = ResponseSettings(order=3, bandwidth=12.0, damping_ratio=0.6, gain=40.0)
    w, t = 2 * np.pi * 12.0, np.arange(401) * H
    system = lti([40.0 * w**2], [1.0, 1.2 * w, w**2, 40.0 * w**2])
    expected = lsim(system, command(np.arange(401))[:, 2], t)[1][1:]
    np.testing.assert_allclose(reached(settings, 2)[:, -1, 2], expected, atol=1e-10)
    lag, none, goal = np.empty((1, 5)), np.zeros((0, 5)), command(np.arange(401))[:, 0]
    second_order(w, 0.7, H, 0.0, lag[0])
    state = np.zeros((1, 2)), np.zeros((0, 2)), np.zeros(MEMORY), np.zeros(STATE)
    effect = [
        follow(goal[k], goal[k + 1], H, (np.inf, 0.0, 0.0), lag, none, state) for k in range(400)
    ]
    twin = reached(ResponseSettings(bandwidth=12.0, damping_ratio=0.7), 2)
    np.testing.assert_allclose(twin[:, -1, 0], effect, atol=1e-12)


@pytest.mark.parametrize("order", [2, 3])
def test_a_sine_comes_out_as_the_transfer_function_says(order: Literal[2, 3]) -> None:
    late, f, ticks, w, zeta, gain = 0.0042, 8.0, 3000, 2.0 * np.pi * 20.0, 0.7, 60.0
    settings = ResponseSettings(
        order=order, bandwidth=(20.0,) * 6, damping_ratio=zeta, gain=gain, delay=late
    )
    path, out = ResponsePath([settings], H, 1), []
    path.begin(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]), np.zeros((1, 6)))
    t = np.arange(1, ticks + 1) * H
    for u in np.sin(2 * np.pi * f * t):
        pose = np.array([[0.0, 0.0, 0.01 * u, np.sin(0.01 * u), 0.0, 0.0, np.cos(0.01 * u)]])
        last = path.advance(pose)[0, -1]
        out.append([last[2] / 0.01, 2 * np.arcsin(last[3]) / 0.02])
    basis = np.column_stack([np.sin(2 * np.pi * f * t), np.cos(2 * np.pi * f * t)])[-1000:]
    fit = np.linalg.lstsq(basis, np.array(out)[-1000:], rcond=None)[0]
    s = 2j * np.pi * f
    law = w**2 / (s**2 + 2.0 * zeta * w * s + w**2)
    if order == 3:
        law = gain * w**2 / (s**3 + 2.0 * zeta * w * s**2 + w**2 * s + gain * w**2)
    held = np.sinc(f * H) ** 2  # the command is linear between its samples
    np.testing.assert_allclose(fit[0] + 1j * fit[1], law * np.exp(-s * late) * held, rtol=1e-3)
