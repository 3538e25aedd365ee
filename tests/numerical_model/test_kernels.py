"""The compiled copy of the numerical model against Pinocchio's, and its shortcuts against the steps
that they replace.
"""

from __future__ import annotations

import numpy as np
import pytest

from hiltestbed import load_scenario
from hiltestbed.numerical_model.free_flyers import FreeFlyers
from hiltestbed.numerical_model.kernels import (
    SCRATCH,
    carry,
    mobility,
    newton_euler,
    step,
    wrench_at_P,
)
from hiltestbed.numerical_model.model import NumericalModel

SCENARIO = load_scenario("05-off-centre")
H = 1.0 / SCENARIO.rate
WRENCH = np.array([30.0, -20.0, 200.0, 5.0, -8.0, 2.0])


@pytest.fixture
def craft() -> NumericalModel:
    return NumericalModel([SCENARIO])


def _bodies(craft: NumericalModel) -> tuple[np.ndarray, ...]:
    return craft.port[0], craft.mass[0], craft.inertia[0], np.linalg.inv(craft.inertia[0])


def test_a_step_is_pinocchios(craft: NumericalModel) -> None:
    port, mass, inertia, inverse = _bodies(craft)
    q, v, work = craft.q[0].copy(), craft.v[0].copy(), np.empty((SCRATCH, 7))
    for _ in range(200):
        step(q, v, port, mass, inertia, inverse, WRENCH, H, work)
        craft.advance(WRENCH[None])
    assert np.abs(v - craft.v[0]).max() < 1e-12
    assert np.abs(q - craft.q[0]).max() < 1e-12


def test_newton_and_euler_are_pinocchios() -> None:
    """40 pairs of any shape, attitude, speed and load: to 1e-12 of what they change."""
    rng = np.random.default_rng(7)
    n, h = 40, 1e-3
    mass = np.exp(rng.uniform(np.log(50.0), np.log(2e4), (n, 2)))
    axes = np.linalg.qr(rng.normal(size=(n, 2, 3, 3)))[0]
    spread = rng.uniform(0.6, 1.0, (n, 2, 3)) * mass[..., None]
    inertia = np.einsum("nbij,nbj,nbkj->nbik", axes, spread, axes)
    q = rng.normal(size=(n, 2, 7))
    q[..., 3:] /= np.linalg.norm(q[..., 3:], axis=-1, keepdims=True)
    v, tau = rng.normal(size=(n, 2, 6)), 1e3 * rng.normal(size=(n, 2, 6))
    by_pinocchio, by_hand = v.copy(), v.copy()
    FreeFlyers(mass, inertia).accelerate(q, by_pinocchio, tau, h)
    newton_euler(mass, inertia, np.linalg.inv(inertia), tau, h, by_hand)
    assert np.abs(by_hand - by_pinocchio).max() < 1e-12 * np.abs(by_pinocchio - v).max()


def test_carrying_is_stepping_where_nothing_turns_much(craft: NumericalModel) -> None:
    """40 ticks under a wrench: bodies turn by some 1e-4 rad, so positions agree to 1e-4."""
    port, mass, _, inverse = _bodies(craft)
    q, v, work = craft.q[0].copy(), craft.v[0].copy(), np.empty((SCRATCH, 7))
    ticks = 40
    impulse, shift = ticks * H * WRENCH, H * H * ticks * (ticks + 1) / 2 * WRENCH
    carry(q, v, port, mass, inverse, ticks * H, impulse, shift, work)
    start, speed = craft.q[0].copy(), craft.v[0].copy()
    for _ in range(ticks):
        craft.advance(WRENCH[None])
    pushed = np.abs(craft.v[0] - speed).max()
    assert np.abs(v - craft.v[0]).max() < 2e-3 * pushed
    moved = np.abs(craft.q[0, :, :3] - start[:, :3] - ticks * H * speed[:, :3]).max()
    assert np.abs(q - craft.q[0]).max() < 2e-3 * moved


def test_mobility_is_the_change_of_the_twist_by_a_wrench_at_A(craft: NumericalModel) -> None:
    port, mass, _, inverse = _bodies(craft)
    work, matrix = np.empty((SCRATCH, 7)), np.empty((6, 6))
    mobility(craft.q[0], port, craft.pose[0, :3], mass, inverse, work, matrix)
    assert np.abs(matrix - matrix.T).max() < 1e-12 * np.abs(matrix).max()
    assert np.linalg.eigvalsh(matrix).min() > 0.0
    free = NumericalModel([SCENARIO])
    pushed = NumericalModel([SCENARIO])
    at_A = WRENCH.copy()
    at_P = np.empty(6)
    free.tick = pushed.tick = 1e-6
    wrench_at_P(at_A, craft.pose[0, :3], at_P)
    free.advance(np.zeros((1, 6)))
    pushed.advance(at_P[None])
    change = (pushed.twist[0] - free.twist[0]) / 1e-6
    assert np.abs(change + matrix @ at_A).max() < 1e-6 * np.abs(change).max()
