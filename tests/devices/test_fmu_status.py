"""FMI 3.0 to the letter: what a user's FMU returns is obeyed, in the units that it declares; and the
packed side has a time, a step size and commands that are checked.
"""

from __future__ import annotations

import logging
import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hiltestbed.devices.fmu import CoSimulation
from hiltestbed.devices.interface import DeviceError
from hiltestbed.errors import InputError
from hiltestbed.numerical_model.bodies import effective_mass
from hiltestbed.scenario import load_scenario
from hiltestbed.simulation import Run
from tests.devices.test_fmu import COMMAND, OK, PERIOD, RIG, SHORT, built, packed_in, with_model
from tests.running import run

fmpy = pytest.importorskip("fmpy")
pytest.importorskip("pythonfmu3")
from fmpy.fmi3 import FMU3Slave  # noqa: E402

__all__ = ["built"]  # the fixture


def _described(fmu: Path, out: Path, change: Callable[[str], str]) -> Path:
    """A copy of ``fmu`` with its model description changed."""
    with zipfile.ZipFile(fmu) as given, zipfile.ZipFile(out, "w") as written:
        for item in given.infolist():
            data = given.read(item)
            if item.filename == "modelDescription.xml":
                data = change(data.decode()).encode()
            written.writestr(item, data)
    return out


def _run(fmu: Path) -> Run:
    return run(load_scenario(RIG, SHORT | with_model(fmu)))


LATE = "current_time > 0.2995"


def test_a_model_that_ends_the_simulation_ends_the_run_with_its_time(built) -> None:
    ended = _run(built(OK.replace("status=Fmi3Status.ok", f"terminateSimulation={LATE}")))
    assert ended.summary["status"] == "stopped"
    reason = ended.summary["stop_reason"]
    assert "has ended the simulation at t = 0.299750 s (terminateSimulation)" in reason
    assert ended.trace is not None
    assert ended.trace.t[-1] == pytest.approx(0.3, abs=1.5 * PERIOD)
    assert np.isfinite(ended.trace["pose_cmd"]).all()


@pytest.mark.parametrize("status", ["discard", "error", "fatal"])
def test_a_step_that_is_not_done_is_a_failure_with_its_time(built, status: str) -> None:
    fmu = built(OK.replace(".ok", f".{status} if {LATE} else Fmi3Status.ok"))
    with pytest.raises(DeviceError, match=r"failed at t = 0.299625 s .*" + status):
        _run(fmu)


def test_a_warning_is_logged_once_and_its_results_are_used(
    built, caplog: pytest.LogCaptureFixture
) -> None:
    fmu = built(OK.replace(".ok", f".warning if {LATE} else Fmi3Status.ok"))
    with caplog.at_level(logging.WARNING):
        warned = _run(fmu)
    assert warned.summary["cor"] == _run(built()).summary["cor"]
    said = [r.getMessage() for r in caplog.records if r.name == "hiltestbed.devices.fmu"]
    assert len(said) == 2  # of the run, and of its reference
    assert "fmi3DoStep returned a warning at t = 0.299625 s" in said[0]


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
    names = [f"wrench.{n}" for n in ("fx", "fy", "fz", "tx", "ty", "tz")]
    with CoSimulation(built(), names, ["pose.pz"]) as fmu:
        before = fmu.outputs()[0]
        if share == 0.0:
            with pytest.raises(DeviceError, match=r"returned early at t = 0.000000 s without"):
                fmu.step(np.zeros(6), PERIOD)
            return
        for _ in range(10):
            after = fmu.step(np.zeros(6), PERIOD)[0]
    speed = load_scenario(RIG, SHORT).approach.velocity[2]
    assert after - before == pytest.approx(10 * PERIOD * speed, rel=1e-12)
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


@pytest.mark.parametrize("kind", UNITS)
def test_a_force_reaches_the_model_in_the_unit_that_it_declares(
    built, kind: str, tmp_path: Path
) -> None:
    """A model that takes the declared unit accelerates by the number that it is given."""
    units = {p: ("1", "") if u[0] == "-" else u for p, u in UNITS[kind].items()}
    fmu = _described(built(), tmp_path / "own.fmu", lambda text: _with_units(text, units))
    names = [f"wrench.{n}" for n in ("fx", "fy", "fz", "tx", "ty", "tz")]
    scenario = load_scenario(RIG, SHORT)
    with CoSimulation(fmu, names, ["twist.vz"]) as model:
        before = model.outputs()[0]
        gained = model.step(np.array([0.0, 0.0, 1000.0, 0.0, 0.0, 0.0]), PERIOD)[0] - before
    given = 1000.0 / FACTORS.get(kind, 1.0)
    assert gained == pytest.approx(-given / effective_mass(scenario) * PERIOD, rel=1e-12)


def test_a_position_in_millimetres_is_read_as_such(built, tmp_path: Path) -> None:
    units = {r"pose\.p.": ("mm", 'm="1" factor="0.001"')}
    fmu = _described(built(), tmp_path / "own.fmu", lambda text: _with_units(text, units))
    start = -load_scenario(RIG, SHORT).approach.gap
    with CoSimulation(fmu, [], ["pose.pz"]) as model:
        assert model.outputs()[0] == pytest.approx(1e-3 * start)
    with pytest.raises(InputError, match="starts elsewhere than approach says"):
        _run(fmu)


@pytest.mark.parametrize(
    ("unit", "base", "said"),
    [
        ("kg", 'kg="1"', r"wrench.fz: has the unit 'kg' \(kg\^1\), which is no unit of this"),
        ("lb", "", r"wrench.fz: has the unit 'lb', which the FMU does not define by base units"),
    ],
)
def test_a_unit_that_is_none_of_the_quantity_is_refused(
    built, unit: str, base: str, said: str, tmp_path: Path
) -> None:
    fmu = _described(
        built(), tmp_path / "own.fmu", lambda text: _with_units(text, {FORCE: (unit, base)})
    )
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


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return packed_in(tmp_path_factory.mktemp("packed"), "TimedRig")


def test_time_of_a_packed_side_advances_with_that_of_the_tool(packed: Path) -> None:
    description = fmpy.read_model_description(str(packed))
    assert float(description.defaultExperiment.stepSize) == PERIOD
    assert float(description.coSimulation.fixedInternalStepSize) == PERIOD
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


@pytest.mark.parametrize(
    ("name", "value"),
    [("pz", np.nan), ("px", np.inf), ("qw", np.nan), ("qw", 0.0), ("qz", 3.0)],
)
def test_a_command_that_is_no_pose_is_an_error(packed: Path, name: str, value: float) -> None:
    pose = np.array([0.0, 0.0, -0.001, 0.0, 0.0, 0.0, 1.0])
    bad = pose.copy()
    bad[[c.rpartition(".")[2] for c in COMMAND].index(name)] = value
    with CoSimulation(packed, COMMAND, ["pose_act.pz"]) as fmu:
        fmu.step(pose, PERIOD)
        with pytest.raises(DeviceError, match=r"failed at t = 0.001000 s .*error"):
            fmu.step(bad, PERIOD)
