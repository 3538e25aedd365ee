"""FMI 3.0: a packed physical side passes FMPy's validation and steps as the one that was packed."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

from hiltestbed.devices.fmu import CoSimulation, pack
from hiltestbed.devices.interface import DeviceError
from hiltestbed.errors import InputError

fmpy = pytest.importorskip("fmpy")
pytest.importorskip("pythonfmu3")

PERIOD, STIFFNESS = 0.001, 1.0e4
COMMAND = [f"pose_cmd.{name}" for name in ("px", "py", "pz", "qx", "qy", "qz", "qw")]
WRENCH = [f"wrench_meas.{name}" for name in ("fx", "fy", "fz", "tx", "ty", "tz")]


class Spring:
    """A platform that is where it was told to be, and a spring from pz = 0 on."""

    def __init__(self, scenario: Path) -> None:
        assert scenario.read_text(encoding="utf-8") == "name: bounce\n"
        self.period = PERIOD
        self.pose = np.array([0.0, 0.0, -0.001, 0.0, 0.0, 0.0, 1.0])
        self.wrench = np.zeros(6)

    def step(self, pose_cmd: np.ndarray) -> None:
        self.pose[:] = pose_cmd
        self.wrench[2] = STIFFNESS * max(float(self.pose[2]), 0.0)


def make(scenario: Path) -> Spring:
    return Spring(scenario)


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fmu")
    scenario = folder / "scenario.yaml"
    scenario.write_text("name: bounce\n", encoding="utf-8")
    return pack("tests.devices.test_fmu:make", scenario, folder, name="SpringRig")


def test_the_validation_of_fmpy_finds_nothing(packed: Path) -> None:
    from fmpy.validation import validate_fmu

    assert packed.name == "SpringRig.fmu"
    assert validate_fmu(str(packed)) == []
    description = fmpy.read_model_description(str(packed))
    assert description.fmiVersion == "3.0"
    assert {v.name for v in description.modelVariables if v.causality == "input"} == set(COMMAND)


def _bounce(step) -> list[float]:
    """A mass of 10 kg at 0.1 m/s against the rig, semi-implicit Euler: pz at each tick."""
    z, v, path = -0.001, 0.1, []
    force = 0.0
    for _ in range(300):
        v -= force / 10.0 * PERIOD
        z += v * PERIOD
        force = step(np.array([0.0, 0.0, z, 0.0, 0.0, 0.0, 1.0]))
        path.append(z)
    return path


def test_a_bounce_against_the_fmu_is_that_against_what_was_packed(packed: Path, tmp_path: Path) -> None:
    scenario = tmp_path / "scenario.yaml"
    scenario.write_text("name: bounce\n", encoding="utf-8")
    side = Spring(scenario)

    def directly(pose: np.ndarray) -> float:
        side.step(pose)
        return float(side.wrench[2])

    with CoSimulation(packed, COMMAND, WRENCH) as fmu:
        np.testing.assert_array_equal(_bounce(lambda pose: fmu.step(pose, PERIOD)[2]), _bounce(directly))


def test_a_step_of_several_ticks_and_one_that_is_no_whole_number(packed: Path) -> None:
    pose = np.array([0.0, 0.0, 0.002, 0.0, 0.0, 0.0, 1.0])
    with CoSimulation(packed, COMMAND, WRENCH) as fmu:
        assert fmu.step(pose, 5 * PERIOD)[2] == pytest.approx(STIFFNESS * 0.002)
        with pytest.raises(DeviceError, match=r"the FMU failed at t = 0.005000 s"):
            fmu.step(pose, 0.0015)


def test_what_is_wrong_is_said(packed: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"wrench_meas.fw: is no output of type Float64 \(did you mean 'wrench_meas.f.'\?\)"):
        CoSimulation(packed, COMMAND, ["wrench_meas.fw"])
    other = tmp_path / "other.fmu"
    other.write_text("nothing", encoding="utf-8")
    with pytest.raises(InputError, match=r"is not an FMU; give a file that a simulation tool has exported"):
        CoSimulation(other, [], [])
    with zipfile.ZipFile(other, "w") as archive:
        archive.writestr("modelDescription.xml", "<fmiModelDescription fmiVersion='3.0'/>")
    with pytest.raises(InputError, match=r"other.fmu: modelDescription: "):
        CoSimulation(other, [], [])
    with pytest.raises(InputError, match=r"'no.such.module:make' names no function"):
        pack("no.such.module:make", other, tmp_path)
    with pytest.raises(InputError, match=r"name: is no name of an FMU \(got 'my rig'\)"):
        pack("tests.devices.test_fmu:make", other, tmp_path, name="my rig")
