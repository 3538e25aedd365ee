"""The Kalman predictor: its gains against the recursion whose limit they are, its poles, its
extrapolation, its noise.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from hiltestbed import load_scenario
from hiltestbed.compensation.force_methods.kalman import KalmanBlock, steady_gain
from hiltestbed.compensation.force_methods.second_order_lead import SecondOrderLeadBlock
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.frames import Array

HEAD_ON = Path(__file__).parents[2] / "scenarios" / "02-bumper.yaml"
RATE, DELAY = 2000.0, 0.005
H = 1.0 / RATE
MOVE = np.array([[1.0, H, 0.5 * H * H], [0.0, 1.0, H], [0.0, 0.0, 1.0]])


def block(kind: str, **more: float) -> KalmanBlock | SecondOrderLeadBlock:
    force = {"kind": kind, **more}
    scenario = load_scenario(
        HEAD_ON,
        set={
            "rate": RATE,
            "physics_rate": RATE,
            "sensor.delay": DELAY,
            "compensation.force": force,
        },
    )
    return KalmanBlock([scenario]) if kind == "kalman" else SecondOrderLeadBlock([scenario])


def answered(method: KalmanBlock | SecondOrderLeadBlock, signal: Array) -> Array:
    nothing, out = np.zeros((1, 7)), np.empty_like(signal)
    for k, value in enumerate(signal):
        wrench = np.full((1, 6), value)
        out[k] = method.compensate(
            Measurement(wrench, nothing, nothing, nothing, nothing, np.zeros(1, dtype=bool))
        )[0, 2]
    return out


@pytest.mark.parametrize("radius", [2.0 * math.pi * 20.0, 2.0 * math.pi * 300.0])
def test_the_gains_are_the_limit_of_the_covariance_recursion(radius: float) -> None:
    """From a covariance of nothing known, the recursion forgets its start within some time
    constants.
    """
    q = radius**6 * H  # r = 1 a reading: a density of H
    drive = q * np.array(
        [[H**5 / 20, H**4 / 8, H**3 / 6], [H**4 / 8, H**3 / 3, H**2 / 2], [H**3 / 6, H**2 / 2, H]]
    )
    covariance = np.diag([1.0, 1e6, 1e12])
    gain = np.zeros(3)
    for _ in range(round(30.0 / (radius * H))):
        covariance = MOVE @ covariance @ MOVE.T + drive
        gain = covariance[:, 0] / (covariance[0, 0] + 1.0)
        covariance = covariance - np.outer(gain, covariance[0])
    assert steady_gain(radius, H) == pytest.approx(gain, rel=1e-6)


def test_the_poles_lie_on_a_butterworth_circle() -> None:
    """-1 and -exp(+-i pi/3) times the radius, to first order in radius times tick, here 0.06."""
    radius = 2.0 * math.pi * 20.0
    closed = (np.eye(3) - np.outer(steady_gain(radius, H), [1.0, 0.0, 0.0])) @ MOVE
    poles = np.log(np.linalg.eigvals(closed).astype(complex)) / (radius * H)
    wanted = np.array([-1.0, -np.exp(1j * math.pi / 3.0), -np.exp(-1j * math.pi / 3.0)])
    for pole in wanted:
        assert np.abs(poles - pole).min() < 0.06


def test_a_parabola_is_extrapolated_over_the_delay() -> None:
    """The model that it filters is a parabola: once the start is forgotten (50 time constants),
    nothing is left but round-off.
    """
    t = H * np.arange(400)
    force = 3.0 - 40.0 * t + 900.0 * t**2
    late = force.copy()
    late[10:] = force[:-10]  # 5 ms
    left = answered(block("kalman", bandwidth=60.0), late) - force
    assert np.abs(left[-50:]).max() < 1e-7 * np.abs(force).max()


def test_it_lets_less_noise_through_than_a_lead_of_second_order() -> None:
    """Both extrapolate a parabola by 5 ms. Of white noise a filter lets through the root of the sum
    of its impulse response squared.
    """
    pulse = np.zeros(4000)
    pulse[0] = 1.0
    slow, fast, lead = (
        math.sqrt(np.sum(answered(method, pulse) ** 2))
        for method in (
            block("kalman", bandwidth=60.0),
            block("kalman", bandwidth=150.0),
            block("second_order_lead"),
        )
    )
    assert slow < fast < lead
