"""Responses of a platform that a facility integrates in time steps."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from .made import H, effect, platform_link


@pytest.mark.parametrize(
    ("kind", "parameters", "base", "steps", "left"),
    [
        ("platform.mode", {"frequency": 12.0, "damping_ratio": 0.05}, 1.0, 20, 0.05),
        ("platform.lag", {"bandwidth": 31.83}, 0.0, 4, 5e-3),
        ("platform.lag", {"bandwidth": 80.7}, 0.0, 20, 5e-3),
    ],
)
def test_a_response_integrated_step_by_step_is_a_continuous_one(
    kind: str, parameters: dict[str, float], base: float, steps: int, left: float
) -> None:
    """By semi-implicit Euler, from the start at the rate of the command on. ``left``: of what the
    step makes, what is not told.

    Of a mode it is more, since its damper is driven by the command's rate over the step, in its
    middle.
    """
    w, ratio, dt = (
        2.0 * math.pi * next(iter(parameters.values())),
        parameters.get("damping_ratio", 0.7),
        H / steps,
    )
    link = platform_link()
    command = link.commands[0][:, 2]
    x, v, node = -0.0030, 0.03, np.concatenate([[-0.0030], command])
    s = link.runs[0].scenario.approach
    assert (s.gap, s.velocity[2]) == (0.003, 0.03)
    reached = [x]
    for k in range(len(command) - 1):
        rate = (node[k + 1] - node[k]) / H
        for j in range(steps):
            u = node[k] + rate * (j + 1) * dt
            v += dt * (w * w * (u - x) - 2.0 * ratio * w * (v - base * rate))
            x += dt * v
        reached.append(x)
    told, exact = (
        link.shown(0, [effect(kind, {"steps": True, "ahead": a}, **parameters)])[:, 2]
        for a in (dt, 0.0)
    )
    near, far = (float(np.max(np.abs(np.array(reached) - path))) for path in (told, exact))
    assert near < left * far
    # a step at twice the speed of approach, magnified by a mode
    assert far < 2.0 * dt * 0.06 / (2.0 * min(ratio, 0.5))


def test_responses_that_are_integrated_step_by_step_look_no_further_than_the_command() -> None:
    link = platform_link()
    lag: dict[str, Any] = {"bandwidth": 50.0}
    mode: dict[str, Any] = {"frequency": 30.0, "damping_ratio": 0.1}
    one = link.shown(0, [effect("platform.lag", {"ahead": 2 * H}, **lag)])
    both = link.shown(0, [effect("platform.lag", {"ahead": H}, **lag)])
    assert np.array_equal(one, both)
    assert (
        np.abs(
            link.shown(0, [effect("platform.mode", {"ahead": 0.5 * H}, **mode)])
            - link.shown(0, [effect("platform.mode", **mode)])
        ).max()
        > 1e-7
    )
