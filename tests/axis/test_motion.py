"""The motion of a driven axis against closed forms, and its inverse against the motion."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hiltestbed.axis import law
from hiltestbed.axis.models import AxisRun, model_of
from hiltestbed.axis.motion import averaged, motion_of
from hiltestbed.inference.likelihood import Likelihood
from hiltestbed.inference.model import Hypothesis
from tests.axis.machines import slid
from tests.axis.test_recovery import found

ROW = 0.002  # [s]
MASS, VISCOUS, COULOMB = 1.2, 20.0, 8.0
FOUND = ("dynamics.mass", "dynamics.force")
NOTHING = Hypothesis((), np.zeros(0), np.zeros(1))


def numbers(**given: float) -> np.ndarray:
    """(NUMBERS,) of a law."""
    out = law.AxisLaw(given.pop("mass", MASS), 1.0, given.pop("spring", 0.0)).numbers
    for name, value in given.items():
        out[getattr(law, name)] = value
    return out


def rows(seconds: float) -> np.ndarray:
    return np.arange(int(round(seconds / ROW)) + 1) * ROW


def test_a_constant_force_gives_the_exponential_approach_to_its_speed():
    t, force = rows(0.5), 30.0
    p = numbers(VISCOUS=VISCOUS, VISCOUS_BACK=VISCOUS, BEYOND=VISCOUS, COULOMB=COULOMB)
    x = law.motion_under(t, np.full(len(t), force), 0.0, 0.0, 0.0, p, 1e-3)
    speed, slow = (force - COULOMB) / VISCOUS, VISCOUS / MASS
    expected = speed * (t - (1.0 - np.exp(-slow * t)) / slow)
    # the mean of two speeds of a step h stands for its integral: (slow h)^2/12 of it
    assert np.abs(x - expected).max() < speed / slow * (slow * 1e-3) ** 2 / 12.0 * 1.01


def test_dry_friction_stops_an_axis_where_its_speed_is_spent_and_holds_it():
    t = rows(1.0)
    p = numbers(COULOMB=COULOMB, COULOMB_BACK=COULOMB)
    for push in (0.0, 0.99 * COULOMB):
        x = law.motion_under(t, np.full(len(t), push), 0.0, 0.3, -0.2, p, 1e-3)
        assert x[-1] == pytest.approx(0.3 - 0.5 * MASS * 0.2**2 / (COULOMB + push), abs=1e-12)
        assert x[-1] == x[-100]


def test_an_oscillation_converges_with_the_square_of_the_step():
    t, spring = rows(2.0), 900.0
    w = math.sqrt(spring / MASS)
    p, none = numbers(spring=spring), np.zeros(len(t))
    wrong = [
        np.abs(law.motion_under(t, none, 0.0, 0.01, 0.0, p, h) - 0.01 * np.cos(w * t)).max()
        for h in (1e-3, 5e-4)
    ]
    assert wrong[0] / wrong[1] == pytest.approx(4.0, rel=0.02)
    assert wrong[1] < 0.01 * w * 2.0 * (w * 5e-4) ** 2 / 24.0 * 1.1  # the phase of a leapfrog


@pytest.mark.parametrize("late", [-0.0007, 0.0, 0.0013])
def test_an_input_acts_from_its_row_on_and_as_much_later_as_its_stamps(late):
    t = rows(0.3)
    u = np.where(t >= 0.1 - 0.5 * ROW, 6.0, 0.0)
    x = law.motion_under(t, u, late, 0.0, 0.0, numbers(), 1e-3)
    since = np.maximum(t - 0.1 - late, 0.0)
    assert x == pytest.approx(0.5 * 6.0 / MASS * since**2, abs=1e-12)


def held(seed: int) -> AxisRun:
    """A carriage under a force that is drawn anew every 0.4 s, 500 Hz; 2 um of noise."""
    rng, fine = np.random.default_rng(seed), 100
    u = np.repeat(rng.uniform(-30.0, 30.0, 20), 200)
    h, x, v, y = ROW / fine, 0.0, 0.0, np.zeros(len(u))
    for k, force in enumerate(u):
        y[k] = x
        for _ in range(fine):
            new = slid(v, force - VISCOUS * v, COULOMB, h, MASS)
            x, v = x + 0.5 * h * (v + new), new
    y += 2e-6 * rng.standard_normal(len(u))
    return AxisRun(f"run {seed}", rows((len(u) - 1) * ROW), u, y)


def test_an_acceleration_is_compared_with_what_is_averaged_like_it():
    rng = np.random.default_rng(3)
    a = rng.normal(size=600)
    x = np.concatenate([[0.0, 0.0], np.cumsum(np.cumsum(a))]) * ROW**2
    motion = motion_of(rows((len(x) - 1) * ROW), x)
    half = motion.window // 2 + 1
    # the second difference about a row is the acceleration that begins there
    expected = averaged(a, motion.window)[half:-half]
    assert motion.a[1:-1][half:-half] == pytest.approx(expected, abs=1e-9)


def test_a_force_that_jumps_gives_back_what_resists_to_a_thousandth():
    runs = [held(seed) for seed in (0, 1)]
    _, causes, c = found("drive", runs, {"mass": 1.0})
    assert set(causes) == set(FOUND)
    force = causes["dynamics.force"].parameters
    assert causes["dynamics.mass"].parameters["factor"][0] == pytest.approx(MASS, rel=1e-3)
    assert force["viscous"][0] == pytest.approx(VISCOUS, rel=1e-3)
    assert force["coulomb"][0] == pytest.approx(COULOMB, rel=1e-3)
    # an inverse model whose friction turned at once, beside a smoothed force, gave 3 % less
    model = model_of("drive", runs, {"mass": MASS, "viscous": VISCOUS, "coulomb": COULOMB})
    for left, u in zip(model.residuals(NOTHING), (r.u for r in runs), strict=False):
        assert np.std(left) < 0.02 * np.std(u)
    assert np.all(c.after < 0.01 * c.before)


def test_noise_of_the_position_biases_neither_the_mass_nor_the_time_stamps():
    """The noise is that of an acceleration as large as the motion's. What is predicted from it was
    shifted between rows, which averages neighbours: the fit took that for a time-stamp offset of
    half a row; and noise in a regressor makes its coefficient smaller.
    """
    rng = np.random.default_rng(5)
    runs = [held(seed) for seed in (0, 1, 2)]
    runs = [r._replace(y=r.y + 1e-5 * rng.standard_normal(len(r.y))) for r in runs]
    model = model_of("drive", runs, {"mass": 1.0})
    wanted = (("viscous",), ("coulomb",), ("factor",))
    causes = [c for c in model.candidates() if c.kind in FOUND and c.names in wanted]
    starts = [np.array([c.grid[0][0] for c in causes])]
    likelihood = Likelihood(model, np.array([float(len(x)) for x in model.scored(NOTHING)]))
    fit = likelihood.fit(causes, starts)
    values = dict(zip([c.names[0] for c in causes], fit.of.theta, strict=True))
    assert values["factor"] == pytest.approx(MASS, rel=5e-3)
    assert values["viscous"] == pytest.approx(VISCOUS, rel=5e-4)
    assert values["coulomb"] == pytest.approx(COULOMB, rel=5e-4)
    assert abs(fit.of.nuisances[0]) < 0.1 * ROW
