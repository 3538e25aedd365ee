"""An arm of two joints, simulated by MuJoCo with more than its nominal URDF says: what is planted is
found by Pinocchio's regressor.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pandas as pd
import pytest
import yaml

import hiltestbed
from hiltestbed.analysis.export import export_mjcf
from hiltestbed.axis.arm import Arm, ArmModel, ArmRun, read_arm
from hiltestbed.axis.arm_mjcf import arm_mjcf
from hiltestbed.axis.dataset import ArmDataset, load_axis
from hiltestbed.axis.diagnose import AxisDiagnosis
from hiltestbed.axis.law import VISCOUS as VISCOUS_AT
from hiltestbed.axis.motion import Motion
from hiltestbed.axis.result import CLOSE
from hiltestbed.config.check import look_at
from hiltestbed.inference.model import Hypothesis

TICK, NOISE = 1e-3, 2e-6  # [s], [rad]
MORE = 1.15  # times the nominal mass of the lower arm
COULOMB, VISCOUS = {"shoulder": 0.9, "elbow": 0.5}, {"shoulder": 0.4, "elbow": 0.25}

URDF = """<robot name="arm"><link name="base"/>
<link name="upper"><inertial><origin xyz="0.2 0 0"/><mass value="2.0"/>
 <inertia ixx="0.002" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="lower"><inertial><origin xyz="0.15 0 0"/><mass value="1.0"/>
 <inertia ixx="0.001" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/>
 <axis xyz="0 1 0"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/>
 <origin xyz="0.4 0 0"/><axis xyz="0 1 0"/>
 <limit effort="100" velocity="10" lower="-3" upper="3"/></joint></robot>
"""
MJCF = """<mujoco><option timestep="1e-4" integrator="RK4" gravity="0 0 -9.81"/><worldbody>
<body name="upper"><joint name="shoulder" axis="0 1 0" damping="{viscous[shoulder]}"/>
 <inertial pos="0.2 0 0" mass="2.0" diaginertia="0.002 0.03 0.03"/>
 <body name="lower" pos="0.4 0 0"><joint name="elbow" axis="0 1 0" damping="{viscous[elbow]}"/>
  <inertial pos="0.15 0 0" mass="{mass}" diaginertia="{xx} {yy} {yy}"/></body></body></worldbody>
</mujoco>"""


def moved(size: float, rng: np.random.Generator) -> np.ndarray:
    """Rows of time, two angles and two torques, of a motion under a controller."""
    model = mujoco.MjModel.from_xml_string(
        MJCF.format(viscous=VISCOUS, mass=MORE, xx=0.001 * MORE, yy=0.01 * MORE)
    )
    data, dry = mujoco.MjData(model), np.array(list(COULOMB.values()))
    rows = []
    for k in range(2500):
        t = k * TICK
        goal = size * np.array([np.sin(1.9 * t) + 0.4 * np.sin(4.7 * t), np.sin(2.7 * t + 1.0)])
        torque = np.array([150.0, 60.0]) * (goal - data.qpos) - np.array([12.0, 4.0]) * data.qvel
        rows.append([t, *data.qpos, *torque])
        for _ in range(10):
            data.qfrc_applied[:] = torque - dry * np.tanh(data.qvel / 1e-3)
            mujoco.mj_step(model, data)
    out = np.array(rows)
    out[:, 1:3] += NOISE * rng.standard_normal((len(out), 2))
    return out


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    where, rng = tmp_path_factory.mktemp("arm"), np.random.default_rng(3)
    (where / "arm.urdf").write_text(URDF)
    for number, size in enumerate((0.5, 0.8, 1.1)):
        rows = pd.DataFrame(moved(size, rng), columns=["t", "q1", "q2", "tau1", "tau2"])
        rows[["q1", "q2"]] = np.degrees(rows[["q1", "q2"]])
        rows.to_csv(where / f"run_{number}.csv", index=False)
    (where / "arm.yaml").write_text(
        """axis: arm
model: arm.urdf
joints: {shoulder: {}, elbow: {}}
runs: [{file: run_0.csv}, {file: run_1.csv}, {file: run_2.csv}]
channels:
  shoulder.position: {column: q1, unit: deg}
  shoulder.input: {column: tau1}
  elbow.position: {column: q2, unit: deg}
  elbow.input: {column: tau2}
"""
    )
    return where


@pytest.fixture(scope="module")
def found(folder: Path) -> AxisDiagnosis:
    diagnosis = hiltestbed.diagnose(folder / "arm.yaml")
    assert isinstance(diagnosis, AxisDiagnosis)
    diagnosis.write(folder / "found")
    return diagnosis


def test_friction_of_each_joint_and_the_mass_of_a_body_are_found(
    folder: Path, found: AxisDiagnosis
) -> None:
    told = {
        (c.effect, c.parameters.get("joint", c.parameters.get("body", ("",)))[0]): c
        for c in found.causes
    }
    assert set(told) == {
        ("dynamics.mass", "lower"),
        ("dynamics.force", "shoulder"),
        ("dynamics.force", "elbow"),
    }
    factor = told["dynamics.mass", "lower"].parameters["factor"]
    assert factor[0] == pytest.approx(MORE, rel=0.01)
    for joint in COULOMB:
        friction = told["dynamics.force", joint].parameters
        for name, planted in (("coulomb", COULOMB[joint]), ("viscous", VISCOUS[joint])):
            value, ends, unit = friction[name]
            assert ends is not None
            low, high = ends
            assert unit == {"coulomb": "N m", "viscous": "N m s/rad"}[name]
            assert value == pytest.approx(planted, rel=0.01)
            assert low < planted < high
    each = found.to_json()["residuals"]
    assert [r["run"] for r in each] == [f"run_{n}.csv" for n in range(3)]
    assert all(r["white"] and r["rms_extended"] < CLOSE * r["noise_floor"] for r in each)
    extended = load_axis(folder / "found" / "extended.yaml").model()
    left = extended.scored(Hypothesis((), np.zeros(0), np.zeros(1)))
    assert all(np.std(x) < CLOSE * floor for x, floor in zip(left, extended.floors, strict=True))


def off(text: str, arm: Arm, effects: Sequence[Any], size: float) -> np.ndarray:
    """(J,) rms by which the inputs that the extended arm predicts for the motion of an exported one
    differ from those that moved it, over their own.
    """
    model = mujoco.MjModel.from_xml_string(text)
    data, joints = mujoco.MjData(model), list(arm.joints)
    inertia = np.diag(arm.inertia(np.zeros(len(joints))))
    gain = np.array([model.actuator(f"{j}.input").gear[0] for j in joints])
    control, rows = [model.actuator(f"{j}.input").id for j in joints], []
    for k in range(3000):
        t = k * TICK
        goal = size * np.sin((1.9 + 0.8 * np.arange(len(joints))) * t)
        data.ctrl[control] = inertia * (400.0 * (goal - data.qpos) - 30.0 * data.qvel) / gain
        rows.append([*(data.sensor(f"{j}.position").data[0] for j in joints), *data.ctrl[control]])
        for _ in range(round(TICK / model.opt.timestep)):
            mujoco.mj_step(model, data)
    q, u = np.split(np.array(rows), 2, axis=1)
    of = ArmModel([ArmRun("exported", np.arange(0.0, len(q)) * TICK, q, u)], arm, effects)
    predicted = np.column_stack(of.predicted(Hypothesis((), np.zeros(0), np.zeros(1))))
    driven = 0.5 * (u + np.roll(u, 1, axis=0))  # held before and after a row
    apart = (predicted - driven)[3:-3] / np.std(driven, axis=0)
    # where a joint rests, or comes to rest, dry friction leaves its torque open
    slowest = np.lib.stride_tricks.sliding_window_view(np.abs(np.gradient(q, axis=0)), 7, 0).min(2)
    moves = slowest > 0.02 * slowest.max(axis=0)
    assert np.all(moves.mean(axis=0) > 0.8)
    return np.sqrt(np.mean(apart**2, axis=0, where=moves))


def test_an_export_is_moved_by_the_torques_that_the_extended_arm_predicts(
    folder: Path, found: AxisDiagnosis
) -> None:
    file, extended = folder / "exported.xml", load_axis(folder / "found" / "extended.yaml")
    assert not export_mjcf(folder / "found", file).unsaid
    assert extended.arm is not None
    assert all(off(file.read_text(), extended.arm, extended.spec.effects, 0.9) < 0.01)


BRANCHED = """<robot name="arm"><link name="base"/>
<link name="turret"><inertial><origin xyz="0.02 0.01 0.3"/><mass value="5.0"/>
 <inertia ixx="0.09" iyy="0.08" izz="0.05" ixy="0.01" ixz="0.005" iyz="0"/></inertial></link>
<link name="boom"><inertial><origin xyz="0 0 0.2"/><mass value="1.5"/>
 <inertia ixx="0.02" iyy="0.02" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="flag"><inertial><origin xyz="0.1 0 0"/><mass value="0.4"/>
 <inertia ixx="0.001" iyy="0.003" izz="0.003" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="tip"><inertial><origin xyz="0.05 0 0"/><mass value="0.2"/>
 <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="swivel" type="continuous"><parent link="base"/><child link="turret"/>
 <origin rpy="0.4 0.2 0"/><axis xyz="0 0.6 0.8"/></joint>
<joint name="reach" type="prismatic"><parent link="turret"/><child link="boom"/>
 <origin xyz="0.1 0 0.4" rpy="0 0.7 0.3"/><axis xyz="0 0 1"/>
 <limit effort="100" velocity="10" lower="-1" upper="1"/></joint>
<joint name="wave" type="continuous"><parent link="turret"/><child link="flag"/>
 <origin xyz="0 0.2 0.1" rpy="0.3 0 0"/><axis xyz="1 0 0"/></joint>
<joint name="spare" type="continuous"><parent link="flag"/><child link="tip"/>
 <origin xyz="0.2 0 0"/><axis xyz="0 1 0"/></joint>
</robot>
"""


def test_all_that_mujoco_can_say_of_an_arm_is_exported(tmp_path: Path) -> None:
    """Joints that turn and slide about skew axes, in a tree, one of them not recorded."""
    (tmp_path / "arm.urdf").write_text(BRANCHED)
    joints = {"swivel": {"armature": 0.1}, "reach": {"gain": 20.0}, "wave": {"viscous": 0.02}}
    arm = read_arm(tmp_path / "arm.urdf", joints)
    data = {
        "axis": "arm",
        "model": "arm.urdf",
        "joints": joints,
        "runs": [{"file": "run.csv"}],
        "effects": [
            {"kind": "dynamics.force", "joint": "swivel", "coulomb": 0.8, "coulomb_back": 1.4},
            {"kind": "dynamics.force", "joint": "reach", "coulomb": 2.0, "offset": 3.0},
            {"kind": "dynamics.gain", "joint": "wave", "factor": 0.5},
            {"kind": "dynamics.spring", "joint": "wave", "stiffness": 0.7, "rest": 0.3},
            {"kind": "dynamics.armature", "joint": "wave", "inertia": 0.02},
            {"kind": "dynamics.mass", "body": "boom", "factor": 1.4},
            {"kind": "dynamics.centre_of_mass", "body": "turret", "x": 0.1, "z": -0.05},
        ],
    }
    effects = ArmDataset.model_validate(data).effects
    text, _, unsaid = arm_mjcf(arm, effects)
    assert not unsaid
    assert all(off(text, arm, effects, 0.4) < 0.01)
    loose = [{"kind": "dynamics.load_friction", "joint": "wave", "coefficient": 0.1}]
    _, _, unsaid = arm_mjcf(arm, ArmDataset.model_validate(data | {"effects": loose}).effects)
    assert unsaid == ["wave: friction that grows with the transmitted force: left out"]


def test_the_regressor_of_a_model_file_gives_the_torques_of_mujocos_inverse_dynamics(
    tmp_path: Path,
) -> None:
    """With gravity that is not the usual one, a third joint that stays at zero, and armature."""
    text = MJCF.format(viscous=VISCOUS, mass=1.3, xx=0.004, yy=0.02).replace("-9.81", "-1.62")
    text = text.replace('name="elbow"', 'name="elbow" armature="0.07"').replace(
        "</body></body>",
        '<body name="hand"><joint name="wrist"/><geom size="0.1" mass="0.2"/></body></body></body>',
    )
    (tmp_path / "arm.xml").write_text(text)
    arm = read_arm(tmp_path / "arm.xml", {"elbow": {}, "shoulder": {}})
    assert list(arm.joints) == ["shoulder", "elbow"]
    rng = np.random.default_rng(0)
    t, (q, v, a) = np.arange(5.0), rng.standard_normal((3, 5, 2))
    still = np.zeros(5)
    motions = [Motion(t, q[:, j], v[:, j], a[:, j], still, 5, 0.0, 0.0) for j in range(2)]
    numbers = arm.numbers()
    rigid = arm.regressor(motions) @ np.concatenate(list(numbers.bodies.values()))
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    for k in range(5):
        data.qpos[:2], data.qvel[:2], data.qacc[:2] = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        others = np.array(list(VISCOUS.values())) * v[k] + [0.0, 0.07 * a[k, 1]]
        np.testing.assert_allclose(rigid[k] + others, data.qfrc_inverse[:2], atol=1e-9)
    assert numbers.armature == {"shoulder": 0.0, "elbow": pytest.approx(0.07)}
    assert [numbers.laws[j].numbers[VISCOUS_AT] for j in VISCOUS] == list(VISCOUS.values())


def test_a_joint_that_rests_in_a_run_is_no_record_of_it(folder: Path, tmp_path: Path) -> None:
    """Its encoder shows noise alone, and dry friction leaves its torque open."""
    for name in ("arm.urdf", "arm.yaml", "run_1.csv", "run_2.csv"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    rows = pd.read_csv(folder / "run_0.csv")
    rows["q2"] = 20.0 + np.degrees(NOISE) * np.random.default_rng(4).standard_normal(len(rows))
    rows.to_csv(tmp_path / "run_0.csv", index=False)
    model = load_axis(tmp_path / "arm.yaml").model()
    assert model.recorded == ("run_0.csv", "run_1.csv", "run_2.csv")
    assert model.runs[:2] == ("run_0.csv: shoulder", "run_1.csv: shoulder")
    assert model.of_folds() == [[0], [1, 2], [3, 4]]
    left = model.residuals(Hypothesis((), np.zeros(0), np.zeros(1)))
    assert all(len(x) and np.isfinite(x).all() for x in left)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"joints": {"wrist": {}}},
            "has no joint wrist; its joints of one axis are shoulder, elbow",
        ),
        ({"model": "none.urdf"}, "is no file; model: takes the URDF or MJCF of the arm"),
        ({"channels": {"elbow.torque": {}}}, "is no signal; allowed: t, shoulder.position"),
        ({"effects": [{"kind": "dynamics.mass", "body": "hand", "factor": 2.0}]}, "allowed: upper"),
        ({"effects": [{"kind": "dynamics.force", "coulomb": 1.0}]}, "allowed: shoulder, elbow"),
        (
            {"effects": [{"kind": "dynamics.gravity", "sine": 1.0}]},
            "does not act on an arm",
        ),
        ({"channels": {}}, "names no column of the file (got 'shoulder.input'"),
    ],
)
def test_what_contradicts_the_arm_is_refused_in_words(
    folder: Path, change: dict[str, Any], message: str
) -> None:
    data = yaml.safe_load((folder / "arm.yaml").read_text()) | change
    (folder / "bad.yaml").write_text(yaml.safe_dump(data))
    faults = look_at(folder / "bad.yaml").faults
    assert message in "\n".join(map(str, faults))
