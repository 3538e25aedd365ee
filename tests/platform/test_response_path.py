"""A platform that is a response alone: exact between instants, as its transfer function in steady
state, late by its delay.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from scipy.signal import lsim, lti

from hiltestbed.platform.facilities.response import ResponsePath, nominal, transfer
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
    lag, lagged, none = np.empty((1, 5)), np.zeros((1, 2)), np.zeros((0, 2))
    second_order(w, 0.7, H, 0.0, lag[0])
    goal, memory = command(np.arange(401))[:, 0], np.zeros(MEMORY)
    effect = [
        follow(
            goal[k], goal[k + 1], H, np.inf, 0.0, 0.0, lag, np.zeros((0, 5)), lagged, none, memory
        )
        for k in range(400)
    ]
    twin = reached(ResponseSettings(bandwidth=12.0, damping_ratio=0.7), 2)
    np.testing.assert_allclose(twin[:, -1, 0], effect, atol=1e-12)


@pytest.mark.parametrize("order", [2, 3])
def test_a_sine_comes_out_as_the_transfer_function_says(order: Literal[2, 3]) -> None:
    settings = ResponseSettings(
        order=order, bandwidth=(20.0,) * 6, damping_ratio=0.7, gain=60.0, delay=0.0042
    )
    path, f, ticks = ResponsePath([settings], H, 1), 8.0, 3000
    path.begin(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]), np.zeros((1, 6)))
    t, out = np.arange(1, ticks + 1) * H, []
    for now in t:
        turn = 0.02 * np.sin(2 * np.pi * f * now)
        pose = np.array(
            [
                [
                    0.0,
                    0.0,
                    0.01 * np.sin(2 * np.pi * f * now),
                    np.sin(turn / 2),
                    0.0,
                    0.0,
                    np.cos(turn / 2),
                ]
            ]
        )
        last = path.advance(pose)[0, -1]
        out.append([last[2] / 0.01, 2 * np.arcsin(last[3]) / 0.02])
    basis = np.column_stack([np.sin(2 * np.pi * f * t), np.cos(2 * np.pi * f * t)])[-1000:]
    for column, axis in ((0, 2), (1, 3)):
        fit = np.linalg.lstsq(basis, np.array(out)[-1000:, column], rcond=None)[0]
        held = np.sinc(f * H) ** 2  # the command is linear between its samples
        assert fit[0] + 1j * fit[1] == pytest.approx(
            complex(transfer(settings, np.array(f), axis)) * held, rel=1e-3
        )


def test_the_nominal_delay_is_that_of_low_frequency() -> None:
    for settings in (
        ResponseSettings(bandwidth=20.0, damping_ratio=0.7, delay=0.002),
        ResponseSettings(order=3, gain=60.0, delay=0.002),
    ):
        slope = -np.angle(transfer(settings, np.array(0.01))) / (2 * np.pi * 0.01)
        assert nominal(settings).late() == pytest.approx(float(slope), rel=1e-3)


def test_the_state_written_back_goes_on_from_there() -> None:
    settings = ResponseSettings(order=3, delay=0.0033)
    path = ResponsePath([settings], H, 2)
    path.begin(command(np.array([0.0])), np.zeros((1, 6)))
    for k in range(1, 50):
        path.advance(command(np.array([k])))
    kept = {name: array.copy() for name, array in path.buffers().items()}
    first = path.advance(command(np.array([50]))).copy()
    for name, array in path.buffers().items():
        array[:] = kept[name]
    np.testing.assert_array_equal(path.advance(command(np.array([50]))), first)
