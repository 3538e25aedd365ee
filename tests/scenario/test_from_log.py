"""`hiltestbed new NAME --from LOG`: what it writes is valid, or the check names what is missing."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from hiltestbed.axis.dataset import load_axis
from hiltestbed.config.check import look_at
from hiltestbed.config.from_log import write_from_log
from hiltestbed.errors import InputError
from hiltestbed.measured.roles import role_of, time_unit
from tests.axis import machines
from tests.axis.test_arm import URDF
from tests.measured import bounce

SERVO, DAMPER, DRIVE = machines.servo(0), machines.damper(0), machines.carriage(0)


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def log(**columns) -> list[Path]:
    pd.DataFrame(columns).to_csv("log.csv", index=False)
    return [Path("log.csv")]


def test_a_servo_is_read_as_it_was_written() -> None:
    """Milliseconds and degrees, by the suffixes of the names."""
    stamps, u, y = 1e3 * SERVO.t, np.degrees(SERVO.u), np.degrees(SERVO.y)
    path = log(time_ms=stamps, q_cmd_deg=u, q_deg=y, temperature=20.0 + SERVO.t)
    found = write_from_log("arm", path)
    assert (found.kind, found.open) == ("axis: servo", ())
    loaded = load_axis("arm.yaml")
    assert loaded.units() == ("rad", "rad")
    np.testing.assert_allclose(loaded.records[0].t, SERVO.t, atol=1e-9)
    np.testing.assert_allclose(loaded.records[0].u, SERVO.u, atol=1e-9)
    np.testing.assert_allclose(loaded.records[0].y, SERVO.y, atol=1e-9)
    assert "not used: temperature" in Path("arm.yaml").read_text()


def test_a_damper_in_millimetres_is_read_as_it_was_written() -> None:
    found = write_from_log(
        "d", log(**{"t": DAMPER.t, "Stroke [mm]": 1e3 * DAMPER.u, "F": DAMPER.y})
    )
    assert found.kind == "axis: damper"
    record = load_axis("d.yaml").records[0]
    np.testing.assert_allclose(record.u, DAMPER.u, atol=1e-9)
    np.testing.assert_allclose(record.y, DAMPER.y, atol=1e-9)


def test_a_drive_lacks_only_what_a_log_cannot_say() -> None:
    write_from_log("c", log(t=DRIVE.t, motor_force_N=DRIVE.u, position=DRIVE.y))
    faults = look_at("c.yaml").faults
    assert [f.key for f in faults] == ["nominal"]
    assert "lacks mass" in faults[0].message
    text = Path("c.yaml").read_text().replace("nominal: {}", "nominal: {mass: 40.0}")
    Path("c.yaml").write_text(text)
    assert not look_at("c.yaml").faults


@pytest.mark.parametrize(("scale", "unit"), [(1.0, "rad"), (180.0 / np.pi, "deg")])
def test_an_angle_without_a_unit_is_told_by_its_size(scale: float, unit: str) -> None:
    turn = 4.0 * SERVO.u
    write_from_log("arm", log(t=SERVO.t, angle_target=scale * turn, angle_actual=scale * turn))
    assert load_axis("arm.yaml", data=False).spec.channels["input"].unit == unit


@pytest.mark.parametrize(
    ("factor", "rate", "unit"),
    [
        (1.0, 1000, "s"),
        (1e3, 1000, "ms"),
        (1e3, 50, "ms"),
        (1e3, 2000, "ms"),
        (1e6, 100, "us"),
        (1e9, 1000, "ns"),
    ],
)
def test_the_unit_of_stamps_is_told_by_their_steps(factor: float, rate: int, unit: str) -> None:
    assert time_unit(factor * np.arange(100) / rate)[0] == unit


def test_dates_are_a_clock() -> None:
    stamps = pd.Timestamp("2026-03-01T09:59:58") + pd.to_timedelta(SERVO.t, unit="s")
    write_from_log("arm", log(timestamp=stamps, command=SERVO.u, position=SERVO.y))
    assert "dates or times of day" in Path("arm.yaml").read_text()
    np.testing.assert_allclose(load_axis("arm.yaml").records[0].t, SERVO.t, atol=1e-6)


def test_a_log_without_a_clock_needs_its_rate_and_no_more() -> None:
    found = write_from_log("arm", log(command=SERVO.u, position=SERVO.y))
    assert found.open == ("t",)
    (fault,) = look_at("arm.yaml").faults
    assert "sample rate" in fault.message
    Path("arm.yaml").write_text(Path("arm.yaml").read_text().replace("# rate: 1000.0", "rate: 100"))
    assert not look_at("arm.yaml").faults


ANGLES = {"shoulder": np.sin(3.0 * SERVO.t), "elbow": 0.5 * np.cos(2.0 * SERVO.t)}


def test_a_log_of_two_joints_is_an_arm_that_lacks_only_its_model() -> None:
    """Degrees and currents; a command beside them is no joint."""
    columns = {"t": SERVO.t}
    for k, (joint, q) in enumerate(ANGLES.items()):
        columns |= {f"{joint}_target_deg": np.degrees(q), f"{joint}_angle_deg": np.degrees(q)}
        columns |= {f"motor_current_{joint}_A": (k + 1.0) * q}
    found = write_from_log("two", log(**columns))
    assert (found.kind, found.open) == ("axis: arm", ())
    assert found.guesses["elbow.input"] == "motor_current_elbow_A"
    assert len(Path("two.yaml").read_text().splitlines()) <= 15 + 1  # and what is not used
    (fault,) = look_at("two.yaml").faults
    assert (fault.key, "takes the URDF or MJCF" in fault.message) == ("model", True)
    Path("arm.urdf").write_text(URDF)
    loaded = load_axis("two.yaml")
    for k, (joint, q) in enumerate(ANGLES.items()):
        place = list(loaded.arm.joints).index(joint)
        np.testing.assert_allclose(loaded.records[0].q[:, place], q, atol=1e-9)
        np.testing.assert_allclose(loaded.records[0].u[:, place], (k + 1.0) * q, atol=1e-9)


def test_joints_by_number_are_named_so_and_the_check_lists_those_of_the_model() -> None:
    q = ANGLES["elbow"]
    found = write_from_log("two", log(t=SERVO.t, q1=q, q2=2.0 * q, tau1=q, tau2=q, F_tcp_x=q))
    joints = ["joint_1.position", "joint_1.input", "joint_2.position", "joint_2.input"]
    assert list(found.guesses) == ["t", *joints]
    Path("arm.urdf").write_text(URDF)
    assert "its joints of one axis are shoulder, elbow" in look_at("two.yaml").faults[0].message


def test_neither_one_joint_nor_two_directions_are_an_arm() -> None:
    q = ANGLES["elbow"]
    assert write_from_log("one", log(t=SERVO.t, q1=q, tau1=q)).kind == "axis: drive"
    found = write_from_log("bench", log(t=SERVO.t, pos_x=q, pos_y=q, force_x=q, force_y=q))
    assert found.kind != "axis: arm"


def test_what_cannot_be_guessed_stands_as_a_comment_with_the_choices() -> None:
    found = write_from_log("odd", log(t=SERVO.t, foo=SERVO.u, bar=SERVO.y))
    assert found.open == ("input", "output")
    text = Path("odd.yaml").read_text()
    assert "# input: {column: ...}   # could not be guessed; choices: foo, bar" in text
    assert any(f.key == "axis" and "drive" in f.message for f in look_at("odd.yaml").faults)
    filled = text.replace("# input: {column: ...}", "input: {column: foo}")
    filled = filled.replace("# output: {column: ...}", "output: {column: bar}")
    Path("odd.yaml").write_text(filled.replace("axis:", "axis: servo"))
    assert not look_at("odd.yaml").faults


@pytest.mark.parametrize("swap", [False, True])
def test_columns_without_names_are_guessed_by_their_numbers(swap: bool) -> None:
    """Whichever of the two ends of a servo stands first."""
    ends = (SERVO.y, SERVO.u) if swap else (SERVO.u, SERVO.y)
    rows = pd.DataFrame(np.column_stack([*ends, 1e3 * SERVO.t]))
    rows.to_csv("log.csv", index=False, header=False, sep=";", decimal=",")
    found = write_from_log("arm", [Path("log.csv")])
    assert (found.kind, found.open) == ("axis: servo", ())
    assert "columns are 1, 2" in next(found.lines())
    record = load_axis("arm.yaml").records[0]
    np.testing.assert_allclose(record.t, SERVO.t, atol=1e-9)
    np.testing.assert_allclose(record.u, SERVO.u, atol=1e-9)
    np.testing.assert_allclose(record.y, SERVO.y, atol=1e-9)


def test_what_a_log_without_names_does_not_tell_is_open_whatever_it_is_said_to_be() -> None:
    rows = np.column_stack([DRIVE.t, DRIVE.u, DRIVE.y])
    np.savetxt("log.csv", rows, delimiter=",")
    assert write_from_log("any", [Path("log.csv")]).open == ("input", "output")
    write_from_log("c", [Path("log.csv")], "drive")
    filled = Path("c.yaml").read_text().replace("# input: {column: ...}", 'input: {column: "2"}')
    filled = filled.replace("# output: {column: ...}", 'output: {column: "3"}')
    Path("c.yaml").write_text(filled.replace("nominal: {}", "nominal: {mass: 2.0}"))
    np.testing.assert_allclose(load_axis("c.yaml").records[0].u, DRIVE.u)
    rig = write_from_log("rig", [Path("log.csv")], "dataset")
    assert rig.open == ("pose_cmd.pz", "pose_act.pz", "wrench_meas.fz", "wrench_comp.fz")


def test_text_among_the_columns_is_left_out() -> None:
    write_from_log("arm", log(t=SERVO.t, cmd=SERVO.u, position=SERVO.y, mode="auto"))
    assert "constant, empty or no numbers: mode" in Path("arm.yaml").read_text()
    assert not look_at("arm.yaml").faults


def test_a_rig_is_read_as_it_was_written_with_a_scenario_beside_it() -> None:
    """Foreign names, millimetres and kilonewtons; the masses of the example are those of the log."""
    table, out = bounce.columns(), {}
    out["Time [ms]"] = 1e3 * table["t"]
    for axis in "xyz":
        out[f"X_cmd_{axis} [mm]".replace("X", "pos")] = 1e3 * table[f"pose_cmd.p{axis}"]
        out[f"pos_act_{axis} [mm]"] = 1e3 * table[f"pose_act.p{axis}"]
        out[f"Force {axis.upper()} (kN)"] = 1e-3 * table[f"wrench_meas.f{axis}"]
        out[f"M{axis}_Nm"] = table[f"wrench_meas.t{axis}"]
    found = write_from_log("rig", log(**out))
    assert found.kind == "dataset"
    assert found.guesses["wrench_meas.tx"] == "Mx_Nm"
    assert found.guesses["pose_cmd.pz"] == "pos_cmd_z [mm]"
    assert not look_at("rig-scenario.yaml").faults
    looked = look_at("rig.yaml")
    assert not looked.faults, looked.faults
    from hiltestbed.config.dataset import load_dataset

    approach = load_dataset("rig.yaml").nominal.approach
    assert approach.gap == pytest.approx(bounce.GAP, rel=1e-3)
    assert approach.velocity[2] == pytest.approx(bounce.SPEED, rel=1e-3)


@pytest.mark.parametrize(("angles", "unit"), [([3.0, -2.0, 0.1], "deg"), ([0.2, 0.1, 0.0], "rad")])
def test_an_attitude_in_degrees_is_not_one_of_ports_that_look_past_each_other(
    angles: list[float], unit: str
) -> None:
    """3 rad would be; all three angles have one unit."""
    t = np.arange(400) / 1000.0
    names = ("roll", "pitch", "yaw")  # the last one turns most
    turns = {f"pose_act_{n}": angles[k] + 0.1 * (k + 1) * t for k, n in enumerate(names)}
    place = {"pose_act.pz": -0.01 + 0.03 * t, "wrench_meas.fz": np.maximum(t - 0.3, 0.0)}
    assert write_from_log("rig", log(t=t, **turns, **place)).kind == "dataset"
    text = Path("rig.yaml").read_text()
    assert text.count(f"unit: {unit}}}") == 3


def test_three_logs_of_a_rig_with_one_axis_and_a_force_that_shows_the_reaction() -> None:
    """One run a log, each with the speed and the gap that it shows; a push is made positive."""
    from hiltestbed.config.dataset import load_dataset

    t, logs = np.arange(400) * 1e-3, []
    for run, speed in enumerate((0.03, 0.05)):
        z = -10.0 + 1e3 * speed * (t + 1e-3)
        columns = {"Time [ms]": 1e3 * t, "Z soll [mm]": z, "Z ist [mm]": z, "Fz [kN]": -(t**2)}
        pd.DataFrame(columns).to_csv(f"{run}.csv", index=False)
        logs.append(Path(f"{run}.csv"))
    found = write_from_log("rig", logs)
    assert (found.kind, found.others) == ("dataset", ("servo", "drive", "damper"))
    dataset = load_dataset("rig.yaml")
    assert dataset.nominal.approach.velocity[2] == pytest.approx(0.03, rel=1e-3)
    assert dataset.scenarios[1].approach.velocity[2] == pytest.approx(0.05, rel=1e-3)
    assert "unit: kN, scale: -1}" in Path("rig.yaml").read_text()
    servo = write_from_log("axis", logs, "servo")
    assert (servo.kind, servo.not_used) == ("axis: servo", ("Fz [kN]",))
    Path("0.csv").write_text("a,b\n1,2\n2,3\n")
    with pytest.raises(InputError, match=r"has no column .Time .ms.. that changes"):
        write_from_log("other", logs[::-1])


def test_missing_samples_hide_no_approach() -> None:
    """Rows without a time or a position are passed over; both sides of them tell the speed."""
    from hiltestbed.config.dataset import load_dataset

    t = np.arange(400) * 1e-3
    pz = -0.01 + 0.03 * t
    t[3], pz[1:10:2] = np.nan, np.nan
    write_from_log("rig", log(**{"t": t, "pose_act.pz": pz, "wrench_meas.fz": np.sin(t)}))
    approach = load_dataset("rig.yaml").nominal.approach
    assert approach.gap == pytest.approx(0.01, rel=1e-3)
    assert approach.velocity[2] == pytest.approx(0.03, rel=1e-3)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (bytes(range(256)) * 9, "is not text"),
        (b"", "is empty"),
        (b"time,pos,current\n", "is no table of numbers"),
        (b"time,pos,current\n0,1,2\n", "holds no column of numbers that change"),
    ],
)
def test_what_is_no_record_of_a_motion_is_refused(text: bytes, said: str) -> None:
    Path("log.csv").write_bytes(text)
    with pytest.raises(InputError, match=said):
        write_from_log("arm", [Path("log.csv")])
    assert not Path("arm.yaml").exists()


def test_nothing_is_overwritten() -> None:
    Path("arm.yaml").write_text("mine")
    with pytest.raises(InputError, match="exists already"):
        write_from_log("arm", log(t=SERVO.t, cmd=SERVO.u, position=SERVO.y))
    assert Path("arm.yaml").read_text() == "mine"


def test_the_command_says_what_it_wrote(call) -> None:
    path = log(t=SERVO.t, cmd=SERVO.u, position=SERVO.y)
    status, out, _ = call("new", "arm", "--from", str(path[0]), "--json")
    assert status == 0
    assert json.loads(out) == {
        "file": "arm.yaml",
        "files": ["arm.yaml"],
        "kind": "axis: servo",
        "channels": {"t": "t", "input": "cmd", "output": "position"},
        "open": [],
        "not_used": [],
        "other_kinds": [],
        "notes": [],
    }
    with pytest.raises(InputError, match=r"--from absent\.csv: names no file"):
        write_from_log("other", [Path("absent.csv")])


@pytest.mark.parametrize(
    ("column", "quantity", "part", "unit"),
    [
        ("current_position", "position", "", ""),
        ("motor_current_A", "current", "", "A"),
        ("Fz [kN]", "force", "fz", "kN"),
        ("Fz_comp [N]", "force", "fz", "N"),
        ("force_kN", "force", "", "kN"),
        ("z_cmd_mm", "position", "pz", "mm"),
        ("ft.wrench.torque.x", "torque", "tx", ""),
        ("pose.pose.orientation.w", "", "qw", ""),
        ("joint_states.effort.elbow", "torque", "", ""),
        ("joint_states.position.a", "position", "", ""),
        ("wrench_true.fz", "other", "fz", ""),
        ("speed_rpm", "velocity", "", ""),
        ("displacement_m", "position", "", "m"),
        ("force_V", "other", "", "V"),
    ],
)
def test_names_say_what_a_column_is(column: str, quantity: str, part: str, unit: str) -> None:
    role = role_of(column)
    assert (role.quantity, role.part, role.unit) == (quantity, part, unit)


def test_an_angle_that_does_not_change_belongs_to_its_attitude() -> None:
    t = np.arange(400) / 1000.0
    angles = {"roll_deg": 0.1 * t, "pitch_deg": 0.2 * t, "yaw_deg": 0.0 * t}
    places = {f"{axis}_mm": 10.0 * t for axis in "xyz"}
    found = write_from_log("rig", log(t=t, **places, Fz_N=t, **angles), "dataset")
    assert found.guesses["pose_act.rz"] == "yaw_deg"
