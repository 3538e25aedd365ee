"""What effects of the platform make of a command."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import TransferFunction, lsim

from hiltestbed.platform.drive import STATE
from hiltestbed.platform.plant import Plant
from hiltestbed.platform.response import MEMORY, follow, second_order
from hiltestbed.scenario import scenario_from
from tests.platform.rigs import scenario


@pytest.mark.parametrize("tracking", ["ideal", "servo"])
def test_a_delay_leaves_the_platform_behind_its_command(tracking: str) -> None:
    """3 ms at 0.03 m/s are 90 um."""
    base = scenario(tracking).model_dump(mode="json")
    effect = {"kind": "platform.delay", "delay": 3e-3}
    s = scenario_from(base | {"effects": [effect], "approach": base["approach"] | {"gap": 2e-3}})
    plant, v = Plant([s]), 0.03
    twist = np.array([[0.0, 0.0, v, 0.0, 0.0, 0.0]])
    plant.reset(np.array([[0.0, 0.0, -2e-3, 0.0, 0.0, 0.0, 1.0]]), twist)
    for k in range(100):
        goal = np.array([[0.0, 0.0, -2e-3 + v * (k + 1) * s.tick, 0.0, 0.0, 0.0, 1.0]])
        plant.advance(goal, twist, np.zeros((1, 6)))
    assert goal[0, 2] - plant.pose_act[0, 2] == pytest.approx(v * 3e-3, rel=2e-2)


@pytest.mark.parametrize("base", [0.0, 1.0])
@pytest.mark.parametrize("zeta", [0.02, 0.7, 1.0, 1.6])
def test_the_exact_advance_is_the_linear_systems_own(zeta: float, base: float) -> None:
    """Over a path of straight pieces, against SciPy's simulation of the same transfer function."""
    w, dt = 2.0 * np.pi * 12.0, 1e-3
    t = np.arange(400) * dt
    u = np.interp(t, [0.0, 0.05, 0.12, 0.3, 0.4], [0.0, 1.0, -0.5, 0.2, 0.2])
    kernel = np.empty(5)
    second_order(w, zeta, dt, base, kernel)
    state, ours = np.zeros(2), [0.0]
    for before, after in pairwise(u):
        rate = (after - before) / dt
        error, slip = state[0] - (before - kernel[4] * rate), state[1] - rate
        state = np.array(
            [
                after - kernel[4] * rate + kernel[0] * error + kernel[1] * slip,
                rate + kernel[2] * error + kernel[3] * slip,
            ]
        )
        ours.append(state[0])
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
