"""What a residual looks like: planted in a damper that its nominal model describes but for that."""

from __future__ import annotations

import numpy as np
import pytest

from hiltestbed.axis.models import AxisRun, model_of
from hiltestbed.axis.remainder import Remainder, remainder_of
from hiltestbed.inference.likelihood import Likelihood

NOISE = 1.0  # [N]
RATE = 500.0  # [Hz]


def left_by(planted, runs: int = 2) -> Remainder:
    """What the nominal model of 500 N s/m leaves of ``planted(run, t, x, v)`` [N] and white noise."""
    rng, records = np.random.default_rng(5), []
    for run in range(runs):
        t = np.arange(4000) / RATE
        w = 2.0 * np.pi * (0.4 + 0.1 * run)
        x = 0.02 * np.sin(w * t) + 0.01 * np.sin(2.7 * w * t)
        v = 0.02 * w * np.cos(w * t) + 0.027 * w * np.cos(2.7 * w * t)
        force = 500.0 * v + planted(run, t, x, v) + NOISE * rng.standard_normal(len(t))
        records.append(AxisRun(f"run {run}", t, x, force))
    model = model_of("damper", records, {"damping": 500.0})
    likelihood = Likelihood(model, np.full(runs, 1000.0))
    return remainder_of(model, likelihood.start(), np.full(runs, NOISE))


def test_noise_follows_nothing_and_stands_nowhere() -> None:
    found = left_by(lambda run, t, x, v: 0.0 * t)
    assert found.follows is None
    assert found.dense is None
    assert found.run == ""
    assert found.rms == pytest.approx((NOISE, NOISE), rel=0.05)
    assert "it follows neither position nor speed" in found.words()


def test_dry_friction_follows_the_speed_by_its_share_of_the_squares() -> None:
    found = left_by(lambda run, t, x, v: 3.0 * np.sign(v))
    assert found.follows.quantity == "speed"
    # less what as many means of the independent samples would hold by chance
    assert 0.75 < found.follows.share < 9.0 / (9.0 + NOISE**2) + 0.01
    assert abs(found.follows.mean) == pytest.approx(3.0, rel=0.1)
    speed = 2.0 * np.pi * 0.45 * np.hypot(0.02, 0.027) / np.sqrt(2.0)
    assert found.signal == pytest.approx(500.0 * speed, rel=0.1)


def test_a_stop_stands_where_it_is() -> None:
    found = left_by(lambda run, t, x, v: 2e3 * np.maximum(x - 0.02, 0.0))
    assert found.dense.quantity == "position"
    assert 0.02 < found.dense.low < found.dense.high < 0.031


def test_a_tone_is_told_by_its_frequency_and_a_run_by_its_name() -> None:
    found = left_by(lambda run, t, x, v: run * 20.0 * np.sin(2.0 * np.pi * 37.0 * t))
    low, high = found.band
    assert 35.0 < low < 37.0 < high < 39.0
    assert found.run == "run 1"


def test_an_event_is_told_by_its_time() -> None:
    found = left_by(lambda run, t, x, v: 30.0 * ((t > 6.0) & (t < 6.2)))
    assert found.dense.quantity == "time"
    assert found.dense.low == pytest.approx(6.0, abs=0.1)
    assert found.dense.high == pytest.approx(6.2, abs=0.1)
