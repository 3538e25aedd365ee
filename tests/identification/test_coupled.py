"""Shift and turn that a latched pair couples: both are found where both move, and nothing is taken
in that is not there.
"""

from __future__ import annotations

import numpy as np
import pytest

from hiltestbed import load_scenario
from hiltestbed.identification.least_squares import PAIRS, PRODUCTS, take_in_partner
from hiltestbed.identification.methods.rls import Rls
from hiltestbed.signals import AXES

SCENARIO = "13-ring-down"
RATE = 2000
TICKS = 2000
NOISE = np.array([0.3] * 3 + [0.02] * 3)  # [N], [N m]
OWN_STIFFNESS = np.array([8e4, 8e4, 2e5, 1.2e4, 1.2e4, 3e4])
OWN_DAMPING = np.array([500.0, 500.0, 900.0, 60.0, 60.0, 90.0])
# [N/m], [N s/m] of a ball joint, [m] behind the latched place
JOINT, JOINT_DAMPING, BEHIND = 4e4, 250.0, 0.17
START = np.array([1e-3, -0.8e-3, 1e-3, 2e-3, -1e-3, 2e-3])  # [m], [rad]
INERTIA = np.array([400.0, 400.0, 400.0, 60.0, 60.0, 60.0])  # [kg], [kg m^2]


def joined(own: np.ndarray, joint: float) -> np.ndarray:
    """(6, 6) of six springs and a ball joint behind them: stretch x + L ry, y - L rx, z."""
    stretch = np.zeros((3, 6))
    stretch[:, :3] = np.eye(3)
    stretch[0, 4], stretch[1, 3] = BEHIND, -BEHIND
    return np.diag(own) + joint * stretch.T @ stretch


STIFFNESS, DAMPING = joined(OWN_STIFFNESS, JOINT), joined(OWN_DAMPING, JOINT_DAMPING)


def ring_down(
    stiffness: np.ndarray, damping: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Motion ``(T, 6)`` and rate of I q'' + C q' + K q = 0 from rest, as the sum of its modes."""
    system = np.block(
        [
            [np.zeros((6, 6)), np.eye(6)],
            [-stiffness / INERTIA[:, None], -damping / INERTIA[:, None]],
        ]
    )
    values, modes = np.linalg.eig(system)
    weights = np.linalg.solve(modes, np.concatenate([start, np.zeros(6)]).astype(complex))
    states = (np.exp(np.outer(np.arange(TICKS) / RATE, values)) * weights @ modes.T).real
    return states[:, :6], states[:, 6:]


def identified(
    motion: np.ndarray, rate: np.ndarray, force: np.ndarray, runs: int
) -> tuple[np.ndarray, np.ndarray]:
    """k, c, their standard deviations ``(4, runs, 6)`` of a latched pair that moves so, each run
    with noise of its own.

    Beside them what was felt ``(T, runs, 6)``, the torque about the latched place, of the ticks
    that count.
    """
    scenario = load_scenario(
        SCENARIO,
        set={"sensor.noise": NOISE[0], "sensor.torque_noise": NOISE[3], "sensor.delay": 0.0},
    )
    estimate = Rls.start([scenario] * runs)
    estimate.source.captured[:] = True
    pose, twist = np.zeros((runs, 7)), np.zeros((runs, 6))
    random, felt = np.random.default_rng(7), np.zeros((TICKS, runs, 6))
    for x, v, f, seen in zip(motion, rate, force, felt, strict=True):
        half = 0.5 * np.linalg.norm(x[3:])
        pose[:] = [*x[:3], *(0.5 * np.sinc(half / np.pi) * x[3:]), np.cos(half)]
        twist[:] = v
        wrench = f + NOISE * random.normal(size=(runs, 6))
        wrench[:, 3:] += np.cross(x[:3], f[:3])
        estimate.update(wrench, pose, twist)
        seen[:] = wrench
        seen[:, 3:] -= np.cross(x[:3], wrench[:, :3])
    first = TICKS - 1 - int(estimate.samples[0, 0])
    return np.stack(
        [estimate.stiffness, estimate.damping, estimate.stiffness_sd, estimate.damping_sd]
    ), felt[first : TICKS - 1]


def two_regressors(x: np.ndarray, v: np.ndarray, force: np.ndarray) -> np.ndarray:
    """k and c of F = k x + c v + b, by a solver of another kind."""
    columns = np.column_stack([x / x.std(), v / v.std(), np.ones(len(x))])
    return np.linalg.lstsq(columns, force, rcond=None)[0][:2] / [x.std(), v.std()]


def alone(motion: np.ndarray, rate: np.ndarray, felt: np.ndarray, axis: int) -> list[np.ndarray]:
    """k and c of an axis by its own motion, of each run, over the ticks that count."""
    used = slice(TICKS - 1 - len(felt), TICKS - 1)
    x, v = motion[used, axis], rate[used, axis]
    return [two_regressors(x, v, felt[:, run, axis]) for run in range(felt.shape[1])]


def test_a_joint_off_the_latched_place_is_no_part_of_k_and_c() -> None:
    """Two modes of x with ry and of y with rx: errors over standard deviations as of a normal
    distribution, over the seeds.

    Mean and spread within four standard deviations of either: 4/sqrt(N), 4/sqrt(2 N).
    """
    runs = 100
    motion, rate = ring_down(STIFFNESS, DAMPING, START)
    force = motion @ STIFFNESS.T + rate @ DAMPING.T
    (k, c, k_sd, c_sd), _ = identified(motion, rate, force, runs)
    for found, sd, true in ((k, k_sd, np.diag(STIFFNESS)), (c, c_sd, np.diag(DAMPING))):
        off = (found - true) / sd
        assert np.abs(off.mean(axis=0)).max() < 4.0 / np.sqrt(runs)
        np.testing.assert_allclose(off.std(axis=0), 1.0, atol=4.0 / np.sqrt(2.0 * runs))
    for axis in (0, 1, 3, 4):
        bare = two_regressors(motion[:, axis], rate[:, axis], force[:, axis])
        assert abs(bare[0] - STIFFNESS[axis, axis]) > 10.0 * k_sd[0, axis], AXES[axis]
        assert abs(bare[1] - DAMPING[axis, axis]) > 10.0 * c_sd[0, axis], AXES[axis]


def test_motion_that_goes_together_is_explained_by_the_axis_alone() -> None:
    """In one mode the turn is a fixed part of the shift: the axis shows k + part k'."""
    part = -0.9
    x, v = ring_down(STIFFNESS, DAMPING, np.array([0.0, 0.0, 1e-3, 0.0, 0.0, 0.0]))
    motion, rate = np.zeros_like(x), np.zeros_like(v)
    motion[:, 0], rate[:, 0] = x[:, 2], v[:, 2]
    motion[:, 4], rate[:, 4] = part * x[:, 2], part * v[:, 2]
    force = motion @ STIFFNESS.T + rate @ DAMPING.T
    (k, c, k_sd, c_sd), felt = identified(motion, rate, force, 20)
    for axis, other, times in ((0, 4, part), (4, 0, 1.0 / part)):
        assert k[:, axis] == pytest.approx(
            STIFFNESS[axis, axis] + times * STIFFNESS[axis, other], abs=4.0 * k_sd[0, axis]
        )
        assert c[:, axis] == pytest.approx(
            DAMPING[axis, axis] + times * DAMPING[axis, other], abs=4.0 * c_sd[0, axis]
        )
        bare = alone(motion, rate, felt, axis)
        np.testing.assert_allclose(np.stack([k[:, axis], c[:, axis]], axis=1), bare, rtol=1e-7)


def test_without_coupling_the_axis_stays_alone() -> None:
    """Of six separate springs that all move, no run of any axis is other than by two regressors:
    chances of 1/n^2 at each of n samples.
    """
    motion, rate = ring_down(np.diag(OWN_STIFFNESS), np.diag(OWN_DAMPING), START)
    force = motion * OWN_STIFFNESS + rate * OWN_DAMPING
    (k, c, *_), felt = identified(motion, rate, force, 20)
    for axis in range(6):
        bare, found = alone(motion, rate, felt, axis), np.stack([k[:, axis], c[:, axis]], axis=1)
        np.testing.assert_allclose(found, bare, rtol=1e-7, err_msg=AXES[axis])


def sums_of(x: np.ndarray, v: np.ndarray, y: np.ndarray) -> np.ndarray:
    """n, x, v, y, xx, xv, vv, xy, vy, yy."""
    return np.array([len(x), x.sum(), v.sum(), y.sum(), x @ x, x @ v, v @ v, x @ y, v @ y, y @ y])


def taken_in(
    x: np.ndarray, y: np.ndarray, variance: float, swapped: bool = False
) -> tuple[np.ndarray, bool]:
    """k, c and their standard deviations of ``y`` (n,) on ``x`` (4, n), the axis's own motion
    before the partner's; whether it is taken in.

    swapped: the axis is the second of its pair.
    """
    n, centred = y.size, np.column_stack([x[0] - x[0].mean(), x[1] - x[1].mean()])
    k, c = np.linalg.lstsq(centred, y, rcond=None)[0]
    rest = float(((y - y.mean() - centred @ [k, c]) ** 2).sum())
    own, other = sums_of(x[0], x[1], y), sums_of(x[2], x[3], np.zeros(n))
    (xa, va), (xb, vb) = (x[2:], x[:2]) if swapped else (x[:2], x[2:])
    products = np.zeros((PAIRS, PRODUCTS))
    products[0, :4] = xa @ xb, xa @ vb, va @ xb, va @ vb
    products[0, 6 if swapped else 4 :][:2] = x[2] @ y, x[3] @ y
    out = np.array([k, c, np.nan, np.nan])
    took, _ = take_in_partner(4 if swapped else 0, products, own, other, variance, rest, out)
    return out, took


@pytest.mark.parametrize("swapped", [False, True])
def test_four_regressors_are_least_squares(swapped: bool) -> None:
    """k, c and their standard deviations against the normal equations of five columns."""
    random = np.random.default_rng(3)
    x = random.normal(size=(4, 300))
    x[2:] += 0.8 * x[:2]
    y = np.array([3.0, 0.5, 2.0, -1.0]) @ x + 0.7 + 0.1 * random.normal(size=300)
    out, took = taken_in(x, y, 0.01, swapped)
    assert took
    columns = np.column_stack([*x, np.ones(300)])
    fit, (rest,), *_ = np.linalg.lstsq(columns, y, rcond=None)
    sd = np.sqrt(rest / 295 * np.diag(np.linalg.inv(columns.T @ columns)))
    assert out == pytest.approx([*fit[:2], *sd[:2]], rel=1e-9)


def test_one_of_n_squared_is_taken_in_for_nothing() -> None:
    """Without coupling; at most one of n of those is left out again, for what it leaves."""
    random, trials, n = np.random.default_rng(4), 20_000, 20
    count = sum(
        taken_in(random.normal(size=(4, n)), random.normal(size=n), 1.0)[1] for _ in range(trials)
    )
    expected = trials / n**2
    assert (
        expected * (1.0 - 1.0 / n) - 4.0 * np.sqrt(expected)
        < count
        < expected + 4.0 * np.sqrt(expected)
    )


def test_what_the_noise_hides_is_not_taken_in() -> None:
    """A coupling of a hundredth of the noise in 300 samples; one as large as the noise is; with
    noise of an unknown size none is.
    """
    random = np.random.default_rng(5)
    x = random.normal(size=(4, 300))
    y = np.array([3.0, 0.5, 0.01, 0.0]) @ x + random.normal(size=300)
    assert not taken_in(x, y, 1.0)[1]
    assert taken_in(x, y + x[2], 1.0)[1]
    assert not taken_in(x, y + x[2], 1e30)[1]
    assert not taken_in(x, y + x[2], 0.0)[1]


def test_where_a_surface_rubs_too_the_axis_stays_alone() -> None:
    """Friction of twice the noise leaves more than noise, whatever the partner explains."""
    random = np.random.default_rng(6)
    x = random.normal(size=(4, 300))
    x[1] = x[2]  # the partner shifts as the axis runs
    x[2] += 0.5 * random.normal(size=300)
    y = np.array([3.0, 0.5, 1.0, 0.0]) @ x + random.normal(size=300)
    assert taken_in(x, y, 1.0)[1]
    assert not taken_in(x, y + 2.0 * np.sign(x[3]), 1.0)[1]
