"""FMI 3.0: a packed physical side passes FMPy's validation and steps as the one that was packed."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hiltestbed.analysis.ledger import contact_frequency
from hiltestbed.analysis.stability import stability
from hiltestbed.devices.fmu import POSE, CoSimulation, pack
from hiltestbed.devices.fmu import WRENCH as AXES
from hiltestbed.devices.interface import DeviceError
from hiltestbed.errors import InputError
from hiltestbed.numerical_model.bodies import effective_mass
from hiltestbed.numerical_model.model import NumericalModel
from hiltestbed.scenario import dump_scenario, load_scenario
from tests.running import run

fmpy = pytest.importorskip("fmpy")
pytest.importorskip("pythonfmu3")
from fmpy.validation import validate_fmu  # noqa: E402
from pythonfmu3.builder import FmuBuilder  # noqa: E402

PERIOD, STIFFNESS = 0.001, 1.0e4
COMMAND = [f"pose_cmd.{name}" for name in POSE]
WRENCH = [f"wrench_meas.{name}" for name in AXES]


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


def packed_in(folder: Path, name: str) -> Path:
    scenario = folder / "scenario.yaml"
    scenario.write_text("name: bounce\n", encoding="utf-8")
    return pack("tests.devices.test_fmu:make", scenario, folder, name=name)


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return packed_in(tmp_path_factory.mktemp("fmu"), "SpringRig")


def test_the_validation_of_fmpy_finds_nothing(packed: Path) -> None:
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


def test_a_bounce_against_the_fmu_is_that_against_what_was_packed(
    packed: Path, tmp_path: Path
) -> None:
    scenario = tmp_path / "scenario.yaml"
    scenario.write_text("name: bounce\n", encoding="utf-8")
    side = Spring(scenario)

    def directly(pose: np.ndarray) -> float:
        side.step(pose)
        return float(side.wrench[2])

    with CoSimulation(packed, COMMAND, WRENCH) as fmu:
        np.testing.assert_array_equal(
            _bounce(lambda pose: fmu.step(pose, PERIOD)[2]), _bounce(directly)
        )


def test_a_step_of_several_ticks_and_one_that_is_no_whole_number(packed: Path) -> None:
    pose = np.array([0.0, 0.0, 0.002, 0.0, 0.0, 0.0, 1.0])
    with CoSimulation(packed, COMMAND, WRENCH) as fmu:
        assert fmu.step(pose, 5 * PERIOD)[2] == pytest.approx(STIFFNESS * 0.002)
        with pytest.raises(DeviceError, match=r"the FMU failed at t = 0.005000 s"):
            fmu.step(pose, 0.0015)


def test_what_is_wrong_is_said(packed: Path, tmp_path: Path) -> None:
    with pytest.raises(
        InputError,
        match=r"wrench_meas.fw: is no output of type Float64 \(did you mean 'wrench_meas.f.'\?\)",
    ):
        CoSimulation(packed, COMMAND, ["wrench_meas.fw"])
    other = tmp_path / "other.fmu"
    other.write_text("nothing", encoding="utf-8")
    with pytest.raises(
        InputError, match=r"is not an FMU; give a file that a simulation tool has exported"
    ):
        CoSimulation(other, [], [])
    with zipfile.ZipFile(other, "w") as archive:
        archive.writestr("modelDescription.xml", "<fmiModelDescription fmiVersion='3.0'/>")
    with pytest.raises(InputError, match=r"other.fmu: modelDescription: "):
        CoSimulation(other, [], [])
    with pytest.raises(InputError, match=r"'no.such.module:make' names no function"):
        pack("no.such.module:make", other, tmp_path)
    with pytest.raises(InputError, match=r"name: is no name of an FMU \(got 'my rig'\)"):
        pack("tests.devices.test_fmu:make", other, tmp_path, name="my rig")


RIG = Path(__file__).parents[2] / "scenarios" / "02-bumper.yaml"
SHORT = {
    "duration": 0.9,
    "compensation.force.kind": "none",
    "identification": {"kind": "none"},
    "sensor.noise": 0.0,
}


def test_the_rig_of_a_scenario_in_fmpy_bounces_as_the_run_does(tmp_path: Path) -> None:
    scenario = load_scenario(RIG, SHORT)
    file = tmp_path / "scenario.yaml"
    file.write_text(dump_scenario(scenario), encoding="utf-8")
    packed = pack("hiltestbed.devices.physical:from_file", file, tmp_path)
    alone = run(scenario).trace
    assert alone is not None
    model, wrench = NumericalModel([scenario]), np.zeros(6)
    with CoSimulation(packed, COMMAND, WRENCH) as fmu:
        path = np.empty((scenario.ticks, 7))
        for k in range(scenario.ticks):
            model.advance(wrench[None])
            path[k] = model.pose[0]
            wrench = fmu.step(model.pose[0], scenario.tick)
    assert path[-1, 2] < 0.0 < path[:, 2].max()  # in, and out again
    np.testing.assert_allclose(path, alone["pose_cmd"], atol=1e-6)


OK = "return Fmi3StepResult(status=Fmi3Status.ok)"
_MODEL = '''
from pythonfmu3 import Fmi3Causality, Fmi3Slave, Fmi3StepResult, Fmi3Status, Float64


class Vehicles(Fmi3Slave):
    """Two point masses on a line: semi-implicit, or exact for a force that is held over the
    step.
    """

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.time, self.force = 0.0, 0.0
        self.z, self.v = {start}, {speed}
        self.register_variable(Float64("time", causality=Fmi3Causality.independent, getter=lambda: self.time))
        for name in ("fx", "fy", "fz", "tx", "ty", "tz"):
            taken = self.take if name == "fz" else (lambda value: None)
            shown = (lambda: self.force) if name == "fz" else (lambda: 0.0)
            self.register_variable(
                Float64("wrench." + name, causality=Fmi3Causality.input, start=0.0, getter=shown, setter=taken), nested=False
            )
        values = dict.fromkeys(["pose.px", "pose.py", "pose.qx", "pose.qy", "pose.qz"], 0.0) | {{"pose.qw": 1.0}}
        values |= dict.fromkeys(["twist.vx", "twist.vy", "twist.wx", "twist.wy", "twist.wz"], 0.0)
        for name, value in values.items():
            self.register_variable(Float64(name, causality=Fmi3Causality.output, getter=lambda value=value: value), nested=False)
        self.register_variable(Float64("pose.pz", causality=Fmi3Causality.output, getter=lambda: self.z), nested=False)
        self.register_variable(Float64("twist.vz", causality=Fmi3Causality.output, getter=lambda: self.v), nested=False)

    def take(self, value):
        self.force = value

    def do_step(self, current_time, step_size):
        gain = -self.force / {mass} * step_size
        self.z += (self.v + (1.0 - 0.5 * {half}) * gain) * step_size
        self.v += gain
        return Fmi3StepResult(status=Fmi3Status.ok)
'''


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Makes a vehicle model whose step returns ``returns`` (Python), each once."""
    made: dict[tuple, Path] = {}
    scenario = load_scenario(RIG, SHORT)
    numbers = {
        "start": -scenario.approach.gap,
        "speed": scenario.approach.velocity[2],
        "mass": effective_mass(scenario),
    }

    def make(returns: str = OK, half: int = 0) -> Path:
        if (returns, half) not in made:
            folder = tmp_path_factory.mktemp("fmu")
            name = f"{folder.name.capitalize()}Stepped{len(made)}"  # one Python loads them all
            text = _MODEL.format(**numbers, half=half).replace(OK, returns)
            script = folder / f"{name.lower()}.py"
            script.write_text(text.replace("class Vehicles", f"class {name}"), encoding="utf-8")
            made[returns, half] = FmuBuilder.build_FMU(script, folder)
        return made[returns, half]

    return make


def with_model(fmu: Path) -> dict:
    return {"numerical_model": {"kind": "fmu", "file": str(fmu)}}


def test_a_numerical_model_of_the_users_own_makes_the_same_run(built) -> None:
    own = with_model(built())
    ours, theirs = run(load_scenario(RIG, SHORT)), run(load_scenario(RIG, SHORT | own))
    assert ours.trace is not None
    assert theirs.trace is not None
    np.testing.assert_allclose(theirs.trace["pose_cmd"], ours.trace["pose_cmd"], atol=1e-9)
    assert theirs.summary["cor"] == pytest.approx(ours.summary["cor"], rel=1e-6)
    entry = next(e for e in theirs.summary["delay_ledger"] if e["source"] == "numerical_model.fmu")
    assert entry["delay"] == 0.5 / theirs.scenario.rate


def test_the_half_tick_of_a_force_that_is_held_is_what_the_ledger_says(built) -> None:
    """A model that is exact within the tick: ln(e/e_semi_implicit) = (pi/2) w h/2."""
    slower = SHORT | {"rate": 500.0, "physics_rate": 4000.0}
    scenario = load_scenario(RIG, slower | with_model(built(half=1)))
    change = math.log(run(scenario).summary["cor"] / run(load_scenario(RIG, slower)).summary["cor"])
    assert change == pytest.approx(
        0.25 * math.pi * contact_frequency(scenario) * scenario.tick, rel=0.05
    )


def test_the_bounce_of_a_users_model_is_foretold_with_the_vehicles_that_are_given(built) -> None:
    rubs = SHORT | {"mechanism.contact.friction": 0.1}  # played, and not computed
    own = with_model(built())
    ours, theirs = stability(load_scenario(RIG, rubs)), stability(load_scenario(RIG, rubs | own))
    assert ours is not None
    assert theirs is not None
    assert theirs["rebound"] == pytest.approx(ours["rebound"], rel=0.02)  # half a tick later


def test_an_fmu_that_starts_elsewhere_is_refused(built) -> None:
    own = with_model(built()) | {"approach.velocity": [0.0, 0.0, 0.01]}
    with pytest.raises(InputError, match="starts elsewhere than approach says"):
        run(load_scenario(RIG, SHORT | own))
