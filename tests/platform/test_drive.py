"""A controller against dry friction, with a limited force: its closed forms, and an integrator that
shares nothing with it.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hiltestbed.numerical_model.bodies import approach_states
from hiltestbed.platform.drive import RATE, STATE, drive_over
from hiltestbed.platform.effects.drive import PlatformDrive
from hiltestbed.platform.parameters import PlatformParameters
from hiltestbed.platform.response import MEMORY, follow, second_order
from hiltestbed.replay import replay_platform
from hiltestbed.scenario import Scenario
from tests.platform.rigs import scenario

H = 0.02  # [s] a tick, a part of a time constant of the drives here
# [m] of motions of some 30 mm: a few units in the last place of each of 500 ticks
ROUND_OFF = 2e-15


def numbers(
    w: float,
    zeta: float,
    r: float = 0.0,
    o: float = 0.0,
    a: float = math.inf,
    ti: float = math.inf,
    static: float = 1.0,
) -> np.ndarray:
    return np.array([w, zeta, r, o, a, ti, static])


def reached(
    command: np.ndarray, drive: np.ndarray, parts: int = 1, start: float = 0.0, dt: float = H
) -> np.ndarray:
    """Positions (N,) at the instants of a command (N,) that runs straight between them, from
    rest.
    """
    state = np.array([start, 0.0, 0.0])
    out = [start]
    for before, after in pairwise(command):
        for a, b in pairwise(np.linspace(before, after, parts + 1)):
            at = drive_over(a, b, dt / parts, drive, state)
        out.append(at)
    return np.array(out)


def sweep() -> np.ndarray:
    t = np.arange(500) * H
    return 0.02 * np.sin(2.0 * np.pi * (0.2 + 0.15 * t) * t) + 0.01 * (t > 5.0)


@pytest.mark.parametrize("zeta", [0.05, 1.0, 2.0])
def test_without_friction_and_limit_it_is_the_second_order(zeta: float) -> None:
    kernel, w, u = np.empty((1, 5)), 25.0, sweep()
    second_order(w, zeta, H, 0.0, kernel[0])
    state = np.zeros((1, 2)), np.zeros((0, 2)), np.zeros(MEMORY), np.zeros(STATE)
    free, none = (math.inf, 0.0, 0.0), np.zeros((0, 5))
    expected = [0.0, *(follow(a, b, H, free, kernel, none, state) for a, b in pairwise(u))]
    # two poles that are one are taken 1e-6 apart there
    closed_form = 1e-13 if zeta != 1.0 else 1e-7
    np.testing.assert_allclose(reached(u, numbers(w, zeta)), expected, atol=closed_form)


@pytest.mark.parametrize(("bandwidth", "zeta"), [(5.0, 0.7), (80.0, 0.05), (0.3, 4.0)])
def test_a_controller_that_is_unstable_by_itself_is_refused(bandwidth: float, zeta: float) -> None:
    """The limit is where a pole of s^3 + 2 zeta w s^2 + w^2 s + w^2/T_i reaches the imaginary
    axis.
    """
    w, s = 2.0 * math.pi * bandwidth, scenario("ideal")
    least = 1.0 / (2.0 * zeta * w)
    for part, allowed in ((0.99, False), (1.01, True)):
        poles = np.roots([1.0, 2.0 * zeta * w, w * w, w * w / (part * least)])
        assert bool((poles.real < 0.0).all()) is allowed
        why = PlatformDrive(
            bandwidth=bandwidth, damping_ratio=zeta, integral_time=part * least
        ).unfit(s)
        assert (why is None) is allowed
    assert "allowed is more than" in (
        PlatformDrive(bandwidth=5.0, damping_ratio=0.0, integral_time=1.0).unfit(s) or ""
    )


def test_dry_friction_takes_twice_its_width_off_each_half_swing() -> None:
    """Released at 10.5 r without other damping: it turns at -8.5, 6.5, -4.5, 2.5 and -0.5 r, pi/w
    apart, and stays there, within r.
    """
    w, r = 20.0, 1e-3
    half = math.pi / w
    x = reached(np.zeros(9), numbers(w, 0.0, r), start=10.5 * r, dt=half)
    np.testing.assert_allclose(
        x / r, [10.5, -8.5, 6.5, -4.5, 2.5, -0.5, -0.5, -0.5, -0.5], atol=1e-11
    )


def test_on_a_ramp_it_trails_by_friction_and_damping() -> None:
    """2 zeta v/w as a linear drive, and r beside it; before it breaks loose, the command has to be
    r away.
    """
    w, zeta, r, v = 20.0, 0.8, 1e-3, 0.01
    u = v * H * np.arange(300)
    x = reached(u, numbers(w, zeta, r))
    assert not x[u <= r].any()
    assert x[u > r + v * H].all()
    assert u[-1] - x[-1] == pytest.approx(2.0 * zeta * v / w + r, abs=1e-12)


def test_at_its_limit_it_accelerates_evenly_and_tends_to_the_speed_that_damping_allows() -> None:
    w, a, r, o = 20.0, 3.0, 1e-3, 4e-4
    far = np.full(16, 1.0)
    t = np.arange(16) * H
    push = a + w * w * (o - r)
    np.testing.assert_allclose(
        reached(far, numbers(w, 0.0, r, o, a)), 0.5 * push * t**2, atol=1e-14
    )
    state = np.zeros(STATE)
    drive_over(100.0, 100.0, 2.0, numbers(w, 0.5, r, o, a), state)
    assert state[RATE] == pytest.approx(push / w, rel=1e-12)  # 2 zeta w = w


EVERYTHING = [
    numbers(60.0, 0.05),
    numbers(40.0, 0.05, 1e-3, 3e-4),
    numbers(40.0, 0.0, 1e-3),
    numbers(20.0, 0.7, 1e-3, 5e-4, 1.5),
    numbers(20.0, 0.7, 1e-3, 1e-3, ti=0.3),
    numbers(20.0, 0.5, 1e-3, 5e-4, 1.5, 0.3, 1.3),
    numbers(200.0, 2.0, 1e-4, -2e-4, 20.0),
]


@pytest.mark.parametrize("drive", EVERYTHING)
def test_it_does_not_hang_on_how_finely_a_tick_is_divided(drive: np.ndarray) -> None:
    rng = np.random.default_rng(5)
    for command in (sweep(), np.cumsum(np.repeat(rng.uniform(-0.05, 0.05, 60), 7)) * H):
        whole = reached(command, drive)
        for parts in (3, 20):
            np.testing.assert_allclose(reached(command, drive, parts), whole, atol=ROUND_OFF)


@pytest.mark.parametrize("drive", EVERYTHING[1:6])
def test_an_integrator_that_stops_at_each_switch_finds_the_same(drive: np.ndarray) -> None:
    """SciPy's DOP853 to 1e-12, started anew at each end of a tick and at each stop; the kink at the
    limit of the force it steps over, which costs it some digits.
    """
    w, zeta, r, o, a, ti, static = drive
    u = sweep()[:150]

    def force(x: float, q: float, now: float) -> float:
        return min(max(w * w * (now - x + q), -a), a) + w * w * o

    y, t, expected = np.zeros(3), 0.0, [0.0]
    for k, (before, after) in enumerate(pairwise(u)):
        slope, end = (after - before) / H, (k + 1) * H

        def command(at: float, k: int = k, before: float = before, slope: float = slope) -> float:
            return before + slope * (at - k * H)

        t, side = k * H, float(np.sign(y[1]))
        while t < end:
            if y[1] == 0.0:
                side = (
                    0.0
                    if abs(force(y[0], y[2], command(t))) <= w * w * r * static
                    else float(np.sign(force(y[0], y[2], command(t))))
                )

            def law(at: float, y: np.ndarray, side: float = side, command=command) -> list[float]:
                moving = (
                    (force(y[0], y[2], command(at)) - 2.0 * zeta * w * y[1] - w * w * r * side)
                    if side
                    else 0.0
                )
                return [y[1], moving, (command(at) - y[0]) / ti]

            def stops(at: float, y: np.ndarray, side: float = side) -> float:
                return y[1] * side

            def breaks(at: float, y: np.ndarray, command=command) -> float:
                return abs(force(y[0], y[2], command(at))) - w * w * r * static * (1.0 + 1e-13)

            event = stops if side else breaks
            event.terminal, event.direction = True, -1.0 if side else 1.0  # type: ignore[attr-defined]
            found = solve_ivp(
                law, (t, end), y, "DOP853", events=event, rtol=1e-12, atol=1e-14, max_step=H / 2
            )
            t, y = float(found.t[-1]), found.y[:, -1]
            if found.status == 1:
                y[1] = 0.0
                if side == 0.0:  # past the edge, by less than is compared
                    y[1] = 1e-13 * float(np.sign(force(y[0], y[2], command(t))))
                    side = float(np.sign(y[1]))
        expected.append(y[0])
    np.testing.assert_allclose(reached(u, drive), expected, atol=2e-9)


def _driven(s: Scenario, commands: np.ndarray, drive: PlatformDrive) -> np.ndarray:
    parameters = PlatformParameters(s.tick).with_effects([drive])
    start = approach_states([s.approach])
    run = np.zeros(1, dtype=int)
    return replay_platform([parameters], start, [s.substeps], commands[None], run)[0]


def test_an_axis_that_is_never_told_to_move_sags_under_a_load_beyond_its_friction() -> None:
    base = scenario("ideal")
    s = base.model_copy(
        update={"approach": base.approach.model_copy(update={"velocity": (0.0, 0.0, 0.0)})}
    )
    command = np.tile([*s.approach.offset, -s.approach.gap, 0.0, 0.0, 0.0, 1.0], (3000, 1))
    held = _driven(s, command, PlatformDrive(bandwidth=10.0, friction=2e-4, offset=1e-4))
    np.testing.assert_array_equal(held, np.tile(command[0, :3], (3000, 1)))
    sunk = _driven(
        s, command, PlatformDrive(bandwidth=10.0, damping_ratio=1.0, friction=2e-4, offset=5e-4)
    )
    # o - r: it creeps there and never swings past
    np.testing.assert_allclose(sunk[-1] - command[0, :3], 3e-4, atol=1e-9)


def test_what_it_is_worth_is_the_lateness_of_a_slow_motion() -> None:
    """2 zeta/w; with an integral part that of its phase, which is behind a slow swing by less."""
    s, w = scenario("ideal"), 2.0 * math.pi * 10.0
    effect = PlatformDrive(bandwidth=10.0, damping_ratio=0.5)
    assert effect.worth(s.tick, 1.0) == pytest.approx(1.0 / w)
    t = np.arange(4000) * 5e-3
    u = np.sin(3.0 * t)
    slow = PlatformDrive(bandwidth=10.0, damping_ratio=0.5, integral_time=0.5)
    late = slow.worth(s.tick, 3.0)
    assert late is not None
    x = reached(u, numbers(w, 0.5, ti=0.5), dt=5e-3)[2000:]
    a, b = np.linalg.lstsq(
        np.column_stack([np.sin(3.0 * t), np.cos(3.0 * t)])[2000:], x, rcond=None
    )[0]
    assert late == pytest.approx(-math.atan2(b, a) / 3.0, rel=1e-3)
