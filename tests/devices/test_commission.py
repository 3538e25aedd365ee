"""Commissioning against an emulated facility with something hidden in it: found within 1 %, and
nothing found where nothing is.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed.devices.commission.procedure import Commissioned, commission, write_commission
from hiltestbed.devices.interface import DeviceError
from hiltestbed.diagnosis.diagnose import diagnose
from hiltestbed.diagnosis.investigate import CLOCKS
from hiltestbed.errors import InputError
from hiltestbed.frames import attitude_deg_from_quat, quat_from_attitude_deg, rotation_matrix
from hiltestbed.measured.load import load_dataset
from hiltestbed.scenario import load_scenario
from tests.devices.lockstep import against, scenario_of
from tests.slow import SLOW

BELIEVED: dict[str, Any] = {
    "rate": 500.0,
    "physics_rate": 2000.0,
    "devices__platform__travel_speed": 0.2,
    "sensor__noise": 0.1,
    "sensor__torque_noise": 0.01,
    "sensor__delay": 0.002,
}
CAPTURED: dict[str, Any] = BELIEVED | {
    "mechanism": {"kind": "latched", "contact": {"stiffness": 1.0e5, "damping": 200.0}},
    "rig__platform__tracking": "ideal",
    "approach": {"gap": 0.0, "velocity": [0.0, 0.0, 0.0]},
}
TURN = [3.0, -2.0, 30.0]
HIDDEN: dict[str, Any] = {
    "sensor__delay": 0.0063,
    "effects": [
        {"kind": "sensor.gain", "axis": "z", "factor": 1.08},
        {"kind": "sensor.crosstalk", "source": "z", "axis": "x", "ratio": 0.05},
        {"kind": "platform.delay", "delay": 0.0035},
    ],
    "devices__sensor__attitude_deg": TURN,
    "devices__sensor__sign": -1,
}


def _measured(
    name: str, believed: dict[str, Any], hidden: dict[str, Any], force: float = 100.0
) -> Commissioned:
    with against(scenario_of(name, "udp", **(believed | hidden)), "udp") as (options, _):
        return commission(scenario_of(name, "udp", **believed), options, force)


def _effects(result: Commissioned) -> dict[str, dict[str, Any]]:
    return {effect.kind: effect.model_dump() for effect in result.nominal.effects}


def _apart_deg(a: np.ndarray, b: np.ndarray) -> float:
    turn = rotation_matrix(a).T @ rotation_matrix(b)
    return float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0))))


@pytest.fixture(scope="module")
def captured() -> Commissioned:
    return _measured("13-ring-down", CAPTURED, HIDDEN)


def test_a_captured_mechanism_shows_everything_in_six_axes(captured: Commissioned) -> None:
    result, found = captured, _effects(captured)
    assert set(found) == {"sensor.gain", "sensor.crosstalk", "platform.delay"}
    assert found["sensor.gain"]["axis"] == "z"
    assert found["sensor.gain"]["factor"] - 1.0 == pytest.approx(0.08, rel=0.01)
    assert (found["sensor.crosstalk"]["source"], found["sensor.crosstalk"]["axis"]) == ("z", "x")
    assert found["sensor.crosstalk"]["ratio"] == pytest.approx(0.05, rel=0.01)
    assert found["platform.delay"]["delay"] == pytest.approx(0.0035, rel=0.01)
    assert result.nominal.sensor.delay == pytest.approx(0.0063, rel=0.01)
    assert result.sensor.sign == -1
    assert _apart_deg(result.sensor.attitude, quat_from_attitude_deg(TURN)) < 0.01 * 30.0
    assert result.nominal.sensor.noise == pytest.approx(0.1, rel=0.2)


@SLOW
def test_a_bumper_shows_what_its_one_direction_can() -> None:
    """Gain and delays; a leak of the force and a turn look like another turn and a leak of the
    torque, which is said.
    """
    result = _measured("02-bumper", BELIEVED, HIDDEN)
    found = _effects(result)
    assert found["sensor.gain"]["factor"] == pytest.approx(1.08, rel=2e-3)
    assert result.nominal.sensor.delay == pytest.approx(0.0063, rel=0.01)
    assert found["platform.delay"]["delay"] == pytest.approx(0.0035, rel=0.01)
    leak = next(n for n in result.sensor.numbers if n.source != n.axis)
    assert (leak.source, leak.axis) == ("z", "x")
    assert found["sensor.crosstalk"]["ratio"] == pytest.approx(0.05, abs=3.0 * leak.ci95)
    assert ("rx", "rz") in leak.or_else


ASKEW = [2.0, -3.0, 0.0]
MOUNTED_ASKEW: dict[str, Any] = {
    "sensor__delay": 0.0063,
    "effects": [{"kind": "sensor.rotation", "angles_deg": ASKEW}, *HIDDEN["effects"]],
}


@pytest.fixture(scope="module")
def askew() -> Commissioned:
    return _measured("02-bumper", BELIEVED, MOUNTED_ASKEW)


def _as_hidden(found: dict[str, dict[str, Any]], gain: float) -> None:
    """All that was hidden, within 1 % of its size, and of the gain within ``gain``."""
    assert set(found) == {"sensor.delay", *(e["kind"] for e in MOUNTED_ASKEW["effects"])}
    assert found["sensor.delay"]["delay"] == pytest.approx(0.0043, rel=0.01)
    off = np.subtract(found["sensor.rotation"]["angles_deg"], ASKEW)
    assert np.linalg.norm(off) < 0.01 * np.linalg.norm(ASKEW)
    assert found["sensor.gain"]["factor"] == pytest.approx(1.08, abs=gain)
    assert found["sensor.crosstalk"]["ratio"] == pytest.approx(0.05, rel=0.01)
    assert found["platform.delay"]["delay"] == pytest.approx(0.0035, rel=0.01)


@SLOW
def test_a_sensor_that_is_mounted_askew_is_told_beside_delay_gain_and_crosstalk(
    askew: Commissioned,
) -> None:
    """Gain and crosstalk as they are in the sensor's own axes."""
    found = {e["kind"]: e for e in askew.departures}
    _as_hidden(found, gain=0.01 * 0.08)
    assert found["sensor.gain"]["axis"] == "z"
    leak = found["sensor.crosstalk"]
    assert (leak["source"], leak["axis"]) == ("z", "x")
    # the data are as it was believed to be mounted
    assert tuple(askew.believed.devices.sensor.attitude_deg) == (0.0, 0.0, 0.0)
    mounted = quat_from_attitude_deg(askew.nominal.devices.sensor.attitude_deg)
    # a leak beside a turn, in P's axes
    assert _apart_deg(mounted, Rotation.from_rotvec(ASKEW, degrees=True).as_quat()) < 0.3


@SLOW
def test_a_diagnosis_of_the_dataset_says_the_same(askew: Commissioned, tmp_path: Path) -> None:
    """Four causes on one link; without a loop a late record cannot be told from a late sensor."""
    causes = diagnose(write_commission(askew, tmp_path / "facility") / "dataset.yaml").causes
    found = {c.effect: {n: p.estimate for n, p in c.parameters.items()} for c in causes}
    late = next(c for c in causes if c.effect in CLOCKS)
    assert {late.effect, *late.indistinguishable_from} == set(CLOCKS)
    found["sensor.delay"] = found.pop(late.effect)
    _as_hidden(found, gain=0.01 * 1.08)


def test_where_nothing_is_hidden_nothing_is_found() -> None:
    result = _measured("13-ring-down", CAPTURED, {})
    assert _effects(result) == {}
    assert result.departures == ()
    assert result.nominal.sensor.delay == pytest.approx(0.002, abs=3e-5)
    assert np.abs(attitude_deg_from_quat(result.sensor.attitude)).max() < 0.1


def test_the_folder_holds_scenarios_that_load_and_a_dataset_that_the_diagnosis_takes(
    captured: Commissioned, tmp_path: Path
) -> None:
    folder = write_commission(captured, tmp_path / "facility")
    assert load_scenario(folder / "nominal.yaml") == captured.nominal
    assert load_scenario(folder / "believed.yaml").sensor.delay == 0.002
    assert json.loads((folder / "commission.json").read_text())["sensor"]["sign"] == -1
    dataset = load_dataset(folder / "dataset.yaml")
    record = dataset.runs[0].record.data
    assert set(record) >= {"pose_cmd", "pose_act", "wrench_meas"}
    # a push is positive again, in P: the sign was found
    assert record["pose_act"][:, 2] @ record["wrench_meas"][:, 2] > 0.0


def test_unarmed_it_moves_nothing_and_says_so() -> None:
    with against(scenario_of("02-bumper", "udp"), "udp", armed=False) as (options, emulator):
        with pytest.raises(InputError, match="--arm"):
            commission(scenario_of("02-bumper", "udp"), options)
        assert not emulator.platform.commanded


def test_a_force_that_is_passed_stops_it_with_the_platform_held() -> None:
    believed = scenario_of("02-bumper", "udp", safety__force=130.0)
    stiffer = scenario_of("02-bumper", "udp", mechanism__contact__stiffness=3.0e5)
    with against(stiffer, "udp") as (options, emulator):
        with pytest.raises(DeviceError, match=r"the sensor carries .* safety.force is 130 N"):
            commission(believed, options)
        assert np.abs(emulator.rig.true_wrench[:3]).max() < 200.0
