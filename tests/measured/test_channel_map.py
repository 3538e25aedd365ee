"""Channel map: column, scale, unit and offset; for all files or for one; and what it refuses."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed.errors import InputError
from hiltestbed.measured import load_dataset
from hiltestbed.measured.record import Record
from hiltestbed.measured.units import UNITS, factor

from . import bounce


def _record(folder: Path, table: bounce.Table, channels: str) -> Record:
    path = bounce.write_dataset(folder, table, channels=f"channels: {channels}\n")
    return load_dataset(path).runs[0].record


def test_value_is_scale_times_unit_times_file_plus_offset(tmp_path: Path) -> None:
    """And what is not mapped is found under its own name."""
    good, table = bounce.columns(), bounce.columns()
    table["Fz"] = -1e-3 * (table.pop("wrench_meas.fz") - 2.0)  # kN, pulling positive, tare of 2 N
    entry = "{wrench_meas.fz: {column: Fz, unit: kN, scale: -1.0, offset: 2.0}}"
    record = _record(tmp_path, table, entry)
    found, expected = record.column("wrench_meas.fz"), good["wrench_meas.fz"]
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)
    assert set(record.columns()) == set(good) - {"t"}


def test_an_attitude_in_degrees_is_that_about_fixed_axes(tmp_path: Path) -> None:
    table = bounce.columns()
    wobble = np.sin(2.0 * np.pi * table["t"])
    angles = np.stack([0.3 * wobble, -0.2 * wobble, 0.5 * wobble], axis=-1)
    table = {name: values for name, values in table.items() if not name.startswith("pose_act.q")}
    table |= {name: angles[:, j] for j, name in enumerate(("roll", "pitch", "yaw"))}
    channels = """channels:
  pose_act.rx: {column: roll, unit: deg}
  pose_act.ry: {column: pitch, unit: deg}
  pose_act.rz: {column: yaw, unit: deg}
"""
    file = bounce.write_dataset(tmp_path, table, channels=channels)
    record = load_dataset(file).runs[0].record
    found = np.stack([record.column(f"pose_act.{q}") for q in ("qx", "qy", "qz", "qw")], axis=-1)
    expected = Rotation.from_euler("xyz", angles, degrees=True).as_quat(canonical=True)
    np.testing.assert_allclose(found, expected[: len(found)], atol=1e-9)
    file.write_text(file.read_text().replace("  pose_act.rz: {column: yaw, unit: deg}\n", ""))
    with pytest.raises(InputError, match=r"pose_act\.rx, pose_act\.ry; allowed are all of"):
        load_dataset(file)


def test_clock_with_unit_and_offset(tmp_path: Path) -> None:
    table = bounce.columns()
    table["Time [ms]"] = 1e3 * table.pop("t") + 250.0
    channels = 'channels: {t: {column: "Time [ms]", unit: ms, offset: -0.25}}\n'
    dataset = load_dataset(bounce.write_dataset(tmp_path, table, channels=channels))
    assert dataset.remarks == ()
    found = dataset.runs[0].record.column("pose_act.pz")
    np.testing.assert_allclose(found, bounce.columns()["pose_act.pz"], atol=1e-9)


def test_one_file_may_be_mapped_differently(tmp_path: Path) -> None:
    """The sensor was turned round in the second run alone."""
    turned = bounce.columns()
    bounce.changed("wrench", -1.0, "fz")(turned)
    path = bounce.write_dataset(tmp_path, bounce.columns(), turned)
    said = r"run_1\.parquet: wrench_comp\.fz, wrench_meas\.fz: pulls while pushing"
    with pytest.raises(InputError, match=said):
        load_dataset(path)
    own = "{wrench_meas.fz: {scale: -1.0}, wrench_comp.fz: {scale: -1.0}}"
    path.write_text(path.read_text().replace("run_1.parquet}", f"run_1.parquet, channels: {own}}}"))
    first, second = (run.record for run in load_dataset(path).runs)
    np.testing.assert_array_equal(first.column("wrench_meas.fz"), second.column("wrench_meas.fz"))


def test_data_may_lie_where_the_environment_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "elsewhere").mkdir()
    pq.write_table(pa.table(bounce.columns()), tmp_path / "elsewhere" / "run.parquet")
    path = bounce.write_dataset(tmp_path, files=('"${RIG_RECORDS}/run.parquet"',))
    monkeypatch.setenv("RIG_RECORDS", str(tmp_path / "elsewhere"))
    assert load_dataset(path).files == (tmp_path / "elsewhere" / "run.parquet",)
    monkeypatch.delenv("RIG_RECORDS")
    with pytest.raises(InputError, match="RIG_RECORDS"):
        load_dataset(path)


@pytest.mark.parametrize(
    ("entry", "fault"),
    [
        ("wrench_meas.fz: {unit: mm}", r"no unit of this channel \(got 'mm'\); allowed: N, daN,"),
        ("wrench_meas.fy: {scale: 0.0}", "is out of range"),
        ("wrench_mes.fz: {column: F}", "unknown channel"),
    ],
)
def test_a_faulty_entry_is_refused_with_its_line(tmp_path: Path, entry: str, fault: str) -> None:
    path = bounce.write_dataset(tmp_path, bounce.columns(), channels=f"channels:\n  {entry}\n")
    with pytest.raises(InputError, match=fault) as raised:
        load_dataset(path)
    assert raised.value.faults[0].line == 5


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("force.fz", "wrench_meas.fz"),
        ("F_comp.fz", "wrench_comp.fz"),
        ("wrench_tru.fz", "wrench_true.fz"),
        ("setpoint.pz", "pose_cmd.pz"),
        ("banana.peel", None),
    ],
)
def test_an_unknown_channel_is_taken_for_a_measured_one(
    tmp_path: Path, name: str, meant: str | None
) -> None:
    channels = f"channels:\n  {name}: {{column: F}}\n"
    path = bounce.write_dataset(tmp_path, bounce.columns(), channels=channels)
    with pytest.raises(InputError) as raised:
        load_dataset(path)
    found = re.search(r"did you mean '([\w.]+)'", raised.value.faults[0].message)
    assert (found[1] if found else None) == meant


def test_one_message_for_a_mistake_that_six_channels_share(tmp_path: Path) -> None:
    """In the map, in the names of columns, and in the data: each is one line that names all
    channels and what each would be.
    """
    parts = ("fx", "fy", "fz", "tx", "ty", "tz")
    unknown = "".join(f"  force.{part}: {{column: {part}}}\n" for part in parts)
    lacking = "".join(f"  wrench_meas.{part}: {{column: Force_{part}}}\n" for part in parts)
    for entries in (unknown, lacking):
        path = bounce.write_dataset(tmp_path, bounce.columns(), channels=f"channels:\n{entries}")
        with pytest.raises(InputError) as raised:
            load_dataset(path)
        assert len(raised.value.faults) == 1
        assert all(name in str(raised.value) for name in (f"wrench_meas.{part}" for part in parts))
    assert all(f"Force_{part}" in str(raised.value) for part in parts)
    table = bounce.columns()
    for group in ("wrench_meas", "wrench_comp"):
        table |= {f"{group}.fx": -0.3 * table[f"{group}.fz"], f"{group}.fz": -table[f"{group}.fz"]}
    for group in ("pose_cmd", "pose_act"):
        depart = table[f"{group}.pz"] - bounce.SPEED * table["t"]
        table[f"{group}.px"] = bounce.SIDE * table["t"] + 0.3 * depart
    with pytest.raises(InputError) as raised:
        load_dataset(bounce.write_dataset(tmp_path, table))
    (wrong,) = (fault for fault in raised.value.faults if "pulls while pushing" in fault.message)
    assert wrong.key == "wrench_comp.fz, wrench_comp.fx, wrench_meas.fz, wrench_meas.fx"
    others = "likewise for wrench_comp.fx, wrench_meas.fz, wrench_meas.fx"
    assert f"{{wrench_comp.fz: {{scale: -1}}}}; {others}" in wrong.message


def test_units_are_what_they_are_defined_to_be() -> None:
    """Each against others: 1 lbf = 0.45359237 kgf, 12 in = 1 ft, 60 rpm = 360 deg/s; times."""
    assert [UNITS["s"][u] for u in ("min", "h", "d")] == [60.0, 3600.0, 86400.0]
    assert factor("wrench_meas.tx", "N·mm") == 1e-3
    assert UNITS["N"]["lbf"] == pytest.approx(0.45359237 * UNITS["N"]["kgf"], rel=1e-14)
    assert UNITS["N m"]["lbf ft"] == pytest.approx(12 * UNITS["N m"]["lbf in"], rel=1e-14)
    assert 60 * UNITS["rad/s"]["rpm"] == pytest.approx(360 * UNITS["rad/s"]["deg/s"], rel=1e-14)
    assert factor("pose_act.px", "mm") == 1e-3
    assert factor("t", None) == 1.0
