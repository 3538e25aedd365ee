"""The sensor's chain: delay of any length, filters against their closed forms, noise that does not
depend on the batch.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from scipy.signal import lsim

from hiltestbed.effects import EFFECTS
from hiltestbed.sensor.parameters import SensorParameters
from hiltestbed.sensor.sensor import Sensors
from hiltestbed.sensor.settings import Sensor

RATE, SUBSTEPS = 1000.0, 4


def sensor(settings: dict | None = None, effects: Sequence[dict] = ()) -> SensorParameters:
    nominal = SensorParameters.believed(Sensor.model_validate(settings or {}))
    return nominal.with_effects(EFFECTS[e["kind"]].model_validate(e) for e in effects)


def readings(signal, ticks=200, sensors=None, rate=RATE, substeps=SUBSTEPS):
    """(ticks, n, 6) readings of the wrench `signal(t)` -> (..., 6)."""
    sensors = sensors or [sensor()]
    n = len(sensors)
    block = Sensors(sensors, 1.0 / rate, substeps, [np.random.default_rng(5 + i) for i in range(n)])
    out = np.empty((ticks, n, 6))
    for k in range(ticks):
        t = k / rate + np.arange(1 - substeps, 1) / (rate * substeps)
        out[k] = block.read(k, np.repeat(signal(np.maximum(t, 0.0))[None], n, axis=0))
    return out


def ramp(t):
    return np.asarray(t)[..., None] * np.array([1.0, -2.0, 300.0, 4.0, 5.0, 6.0])


def test_without_delay_the_reading_is_the_wrench_itself():
    t = np.arange(200) / RATE
    assert np.array_equal(readings(ramp)[:, 0], ramp(t))


@pytest.mark.parametrize("delay", [0.001, 0.005, 0.00025, 0.0033, 0.00417])
def test_a_linear_wrench_arrives_late_by_any_delay(delay):
    t = np.arange(200) / RATE
    expected = ramp(np.maximum(t - delay, 0.0))
    got = readings(ramp, sensors=[sensor({"delay": delay})])[:, 0]
    late = t - delay >= 0  # the step in slope at t = 0 lies between two instants
    assert np.allclose(got[late], expected[late], rtol=0, atol=1e-9)
    assert np.all(got[t < delay - 1 / RATE] == 0)


def test_effect_and_nominal_delay_add():
    two = readings(
        ramp, sensors=[sensor({"delay": 0.002}, [{"kind": "sensor.delay", "delay": 0.0013}])]
    )
    one = readings(ramp, sensors=[sensor({"delay": 0.0033})])
    assert np.allclose(two, one, atol=1e-9)


def low_pass(T):
    return ([1.0], [T, 1.0])


def high_pass(T):
    return ([T, 0.0], [T, 1.0])


@pytest.mark.parametrize(("rate", "substeps", "delay"), [(250.0, 2, 0.0), (1000.0, 4, 0.0033)])
@pytest.mark.parametrize(
    ("settings", "effects", "law", "T"),
    [
        ({"lowpass": 1.0 / (2.0 * math.pi * 0.004)}, [], low_pass, 0.004),
        ({}, [{"kind": "sensor.lag", "time_constant": 0.0015}], low_pass, 0.0015),
        ({"time_constant": 0.05}, [], high_pass, 0.05),
        ({}, [{"kind": "sensor.highpass", "time_constant": 0.02}], high_pass, 0.02),
    ],
)
def test_a_filter_is_analogue_whatever_the_rate(rate, substeps, delay, settings, effects, law, T):
    """Against scipy's integration of the same transfer function, of a force that is linear between
    the physics instants: a step to 40 N, then a half sine.
    """
    one = sensor(settings | {"delay": delay}, effects)
    instants = np.arange(120 * substeps) / (rate * substeps)
    force = 40.0 * (instants > 0.1) + 300.0 * np.sin(20.0 * instants).clip(0.0)

    def signal(t):
        return np.interp(t, instants, force)[..., None] * np.ones(6)

    got = readings(signal, 120, [one], rate, substeps)[:, 0, 2]
    fine = np.linspace(0.0, instants[-1], 20 * (len(instants) - 1) + 1)
    late = np.interp(fine - delay, instants, force, left=0.0)
    at = np.arange(119) / rate
    expected = np.interp(at, fine, lsim(law(T), late, fine)[1])
    # the corners of the delayed force lie between two instants; the reading interpolates them
    assert np.allclose(got[:119], expected, atol=1e-6 if delay == 0.0 else 1.0)


def test_static_effects_follow_their_equations():
    effects = [
        {"kind": "sensor.gain", "factor": 1.1, "axis": "z"},
        {"kind": "sensor.crosstalk", "ratio": 0.02, "source": "z", "axis": "x"},
        {"kind": "sensor.bias", "force": [0.1, 0.2, 0.3], "torque": [0, 0, 0.4]},
        {"kind": "sensor.drift", "rate": 2.0, "axis": "y"},
        {"kind": "sensor.hum", "frequency": 50.0, "amplitude": 0.5, "phase": 0.3, "axis": "y"},
        {"kind": "sensor.saturation", "limit": 40.0},
    ]
    t = np.arange(200) / RATE
    w = ramp(t)
    expected = w.copy()
    expected[:, 2] *= 1.1
    expected[:, 0] += 0.02 * expected[:, 2]
    expected[:, 1] += 2.0 * t + 0.5 * np.sin(2 * np.pi * 50 * t + 0.3)
    expected += [0.1, 0.2, 0.3, 0, 0, 0.4]
    expected[:, :3] = np.clip(expected[:, :3], -40, 40)
    assert np.allclose(readings(ramp, sensors=[sensor(effects=effects)])[:, 0], expected, atol=1e-9)


def test_dead_zone_and_quantisation():
    got = readings(
        ramp,
        sensors=[sensor({"quantisation": 0.5}, [{"kind": "sensor.deadzone", "width": 10.0}])],
    )[:, 0, 2]
    true = ramp(np.arange(200) / RATE)[:, 2]
    assert np.all(got[true < 9.9] == 0)
    assert np.all(np.abs(got - true)[true > 10] <= 0.25 + 1e-9)
    assert np.allclose(got / 0.5, np.round(got / 0.5))


def test_noise_has_its_level_and_does_not_depend_on_the_batch():
    noisy = sensor({"noise": 0.2, "torque_noise": 0.01})
    still = lambda t: np.zeros((*np.shape(t), 6))  # noqa: E731
    alone = readings(still, 600, [noisy])
    batch = readings(still, 600, [noisy, sensor({"noise": 5.0}), noisy])
    assert np.array_equal(alone[:, 0], batch[:, 0])
    assert not np.array_equal(batch[:, 0], batch[:, 2])  # another run, another stream
    assert alone[..., :3].std() == pytest.approx(0.2, rel=4 / math.sqrt(2 * 1800))
    assert alone[..., 3:].std() == pytest.approx(0.01, rel=4 / math.sqrt(2 * 1800))


def test_jitter_spreads_the_delay_of_a_ramp():
    jitter = sensor({"delay": 0.01}, [{"kind": "sensor.jitter", "sigma": 0.0005}])
    got = readings(ramp, 900, [jitter])[:, 0, 2]
    late = np.arange(900)[50:] / RATE - got[50:] / 300.0
    assert late.mean() == pytest.approx(0.01, abs=4 * 0.0005 / math.sqrt(850))
    assert late.std() == pytest.approx(0.0005, rel=4 / math.sqrt(2 * 850))
