"""Recursive identification: a planted k and c must be found, through delay, filters and noise."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hiltestbed import build, load_scenario
from hiltestbed.identification.least_squares import RecursiveLeastSquares
from hiltestbed.identification.methods.rls import Rls
from tests.physics.closed_forms import bounce

SCENARIO = "04-bumper-delay-compensated"
K, C, MU, V0 = 1.0e5, 400.0, 400.0, 0.03


def _identify(scenarios, offset: float = 0.0) -> RecursiveLeastSquares:
    first = scenarios[0]
    t = np.arange(-0.05, 0.4, 1.0 / (first.rate * first.substeps))
    x, v, force = bounce(K, C, MU, V0, t)
    n, m = len(scenarios), first.substeps
    sensor = build.sensors(scenarios)
    estimator = Rls.start(scenarios)
    pose, twist, wrench = np.zeros((n, 7)), np.zeros((n, 6)), np.zeros((n, m, 6))
    pose[:, 6] = 1.0
    for k in range(1, len(x) // m):
        now = k * m
        wrench[:, :, 2] = force[now - m + 1 : now + 1]
        pose[:, 2], twist[:, 2] = x[now] + offset, v[now]
        estimator.update(sensor.read(k - 1, wrench), pose, twist)
    return estimator


@pytest.mark.parametrize(
    "sensor",
    [
        *({"delay": d, "lowpass": f} for d in (0.0, 0.00537, 0.02) for f in (None, 50.0)),
        {"time_constant": 1.0},
    ],
    ids=str,
)
@pytest.mark.parametrize("offset", [0.0, 2e-4])
def test_neither_delay_nor_filter_nor_a_touch_point_that_is_off_biases_the_estimate(
    sensor: dict[str, float | None], offset: float
) -> None:
    """What is left is interpolation and the tick-wise filter: below 0.1 % of k, 1 % of c."""
    keys = {f"sensor.{key}": value for key, value in sensor.items()}
    s = {"sensor.noise": 0.0, "rig.platform.tracking": "servo"} | keys
    estimator = _identify([load_scenario(SCENARIO, set=s)], offset)
    assert estimator.stiffness[0, 2] == pytest.approx(K, rel=1e-3)
    assert estimator.damping[0, 2] == pytest.approx(C, rel=1e-2)


def test_the_scatter_is_what_theory_says_and_what_is_reported() -> None:
    """sd(k)/k = (sigma/F_peak) sqrt(2/N), sd(c)/c = that/(2 zeta), over an exact half cycle; the
    intercept makes sd(k) larger.

    With the intercept k is told from the force's variance about its mean: for a half sine var = 1/2
    - (2/pi)^2, against 1/2 about zero, so sd(k) grows by sqrt(0.5/(0.5 - 4/pi^2)) = 2.3.
    """
    s = {"rig.platform.tracking": "servo"}
    runs = 200
    estimator = _identify([load_scenario(SCENARIO, set=s | {"seed": i}) for i in range(runs)])
    # closed form of the peak force at zeta = 0.032
    sigma, peak = 0.38, 0.03 * math.sqrt(K * MU) * 0.955
    samples = estimator.samples[0, 2]
    zeta = C / (2.0 * math.sqrt(K * MU))
    sd_k = K * sigma / peak * math.sqrt(2.0 / samples) * math.sqrt(0.5 / (0.5 - 4.0 / math.pi**2))
    sd_c = C * sigma / peak * math.sqrt(2.0 / samples) / (2.0 * zeta)
    k, c = estimator.stiffness[:, 2], estimator.damping[:, 2]
    spread = 3.0 / math.sqrt(2.0 * runs)  # three standard deviations of a standard deviation
    assert k.std() == pytest.approx(sd_k, rel=spread)
    assert c.std() == pytest.approx(sd_c, rel=spread)
    assert estimator.stiffness_sd[:, 2].mean() == pytest.approx(k.std(), rel=spread)
    assert estimator.damping_sd[:, 2].mean() == pytest.approx(c.std(), rel=spread)
    assert abs(k.mean() - K) < 4.0 * sd_k / math.sqrt(runs)
    assert abs(c.mean() - C) < 4.0 * sd_c / math.sqrt(runs)


def test_an_axis_without_force_gives_no_estimate() -> None:
    estimator = _identify([load_scenario(SCENARIO)])
    assert np.isnan(estimator.stiffness[0, [0, 1, 3, 4, 5]]).all()
