"""`hiltestbed export`: the extended model of a diagnosis, read back by MuJoCo."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from hiltestbed.analysis.export import export_mjcf, exported
from hiltestbed.analysis.spring_damper import SpringDamper, reduced_mass
from hiltestbed.axis.dataset import AxisDataset, nominal_of
from hiltestbed.axis.models import AxisRun, model_of
from hiltestbed.errors import InputError
from hiltestbed.inference.model import Hypothesis
from hiltestbed.scenario import dump_scenario, load_scenario

AXIS = """\
axis: servo
runs: [{file: run.csv}]
effects:
- {kind: platform.delay, delay: 0.02}
- {kind: platform.drive, bandwidth: 6.0}
"""


def folder_of(path: Path, extended: str, verdict: str = "named") -> Path:
    """A diagnosis folder as far as an export reads it."""
    path.mkdir()
    about = {"name": "rig", "verdict": verdict}
    about |= {"extended_scenario": "extended.yaml" if verdict == "named" else None}
    (path / "diagnosis.json").write_text(json.dumps(about))
    (path / "extended.yaml").write_text(extended)
    return path


def rig(path: Path, *effects: dict, **changes) -> Path:
    scenario = load_scenario("reference-bumper", {"effects": list(effects)} | changes)
    return folder_of(path, dump_scenario(scenario))


def bounced(text: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, mujoco.MjModel]:
    """Times, relative speeds, and forces of the sensor from the approach on."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    rows = []
    while data.time < 1.2:
        mujoco.mj_step(model, data)
        rows.append((data.time, data.qvel[2] - data.qvel[8], data.sensor("wrench").data[2]))
    t, v, f = np.array(rows).T
    return t, v, f, model


def test_a_rig_bounces_as_its_spring_and_damper_say(tmp_path: Path) -> None:
    """Both masses, both ports and the contact are those of the extended model: CoR and peak force in
    closed form.
    """
    found = exported(
        rig(
            tmp_path / "d",
            {"kind": "contact.stiffness", "factor": 1.5},
            {"kind": "contact.damping", "factor": 6.0},
            {"kind": "dynamics.mass", "factor": 1.3, "body": "target"},
            **{"sensor.delay": 0.0},
        )
    )
    s = load_scenario("reference-bumper")
    contact = SpringDamper(
        1.5 * s.mechanism.contact.stiffness,
        6.0 * s.mechanism.contact.damping,
        reduced_mass(s.spacecraft.chaser.mass, 1.3 * s.spacecraft.target.mass),
    )
    _, v, f, _ = bounced(found.text)
    speed = s.approach.velocity[2]
    assert v[0] == pytest.approx(speed, rel=1e-9)
    assert -v[-1] / speed == pytest.approx(contact.cor, rel=0.01)
    assert f.max() == pytest.approx(contact.peak_force(speed), rel=0.01)


def test_the_reading_is_late_by_the_nominal_delay_and_the_named_one(tmp_path: Path) -> None:
    late, none = (
        bounced(exported(rig(tmp_path / str(i), *effects, **{"sensor.delay": given})).text)
        for i, (given, effects) in enumerate(
            [(0.004, [{"kind": "sensor.delay", "delay": 0.003}]), (0.0, [])]
        )
    )
    shifted = np.interp(none[0] - 0.007, none[0], none[2])
    assert np.sqrt(np.mean((late[2] - shifted) ** 2)) < 0.01 * np.std(shifted)


def test_the_platform_responds_as_a_servo(tmp_path: Path) -> None:
    effects = [
        {"kind": "platform.delay", "delay": 0.0123},
        {"kind": "platform.lag", "bandwidth": 12.0},
        {"kind": "platform.backlash", "width": 2e-4},
    ]
    text = exported(rig(tmp_path / "d", *effects)).text
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    t = np.arange(0.0, 1.0, model.opt.timestep)
    u, out = 0.01 * np.sin(2.0 * np.pi * 3.0 * t * t), np.zeros(len(t))
    for k in range(len(t)):
        mujoco.mj_forward(model, data)
        out[k] = data.sensor("position").data[0]
        data.ctrl[0] = u[k]
        mujoco.mj_step(model, data)
    servo = [effects[0], {"kind": "platform.drive", "bandwidth": 12.0, "damping_ratio": 0.7}]
    spec = {"axis": "servo", "runs": [{"file": "-"}], "effects": [*servo, effects[2]]}
    of = AxisDataset.model_validate(spec)
    nominal = model_of("servo", [AxisRun("", t, u, out)], nominal_of(of), False, of.effects)
    expected = nominal.predicted(Hypothesis((), np.zeros(0), np.zeros(len(nominal.nuisances))))[0]
    assert np.sqrt(np.mean((out - expected) ** 2)) < 0.01 * np.std(expected)


def test_what_mujoco_cannot_say_is_listed_with_what_it_is(tmp_path: Path) -> None:
    effects = [
        {"kind": "contact.hunt_crossley", "alpha": 2.0},
        {"kind": "sensor.lag", "time_constant": 0.01},
        {"kind": "sensor.saturation", "limit": 100.0},
    ]
    found = exported(rig(tmp_path / "d", *effects))
    assert any(line.startswith("contact.hunt_crossley: alpha 2.0.") for line in found.unsaid)
    assert any(line.startswith("sensor.lag") for line in found.unsaid)
    assert any(line.startswith("sensor.saturation") for line in found.said)
    assert bounced(found.text)[2].max() == pytest.approx(100.0)


def test_the_command_writes_a_file_that_loads(tmp_path: Path, call) -> None:
    folder, file = folder_of(tmp_path / "d", AXIS), tmp_path / "arm.xml"
    status, out, _ = call("export", str(folder), "--mjcf", str(file), "--json")
    assert (status, json.loads(out)["unsaid"]) == (0, [])
    assert mujoco.MjModel.from_xml_path(str(file)).actuator_delay[0] == pytest.approx(0.02)
    said = call("export", str(folder), "--mjcf", str(tmp_path / "b.xml"))[1]
    assert "delay: 0.02 s" in said


def test_what_cannot_be_exported_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"is no diagnosis \(it lacks diagnosis\.json"):
        export_mjcf(tmp_path / "empty", tmp_path / "a.xml")
    unknown = folder_of(tmp_path / "unknown", AXIS, "unknown")
    with pytest.raises(InputError, match=r"names no cause \(verdict unknown\)"):
        export_mjcf(unknown, tmp_path / "a.xml")
    assert not (tmp_path / "a.xml").exists()
    (tmp_path / "a.xml").write_text("mine")
    with pytest.raises(InputError, match="exists already"):
        export_mjcf(folder_of(tmp_path / "d", AXIS), tmp_path / "a.xml")
    assert (tmp_path / "a.xml").read_text() == "mine"
