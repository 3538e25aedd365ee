"""FMI 3.0: a packed physical side passes FMPy's validation and steps as the one that was packed; what
a user's FMU returns is obeyed, in the units that it declares.
"""

from __future__ import annotations

import logging
import math
import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hiltestbed.analysis.ledger import contact_frequency
from hiltestbed.analysis.stability import stability
from hiltestbed.devices.cosimulation import POSE, CoSimulation
from hiltestbed.devices.cosimulation import WRENCH as AXES
from hiltestbed.devices.fmu import pack
from hiltestbed.devices.interface import DeviceError
from hiltestbed.errors import InputError
from hiltestbed.numerical_model.bodies import effective_mass
from hiltestbed.numerical_model.model import NumericalModel
from hiltestbed.scenario import dump_scenario, load_scenario
from hiltestbed.simulation import Run
from tests.running import run

fmpy = pytest.importorskip("fmpy")
pytest.importorskip("pythonfmu3")
from fmpy.fmi3 import FMU3Slave  # noqa: E402
from fmpy.validation import validate_fmu  # noqa: E402
from pythonfmu3.builder import FmuBuilder  # noqa: E402

PERIOD, STIFFNESS = 0.001, 1.0e4
COMMAND = [f"pose_cmd.{name}" for name in POSE]
WRENCH = [f"wrench_meas.{name}" for name in AXES]
IN = [f"wrench.{name}" for name in AXES]
POSE_IN_FREE_SPACE = np.array([0.0, 0.0, -0.001, 0.0, 0.0, 0.0, 1.0])
RIG = Path(__file__).parents[2] / "scenarios" / "02-bumper.yaml"
SPEED = load_scenario(RIG).approach.velocity[2]
SHORT = {
    "duration": 0.9,
    "compensation.force.kind": "none",
    "identification": {"kind": "none"},
    "sensor.noise": 0.0,
}


class Spring:
    """A platform that is where it was told to be, and a spring from pz = 0 on."""

    def __init__(self, scenario: Path) -> None:
        assert scenario.read_text(encoding="utf-8") == "name: bounce\n"
        self.period = PERIOD
        self.pose = POSE_IN_FREE_SPACE.copy()
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
    assert packed.name == "SpringRig.fmu"
    assert validate_fmu(str(packed)) == []
    description = fmpy.read_model_description(str(packed))
    assert description.fmiVersion == "3.0"
    assert {v.name for v in description.modelVariables if v.causality == "input"} == set(COMMAND)
    assert float(description.defaultExperiment.stepSize) == PERIOD
    assert float(description.coSimulation.fixedInternalStepSize) == PERIOD


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


def test_a_bounce_against_the_fmu_is_that_against_what_was_packed(packed: Path) -> None:
    side = Spring(packed.parent / "scenario.yaml")

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


@pytest.mark.parametrize(("name", "value"), [("pz", np.nan), ("px", np.inf), ("qw", 0.0)])
def test_a_command_that_is_no_pose_is_an_error(packed: Path, name: str, value: float) -> None:
    bad = POSE_IN_FREE_SPACE.copy()
    bad[POSE.index(name)] = value
    with CoSimulation(packed, COMMAND, ["pose_act.pz"]) as fmu:
        fmu.step(POSE_IN_FREE_SPACE, PERIOD)
        with pytest.raises(DeviceError, match=r"failed at t = 0.001000 s .*error"):
            fmu.step(bad, PERIOD)


def test_time_of_a_packed_side_advances_with_that_of_the_tool(packed: Path) -> None:
    description = fmpy.read_model_description(str(packed))
    references = {v.name: v.valueReference for v in description.modelVariables}
    for start in (0.0, 5.0):
        slave = FMU3Slave(
            guid=description.guid,
            unzipDirectory=fmpy.extract(str(packed)),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=f"from{start}",
        )
        slave.instantiate(logMessage=lambda *_: None)
        slave.enterInitializationMode(startTime=start)
        slave.exitInitializationMode()
        for k in range(50):
            slave.doStep(start + k * PERIOD, PERIOD)
        assert slave.getFloat64([references["time"]])[0] == pytest.approx(start + 50 * PERIOD)
        slave.terminate()


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


def test_the_rig_of_a_scenario_in_fmpy_bounces_as_the_run_does(tmp_path: Path) -> None:
    scenario = load_scenario(RIG, SHORT)
    file = tmp_path / "scenario.yaml"
    file.write_text(dump_scenario(scenario), encoding="utf-8")
    packed = pack("hiltestbed.devices.physical:from_file", file, tmp_path)
    alone = run(scenario).trace
    model, wrench = NumericalModel([scenario]), np.zeros(6)
    with CoSimulation(packed, COMMAND, WRENCH) as fmu:
        path = np.empty((scenario.ticks, 7))
        for k in range(scenario.ticks):
            model.advance(wrench[None])
            path[k] = model.pose[0]
            wrench = fmu.step(model.pose[0], scenario.tick)
    assert path[-1, 2] < 0.0 < path[:, 2].max()  # in, and out again
    np.testing.assert_allclose(path, alone["pose_cmd"], atol=1e-6)


_MODEL = '''
from pythonfmu3 import Fmi3Causality, Fmi3Slave, Fmi3StepResult, Fmi3Status, Float64


class {name}(Fmi3Slave):
    """Two point masses on a line: semi-implicit, or exact for a force that is held over the step.
    A lateral force is the number of the status that the step returns.
    """

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.values = dict.fromkeys({names}, 0.0)
        self.values |= {{"pose.qw": 1.0, "pose.pz": {start}, "twist.vz": {speed}}}
        for name in self.values:
            get = lambda name=name: self.values[name]
            put = lambda value, name=name: self.values.__setitem__(name, value)
            if name == "time":
                ports = {{"causality": Fmi3Causality.independent}}
            elif name.startswith("wrench"):
                ports = {{"causality": Fmi3Causality.input, "start": 0.0, "setter": put}}
            else:
                ports = {{"causality": Fmi3Causality.output}}
            self.register_variable(Float64(name, getter=get, **ports), nested=False)

    def do_step(self, current_time, step_size):
        now = self.values
        gain = -now["wrench.fz"] / {mass} * step_size
        now["pose.pz"] += (now["twist.vz"] + (1.0 - 0.5 * {half}) * gain) * step_size
        now["twist.vz"] += gain
        status = ("ok", "warning", "discard", "error", "fatal")[int(now["wrench.fx"])]
        ended = current_time > {ends}
        return Fmi3StepResult(status=getattr(Fmi3Status, status), terminateSimulation=ended)
'''
NAMES = ["time", *IN, *(f"pose.{n}" for n in POSE), *(f"twist.{a}{n}" for a in "vw" for n in "xyz")]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Makes the vehicle model, exact within a tick or not, which ends the simulation at a time."""
    made: dict[tuple, Path] = {}
    scenario = load_scenario(RIG, SHORT)
    numbers = {
        "names": NAMES,
        "start": -scenario.approach.gap,
        "speed": scenario.approach.velocity[2],
        "mass": effective_mass(scenario.spacecraft),
    }

    def make(half: int = 0, ends: float = 1e9) -> Path:
        if (half, ends) not in made:
            folder = tmp_path_factory.mktemp("fmu")
            name = f"Vehicles{len(made)}"  # one Python loads them all
            script = folder / f"{name.lower()}.py"
            script.write_text(_MODEL.format(**numbers, name=name, half=half, ends=ends))
            made[half, ends] = FmuBuilder.build_FMU(script, folder)
        return made[half, ends]

    return make


def with_model(fmu: Path) -> dict:
    return {"numerical_model": {"kind": "fmu", "file": str(fmu)}}


def _run(fmu: Path) -> Run:
    return run(load_scenario(RIG, SHORT | with_model(fmu)))


def test_a_numerical_model_of_the_users_own_makes_the_same_run(built) -> None:
    own = with_model(built())
    ours, theirs = run(load_scenario(RIG, SHORT)), run(load_scenario(RIG, SHORT | own))
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
    assert theirs["rebound"] == pytest.approx(ours["rebound"], rel=0.02)  # half a tick later


def test_a_model_that_ends_the_simulation_ends_the_run_with_its_time(built) -> None:
    ended = _run(built(ends=0.2995))
    assert ended.summary["status"] == "stopped"
    reason = ended.summary["stop_reason"]
    assert "has ended the simulation at t = 0.299750 s (terminateSimulation)" in reason
    assert ended.trace.t[-1] == pytest.approx(0.3, abs=1.5 * PERIOD)
    assert np.isfinite(ended.trace["pose_cmd"]).all()


def _status(number: int) -> np.ndarray:
    return np.array([number, 0.0, 0.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize(("number", "status"), [(2, "discard"), (3, "error"), (4, "fatal")])
def test_a_step_that_is_not_done_is_a_failure_with_its_time(
    built, number: int, status: str
) -> None:
    with CoSimulation(built(), IN, ["pose.pz"]) as model:
        model.step(_status(0), PERIOD)
        with pytest.raises(DeviceError, match=r"failed at t = 0.001000 s .*" + status):
            model.step(_status(number), PERIOD)


def test_a_warning_is_logged_once_and_its_results_are_used(
    built, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING), CoSimulation(built(), IN, ["pose.pz"]) as model:
        path = [model.step(_status(k > 0), PERIOD)[0] for k in range(4)]
    np.testing.assert_allclose(np.diff(path), PERIOD * SPEED, rtol=1e-9)
    said = [r.getMessage() for r in caplog.records if r.name == "hiltestbed.devices.cosimulation"]
    assert len(said) == 1
    assert "fmi3DoStep returned a warning at t = 0.001000 s" in said[0]


def _described(fmu: Path, out: Path, change: Callable[[str], str]) -> Path:
    """A copy of ``fmu`` with its model description changed."""
    with zipfile.ZipFile(fmu) as given, zipfile.ZipFile(out, "w") as written:
        for item in given.infolist():
            data = given.read(item)
            if item.filename == "modelDescription.xml":
                data = change(data.decode()).encode()
            written.writestr(item, data)
    return out


@pytest.mark.parametrize("share", [0.25, 0.0])
def test_a_step_that_returns_early_is_continued_until_its_end(
    built, share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What comes back has advanced by ``share`` of what was asked; by nothing, it cannot go on."""
    whole, asked = FMU3Slave.doStep, []

    def part(self, current: float, step: float, *rest: bool) -> tuple:
        done = step if step < 0.3 * PERIOD else share * step
        asked.append((current, step))
        if done > 0.0:
            whole(self, current, done)
        return False, False, done < step, current + done

    monkeypatch.setattr(FMU3Slave, "doStep", part)
    with CoSimulation(built(), IN, ["pose.pz"]) as fmu:
        before = fmu.outputs()[0]
        if share == 0.0:
            with pytest.raises(DeviceError, match=r"returned early at t = 0.000000 s without"):
                fmu.step(np.zeros(6), PERIOD)
            return
        for _ in range(10):
            after = fmu.step(np.zeros(6), PERIOD)[0]
    assert after - before == pytest.approx(10 * PERIOD * SPEED, rel=1e-12)
    assert len(asked) > 20


def _with_units(text: str, units: dict[str, tuple[str, str]]) -> str:
    """Declare for names that match a pattern a unit, and define it by attributes of BaseUnit."""
    defined = ""
    for pattern, (unit, base) in units.items():
        text = re.sub(rf'<Float64 ([^>]*name="{pattern}")', rf'<Float64 unit="{unit}" \1', text)
        inside = f"<BaseUnit {base}/>" if base else ""
        defined += f'<Unit name="{unit}">{inside}</Unit>'
    ends = r"(<CoSimulation[^>]*/>|</CoSimulation>)"
    return re.sub(ends, rf"\1<UnitDefinitions>{defined}</UnitDefinitions>", text, count=1)


FORCE, TORQUE = r"wrench\.f.", r"wrench\.t."
UNITS = {
    "kN": {FORCE: ("kN", 'kg="1" m="1" s="-2" factor="1000"')},
    "lbf by name only": {FORCE: ("lbf", "")},
    "all others": {
        TORQUE: ("N.mm", 'kg="1" m="2" s="-2" factor="0.001"'),
        r"twist\.w.": ("deg/s", 'rad="1" s="-1" factor="0.017453292519943295"'),
        r"pose\.q.": ("-", ""),
    },
    "displayUnit is not the unit": {
        FORCE: ("N", 'kg="1" m="1" s="-2"/><DisplayUnit name="kN" factor="0.001"'),
    },
}
FACTORS = {"kN": 1e3, "lbf by name only": 4.4482216152605}


def test_a_force_reaches_the_model_in_the_unit_that_it_declares(
    built, tmp_path: Path, subtests: pytest.Subtests
) -> None:
    """A model that takes the declared unit accelerates by the number that it is given."""
    for kind, declared in UNITS.items():
        with subtests.test(kind):
            units = {p: ("1", "") if u[0] == "-" else u for p, u in declared.items()}
            own = tmp_path / f"{kind}.fmu"
            fmu = _described(built(), own, lambda text, units=units: _with_units(text, units))
            with CoSimulation(fmu, IN, ["twist.vz"]) as model:
                before = model.outputs()[0]
                after = model.step(np.array([0.0, 0.0, 1000.0, 0.0, 0.0, 0.0]), PERIOD)[0]
            given = (
                1000.0
                / FACTORS.get(kind, 1.0)
                / effective_mass(load_scenario(RIG, SHORT).spacecraft)
            )
            assert after - before == pytest.approx(-given * PERIOD, rel=1e-12)


def test_a_position_in_millimetres_is_read_as_such(built, tmp_path: Path) -> None:
    units = {r"pose\.p.": ("mm", 'm="1" factor="0.001"')}
    fmu = _described(built(), tmp_path / "own.fmu", lambda text: _with_units(text, units))
    start = -load_scenario(RIG, SHORT).approach.gap
    with CoSimulation(fmu, [], ["pose.pz"]) as model:
        assert model.outputs()[0] == pytest.approx(1e-3 * start)
    with pytest.raises(InputError, match="starts elsewhere than approach says"):
        _run(fmu)


def test_a_unit_that_is_none_of_the_quantity_is_refused(built, tmp_path: Path) -> None:
    refused = {
        ("kg", 'kg="1"'): r"wrench.fz: has the unit 'kg' \(kg\^1\), which is no unit of this",
        ("lb", ""): r"wrench.fz: has the unit 'lb', which the FMU does not define by base units",
    }
    for unit, said in refused.items():
        own = tmp_path / f"{unit[0]}.fmu"
        fmu = _described(built(), own, lambda text, unit=unit: _with_units(text, {FORCE: unit}))
        with pytest.raises(InputError, match=said):
            CoSimulation(fmu, ["wrench.fz"], [])


def test_an_output_that_is_no_rotation_is_a_failure_with_its_time(
    built, monkeypatch: pytest.MonkeyPatch
) -> None:
    fmu, whole = built(), CoSimulation.outputs

    def turned(self: CoSimulation) -> np.ndarray:
        values = whole(self)
        values[3:7] *= 1.0 - 0.1 * (self.time > 0.2999)
        return values

    monkeypatch.setattr(CoSimulation, "outputs", turned)
    with pytest.raises(DeviceError, match=r"no rotation at t = 0.300000 s \(got 0, 0, 0, 0.9\)"):
        _run(fmu)
