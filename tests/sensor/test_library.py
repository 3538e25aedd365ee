"""The sensor as a piece of its own: in Python, as a callback of MuJoCo, as an FMU."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hiltestbed.errors import InputError
from hiltestbed.sensor import ForceSensor, noise_like
from tests.scripts import module

EXAMPLE = Path(__file__).parents[2] / "examples" / "sensor" / "in_mujoco.py"


def test_a_ramp_is_read_late_scaled_and_mixed() -> None:
    effects = [
        {"kind": "sensor.gain", "factor": 1.1, "axis": "z"},
        {"kind": "sensor.crosstalk", "ratio": 0.02, "source": "z", "axis": "x"},
    ]
    sensor = ForceSensor(1000.0, {"delay": 0.0035, "quantisation": 0.01}, effects)
    wrenches = np.zeros((60, 6))
    wrenches[:, 2] = np.arange(60.0)
    readings = sensor.record(wrenches)
    late = np.arange(60.0)[4:] - 3.5
    np.testing.assert_allclose(readings[4:, 2], 1.1 * late, atol=0.005 + 1e-9)
    np.testing.assert_allclose(readings[4:, 0], 0.02 * 1.1 * late, atol=0.005 + 1e-9)
    sensor.reset()
    np.testing.assert_array_equal([sensor(w) for w in wrenches], readings)


def test_noise_has_the_colour_and_the_tone_of_a_record() -> None:
    rng, t = np.random.default_rng(3), np.arange(20_000) / 1000.0
    white = rng.standard_normal(len(t))
    slow = np.convolve(white, np.ones(8) / 8.0)[: len(t)]
    tone = np.sqrt(2.0) * np.sin(2.0 * np.pi * 50.0 * t)
    made = noise_like(np.column_stack([slow, tone]), 40_000, rng)
    assert made[:, 0].std() == pytest.approx(slow.std(), rel=0.05)
    # some 1 Hz wide for 40 s: 40 independent values of its power
    assert made[:, 1].std() == pytest.approx(1.0, rel=3.0 * 0.5 * (2.0 / 40.0) ** 0.5)
    # neighbours of a mean of 8 share 7 of them
    assert np.corrcoef(made[1:, 0], made[:-1, 0])[0, 1] == pytest.approx(7.0 / 8.0, abs=0.02)
    power = np.abs(np.fft.rfft(made[:, 1])) ** 2
    near = slice(49 * 40, 51 * 40 + 1)  # 1/40 Hz a bin
    assert power[near].sum() > 0.95 * power.sum()
    with pytest.raises(InputError, match="16 and more"):
        noise_like(np.zeros((4, 6)), 10, rng)


@pytest.mark.parametrize(
    ("settings", "effects", "words"),
    [
        ({"dely": 0.1}, [], "dely"),
        ({"delay": -0.1}, [], "greater than or equal to 0"),
        ({}, [{"kind": "sensor.gane"}], "did you mean 'sensor.gain'"),
        ({}, [{"kind": "contact.damping", "factor": 2.0}], "no effect of a sensor"),
    ],
)
def test_what_is_no_sensor_is_said(settings: dict, effects: list, words: str) -> None:
    with pytest.raises(InputError, match=words):
        ForceSensor(1000.0, settings, effects)
    with pytest.raises(InputError, match="allowed are"):
        ForceSensor(1000.0)(np.zeros(5))


def test_the_callback_of_mujoco_reads_the_force_of_ten_steps_before() -> None:
    true, measured = module(EXAMPLE).bounce(ForceSensor(2000.0, {"delay": 0.005})).T
    assert np.abs(true).max() > 1.0
    np.testing.assert_allclose(measured[10:], true[:-10], atol=1e-12)


def test_the_packed_sensor_is_that_in_python(tmp_path: Path, call) -> None:
    pytest.importorskip("pythonfmu3")
    from hiltestbed.devices.cosimulation import WRENCH, CoSimulation

    name = "04-bumper-delay-compensated"
    status, out, _ = call("fmu", name, "--part", "sensor", "--out", str(tmp_path))
    assert status == 0
    assert "wrench in, wrench_meas out" in out
    sensor = ForceSensor.from_scenario(name)
    inputs, outputs = ([f"{group}.{n}" for n in WRENCH] for group in ("wrench", "wrench_meas"))
    with CoSimulation(tmp_path / "Sensor.fmu", inputs, outputs) as packed:
        for k in range(40):
            wrench = np.array([0.0, 0.0, float(k), 0.0, 0.1 * k, 0.0])
            found = packed.step(wrench, 1.0 / sensor.rate)
            # the wrench is held over each of the steps between two readings
            expected = sensor(np.tile(wrench, (sensor.substeps, 1)))
            np.testing.assert_array_equal(found, expected)
    assert call("fmu", name, "--part", "both")[0] == 2
