"""A platform that is a response alone: exact between instants, as its transfer function in steady
state, late by its delay.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from scipy.signal import lsim, lti

from hiltestbed.platform.drive import STATE
from hiltestbed.platform.facilities.response import ResponsePath
from hiltestbed.platform.facilities.settings import ResponseSettings
from hiltestbed.platform.response import MEMORY, follow, second_order

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
