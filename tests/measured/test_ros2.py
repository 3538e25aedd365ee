"""Bags of ROS 2: the numbers that were recorded come back by topic and field, on the times of their
stamps; what a bag does not hold is said.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hiltestbed.axis.dataset import load_axis
from hiltestbed.config.check import look_at
from hiltestbed.config.from_log import write_from_log
from hiltestbed.errors import InputError, MissingExtra
from hiltestbed.measured import examine
from hiltestbed.measured.formats import data_file, format_of, read_columns
from tests.axis import machines
from tests.axis.test_arm import URDF

from . import bounce

pytestmark = pytest.mark.usefixtures("in_this_process")

rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")

STORE = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
T = STORE.types
START = 1_700_000_000_000_000_000  # [ns] of the first message
LATE = 2_000_000  # [ns] from the stamp of a message to its log time


def _header(ns: int) -> Any:
    stamp = T["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
    return T["std_msgs/msg/Header"](stamp=stamp, frame_id="base")


def _joints(ns: int, names: list[str], position: list[float], effort: list[float]) -> Any:
    return T["sensor_msgs/msg/JointState"](
        header=_header(ns),
        name=names,
        position=np.array(position, dtype=float),
        velocity=np.zeros(0),
        effort=np.array(effort, dtype=float),
    )


def _vector(x: float, y: float, z: float) -> Any:
    return T["geometry_msgs/msg/Vector3"](x=x, y=y, z=z)


def _wrench(ns: int, fz: float) -> Any:
    inner = T["geometry_msgs/msg/Wrench"](force=_vector(0.0, 0.0, fz), torque=_vector(0, 0, 0))
    return T["geometry_msgs/msg/WrenchStamped"](header=_header(ns), wrench=inner)


def _pose(ns: int, p: tuple, q: tuple) -> Any:
    point = T["geometry_msgs/msg/Point"](*map(float, p))
    pose = T["geometry_msgs/msg/Pose"](point, T["geometry_msgs/msg/Quaternion"](*map(float, q)))
    return T["geometry_msgs/msg/PoseStamped"](header=_header(ns), pose=pose)


def _twist(ns: int, vz: float) -> Any:
    twist = T["geometry_msgs/msg/Twist"](linear=_vector(0.0, 0.0, vz), angular=_vector(0, 0, 0))
    return T["geometry_msgs/msg/TwistStamped"](header=_header(ns), twist=twist)


def _number(value: float) -> Any:
    return T["std_msgs/msg/Float64"](data=value)


def write_bag(folder: Path, topics: dict[str, list[tuple[int, Any]]]) -> Path:
    """The folder of a bag: topic to its messages with their log times [ns]."""
    plugin = rosbag2.StoragePlugin.MCAP
    with rosbag2.Writer(folder, version=9, storage_plugin=plugin) as writer:
        rows = []
        for topic, messages in topics.items():
            kind = messages[0][1].__msgtype__
            connection = writer.add_connection(topic, kind, typestore=STORE)
            rows += [(at, connection, STORE.serialize_cdr(m, kind)) for at, m in messages]
        for at, connection, data in sorted(rows, key=lambda row: row[0]):
            writer.write(connection, at, data)
    return folder


def write_all(folder: Path, rows: int = 20) -> Path:
    """A bag with every kind of message; the value of a row is its number."""
    ns = [START + 1_000_000 * k for k in range(rows)]
    numbers = T["std_msgs/msg/Float64MultiArray"]
    layout = T["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    both = ["shoulder", "elbow"]
    return write_bag(
        folder,
        {
            "/arm/joint_states": [
                # the second half in the other order, as when drivers restart
                (t + LATE, _joints(t, both, [k, -k], [2.0 * k, 0.0]) if k < rows // 2
                 else _joints(t, both[::-1], [-k, k], [0.0, 2.0 * k]))
                for k, t in enumerate(ns)
            ],
            "/ft": [(t + LATE, _wrench(t, 3.0 * k)) for k, t in enumerate(ns)],
            "/pose": [(t + LATE, _pose(t, (0, 0, k), (0, 0, 0, 1))) for k, t in enumerate(ns)],
            "/twist": [(t + LATE, _twist(t, 4.0 * k)) for k, t in enumerate(ns)],
            "/goal": [(t, _number(5.0 * k)) for k, t in enumerate(ns)],
            "/many": [(t, numbers(layout, np.array([0.0, 6.0 * k]))) for k, t in enumerate(ns)],
        },
    )  # fmt: skip


COLUMNS = {
    "arm.joint_states.position.shoulder": 1.0,
    "arm.joint_states.effort.shoulder": 2.0,
    "/ft/wrench/force/z": 3.0,
    "pose.pose.position.z": 1.0,
    "twist.twist.linear.z": 4.0,
    "goal.data": 5.0,
    "many.data.1": 6.0,
}


def test_numbers_come_back_by_topic_and_field_on_the_times_of_their_stamps(tmp_path: Path) -> None:
    """Joints by name, whatever their order in a message; a message without header has the time of
    the log.
    """
    file = data_file(write_all(tmp_path / "bag"))
    assert file.suffix == ".mcap"
    found = read_columns(file, frozenset(COLUMNS))
    rows = np.arange(20.0)
    for name, factor in COLUMNS.items():
        np.testing.assert_array_equal(found.data[name], factor * rows, err_msg=name)
        np.testing.assert_allclose(found.clock[name], 1e-3 * rows, atol=1e-9, err_msg=name)
    assert found.notes[0].startswith("times are those of header.stamp: /")
    assert "/ft (2 ms before the log)" in found.notes[0]
    assert found.notes[0].endswith("; those of the log: /goal, /many")
    assert "arm.joint_states.position.elbow" in found.names
    assert found.topics["ft"] == "geometry_msgs/msg/WrenchStamped"


def test_a_joint_by_its_index_is_the_one_that_stands_there(tmp_path: Path) -> None:
    file = data_file(write_all(tmp_path / "bag"))
    found = read_columns(file, frozenset({"arm.joint_states.position.0"}))
    rows = np.arange(20.0)
    sign = np.where(rows < 10, 1.0, -1.0)
    np.testing.assert_array_equal(found.data["arm.joint_states.position.0"], sign * rows)


def test_joints_of_two_drivers_on_one_topic_are_told_apart_by_name(tmp_path: Path) -> None:
    messages = [
        (START + k, _joints(START + k, ["abc"[k % 2]], [float(k)], [0.0])) for k in range(10)
    ]
    file = data_file(write_bag(tmp_path / "bag", {"/joint_states": messages}))
    found = read_columns(file, frozenset({"joint_states.position.b"}))
    np.testing.assert_array_equal(found.data["joint_states.position.b"], [1, 3, 5, 7, 9])


@pytest.mark.parametrize(
    ("ns", "used"),
    [(0, "log"), (1_000_000, "log"), (START, "stamp")],
    ids=["no stamps", "simulated time", "the clock of the log"],
)
def test_stamps_of_another_clock_are_not_compared_with_times_of_the_log(
    tmp_path: Path, ns: int, used: str
) -> None:
    """Beside a topic without stamps, stamps that do not run or lie elsewhere are of no use."""
    step = 0 if ns == 0 else 1_000_000
    topics = {
        "/ft": [(START + LATE + 1_000_000 * k, _wrench(ns + step * k, 1.0)) for k in range(9)],
        "/goal": [(START + 1_000_000 * k, _number(1.0)) for k in range(9)],
    }
    file = data_file(write_bag(tmp_path / "bag", topics))
    found = read_columns(file, frozenset({"ft.wrench.force.z", "goal.data"}))
    late = found.clock["ft.wrench.force.z"][0] - found.clock["goal.data"][0]
    assert late == pytest.approx(2e-3 if used == "log" else 0.0, abs=1e-9)
    assert ("of another clock" in "".join(found.notes)) == (ns == 1_000_000)


def test_a_bag_of_joint_states_becomes_an_arm_by_the_names_of_its_joints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    rows, both = np.arange(400), ["shoulder", "elbow"]
    angles = np.sin(0.02 * rows), np.cos(0.03 * rows)
    messages = [
        (at + LATE, _joints(at, both, [a, b], [2.0 * a, 3.0 * b]))
        for k, (a, b) in enumerate(zip(*angles, strict=True))
        if (at := START + 2_000_000 * k)
    ]
    write_bag(tmp_path / "bag", {"/arm/joint_states": messages})
    found = write_from_log("mine", [Path("bag")])
    assert (found.kind, found.open) == ("axis: arm", ())
    (tmp_path / "arm.urdf").write_text(URDF)
    loaded = load_axis("mine.yaml")
    np.testing.assert_allclose(loaded.records[0].t, 2e-3 * rows, atol=1e-9)
    np.testing.assert_allclose(loaded.records[0].q, np.column_stack(angles), atol=1e-12)
    np.testing.assert_allclose(loaded.records[0].u, loaded.records[0].q * [2.0, 3.0], atol=1e-12)


def test_a_rig_is_read_from_a_bag(tmp_path: Path) -> None:
    """Pose and wrench of the bounce in closed form, in a bag's folder."""
    table = bounce.columns()
    ns = [START + round(1e9 * t) for t in table["t"]]
    parts = ("px", "py", "pz", "qx", "qy", "qz", "qw")
    pose = np.stack([table[f"pose_act.{part}"] for part in parts], axis=1)
    topics = {
        "/pose": [(t + LATE, _pose(t, p[:3], p[3:])) for t, p in zip(ns, pose, strict=True)],
        "/ft": [
            (t + LATE, _wrench(t, f)) for t, f in zip(ns, table["wrench_meas.fz"], strict=True)
        ],
    }
    write_bag(tmp_path / "bag", topics)
    where = "pose.pose."
    names = [f"position.{a}" for a in "xyz"] + [f"orientation.{a}" for a in "xyzw"]
    lines = [
        f"  pose_act.{part}: {{column: {where}{name}}}"
        for part, name in zip(parts, names, strict=True)
    ]
    channels = "\n".join(["channels:", *lines, "  wrench_meas.fz: {column: /ft/wrench/force/z}"])
    record = examine(bounce.write_dataset(tmp_path, channels=channels, files=("bag",))).runs[0]
    np.testing.assert_allclose(
        record.record.column("wrench_meas.fz"), table["wrench_meas.fz"], atol=1e-9
    )
    np.testing.assert_allclose(record.record.column("pose_act.pz"), pose[:, 2], atol=1e-12)


AXIS = """\
axis: servo
runs: [{{file: {file}}}]
channels:
  input: {{column: {command}}}
  output: {{column: joint_states.position.elbow}}
"""


@pytest.fixture(scope="module")
def servo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a bag of a servo whose command has a topic of its own, at half the rate."""
    folder, r = tmp_path_factory.mktemp("servo"), machines.servo(0)
    ns = [START + round(1e9 * t) for t in r.t]
    goal = [(t - 10_000, _number(u)) for t, u in zip(ns[::2], r.u[::2], strict=True)]
    joints = [(t + LATE, _joints(t, ["elbow"], [y], [0.0])) for t, y in zip(ns, r.y, strict=True)]
    write_bag(folder / "bag", {"/goal": goal, "/joint_states": joints})
    return folder


def _axis(folder: Path, file: str = "bag", command: str = "goal.data") -> Path:
    path = folder / "axis.yaml"
    path.write_text(AXIS.format(file=file, command=command))
    return path


def test_a_command_of_another_topic_stands_until_the_next(servo: Path) -> None:
    loaded, r = load_axis(_axis(servo)), machines.servo(0)
    record = loaded.records[0]
    np.testing.assert_allclose(record.t, r.t, atol=1e-6)
    np.testing.assert_array_equal(record.u, np.repeat(r.u[::2], 2))
    np.testing.assert_array_equal(record.y, r.y)
    assert any("header.stamp" in remark for remark in loaded.remarks)


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("target.data", r"the topics are /goal \(std_msgs/msg/Float64\), /joint_states \(sensor_"),
        ("joint_states.position.elbov", "nearest: joint_states.position.elbow"),
        ("/goal/date", "nearest: goal.data"),
    ],
)
def test_what_a_bag_lacks_is_said_with_what_it_has(servo: Path, command: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        load_axis(_axis(servo, command=command))
    assert look_at(servo / "axis.yaml").faults


def test_a_message_of_unknown_type_is_said(tmp_path: Path) -> None:
    """A definition that lacks a type that it uses."""
    writer = pytest.importorskip("mcap.writer")
    with (tmp_path / "run.mcap").open("wb") as file:
        out = writer.Writer(file)
        out.start()
        schema = out.register_schema(name="my/msg/Force", encoding="ros2msg", data=b"my/Odd force")
        idl = out.register_schema(name="my/msg/Odd", encoding="ros2idl", data=b"module my {};")
        for topic, number in (("/force", schema), ("/odd", idl)):
            channel = out.register_channel(topic=topic, message_encoding="cdr", schema_id=number)
            out.add_message(channel, log_time=1, data=b"\0\1\0\0" + bytes(8), publish_time=1)
        out.finish()
    channels = "channels: {pose_act.pz: {column: force.force.z}, pose_act.px: {column: odd.x}}\n"
    with pytest.raises(InputError) as error:
        examine(bounce.write_dataset(tmp_path, files=("run.mcap",), channels=channels))
    assert "force: is of type my/msg/Force, which cannot be decoded" in str(error.value)
    assert "odd: is encoded as 'cdr' of type my/msg/Odd, described as 'ros2idl'" in str(error.value)


def test_a_folder_that_is_no_simple_bag_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    with pytest.raises(InputError, match=r"a folder with 0 MCAP files.*ros2 bag convert"):
        load_axis(_axis(tmp_path))


def test_without_the_decoder_a_bag_gives_the_install_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = data_file(write_all(tmp_path / "bag"))
    monkeypatch.setitem(__import__("sys").modules, "mcap_ros2.decoder", None)
    with pytest.raises(MissingExtra, match=r"pip install .hiltestbed\[mcap\]"):
        format_of(file).read(file, frozenset({"goal.data"}))
