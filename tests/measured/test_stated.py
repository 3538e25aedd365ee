"""What a file says of itself is used: units, missing samples, start times, arrays and links; and
what contradicts the channel map is said.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hiltestbed import plugins
from hiltestbed.errors import InputError
from hiltestbed.measured import examine
from hiltestbed.measured.formats import read_columns
from hiltestbed.measured.units import unit_named

from . import bounce

pytestmark = pytest.mark.usefixtures("in_this_process")

TABLE = bounce.columns()
WANTED = frozenset(TABLE)
EXAMPLES = Path(__file__).parents[2] / "examples" / "plugins"


def group(name: str, scale: float = 1.0) -> np.ndarray:
    """(rows, parts) of a group of the bounce."""
    return scale * np.column_stack([v for n, v in TABLE.items() if n.startswith(f"{name}.")])


def hdf5(path: Path, items: dict[str, Any], attrs: dict[str, dict[str, Any]] | None = None) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        for name, values in items.items():
            file[name] = values
        for name, given in (attrs or {}).items():
            file[name].attrs.update(given)


@pytest.mark.parametrize(
    ("text", "unit"),
    [("N·mm", "N mm"), ("Nmm", "N mm"), ("N*m", "N m"), ("[N.m]", "N m"), ("µs", "us"), ("Seconds", "s"),
     ("deg/s", "deg/s"), ("°/s", "deg/s"), ("mm s^-1", "mm/s"), ("m·s⁻¹", "m/s"), ("in-lbf", "lbf in"),
     ("hours", "h"), ("Newtons", "N"), ("mN", "mN"), ("MN", None), ("V", None)],
)  # fmt: skip
def test_a_unit_is_known_by_its_usual_spellings(text: str, unit: str | None) -> None:
    assert unit_named(text) == unit


@pytest.mark.parametrize(
    ("entry", "right", "said"),
    [
        ("{scale: 0.001}", 1.0, ""),  # whoever converts by hand
        ("{unit: N mm}", 1.0, ""),
        ("{unit: N m}", 1e3, "in N m by the channel map"),
        ("{scale: 0.5}", 500.0, "the scale alone is used"),
    ],
)
def test_a_channel_map_that_contradicts_the_file_counts_and_is_said(
    tmp_path: Path, entry: str, right: float, said: str
) -> None:
    table = pa.table(TABLE | {"wrench_meas.tx": 1e3 * TABLE["wrench_meas.tx"]})
    stated = {name: {"unit": "N mm"} if name == "wrench_meas.tx" else {} for name in TABLE}
    fields = [field.with_metadata(stated[field.name]) for field in table.schema]
    pq.write_table(table.cast(pa.schema(fields)), tmp_path / "run.parquet")
    channels = f"channels: {{wrench_meas.tx: {entry}}}\n"
    dataset = examine(bounce.write_dataset(tmp_path, files=("run.parquet",), channels=channels))
    found = dataset.runs[0].record.column("wrench_meas.tx")
    np.testing.assert_allclose(found, right * TABLE["wrench_meas.tx"], rtol=1e-9)
    texts = [r.text for r in dataset.remarks if r.channel == "wrench_meas.tx" and "file" in r.text]
    assert [said in text for text in texts] == ([True] if said else [])


def _links(path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    hdf5(path.with_name("other.h5"), {"raw/f": TABLE["wrench_meas.fz"]})
    hdf5(path, {"t": TABLE["t"], "a/pz": TABLE["pose_act.pz"]})
    with h5py.File(path, "a") as file:
        file["wrench_meas/fz"] = h5py.ExternalLink("other.h5", "/raw/f")
        file["pose_act"] = h5py.SoftLink("/a")
        file["a/up"] = h5py.SoftLink("/")  # a circle


def _compound(path: Path) -> None:
    rows = np.zeros(len(TABLE["t"]), dtype=[("t", "f8"), ("wrench_meas", "f8", (6,)), ("pz", "f4")])
    rows["t"], rows["wrench_meas"] = TABLE["t"], group("wrench_meas")
    hdf5(path, {"log": rows, "t": TABLE["t"], "wrench_meas": rows["wrench_meas"].T[None]})


def _lists(path: Path) -> None:
    poses = pa.array(list(group("pose_act")))
    rows = (dict(zip(("fx", "fy", "fz"), row, strict=False)) for row in group("wrench_meas"))
    forces = pa.array(list(rows))
    pq.write_table(pa.table({"t": TABLE["t"], "pose_act": poses, "wrench_meas": forces}), path)


def _mat(path: Path) -> None:
    import scipy.io

    scipy.io.savemat(path, {n: group(n).T for n in ("pose_act", "wrench_meas")} | {"t": TABLE["t"]})


@pytest.mark.parametrize(
    ("name", "write"),
    [("run.h5", _links), ("run.h5", _compound), ("run.parquet", _lists), ("run.mat", _mat)],
)
def test_links_fields_lists_and_arrays_either_way_round_are_columns(
    tmp_path: Path, name: str, write: Callable[[Path], None]
) -> None:
    write(tmp_path / name)
    found = read_columns(tmp_path / name, WANTED)
    for column in ("t", "wrench_meas.fz"):
        np.testing.assert_array_equal(found.data[column], TABLE[column], err_msg=column)
    if "pose_act.pz" in found.data:
        np.testing.assert_array_equal(found.data["pose_act.pz"], TABLE["pose_act.pz"])


@pytest.mark.parametrize(
    ("pose", "said"),
    [(np.zeros((7, 60, 10)), "7 x 60 x 10 numbers"), (group("pose_act")[:, :6], "6 numbers; the group has 7")],
)  # fmt: skip
def test_an_array_that_is_no_group_is_named_with_its_shape(
    tmp_path: Path, pose: np.ndarray, said: str
) -> None:
    items = {"t": TABLE["t"], "wrench_meas": group("wrench_meas"), "pose_act": pose}
    hdf5(tmp_path / "run.h5", items)
    with pytest.raises(InputError, match=f"pose_act: is an array of .*{said}"):
        examine(bounce.write_dataset(tmp_path, files=("run.h5",)))


def test_fill_values_and_empty_variables_are_missing(tmp_path: Path) -> None:
    force = TABLE["wrench_meas.fz"].astype(np.float32)
    force[[7, 8]] = 9.96921e36
    hdf5(
        tmp_path / "run.h5",
        {"t": TABLE["t"], "wrench_meas/fz": force, "pose_act/pz": TABLE["pose_act.pz"],
         "wrench_comp/fz": np.zeros(0)},
        {"wrench_meas/fz": {"_FillValue": np.float32(9.96921e36)}},
    )  # fmt: skip
    dataset = examine(bounce.write_dataset(tmp_path, files=("run.h5",)))
    column = dataset.runs[0].record.column("wrench_meas.fz")
    assert np.flatnonzero(np.isnan(column)).tolist() == [7, 8]
    assert any("is empty in the file" in r.text for r in dataset.remarks)


def test_waveforms_are_aligned_by_their_start_times(tmp_path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    start, late = np.datetime64("2024-05-01T12:00:00.000000"), 5
    waves = []
    for name in ("pose_act.pz", "wrench_meas.fz"):
        first = late if name.startswith("wrench") else 0
        values = TABLE[name][first:]
        wave = {"wf_increment": 1e-3, "wf_start_offset": 0.0, "wf_samples": len(values),
                "wf_start_time": start + np.timedelta64(1000 * first, "us")}  # fmt: skip
        waves.append(nptdms.ChannelObject(*name.split("."), values, wave))
    with nptdms.TdmsWriter(tmp_path / "run.tdms") as writer:
        writer.write_segment(waves)
    record = examine(bounce.write_dataset(tmp_path, files=("run.tdms",))).runs[0].record
    force = record.column("wrench_meas.fz")
    np.testing.assert_array_equal(force[late:], TABLE["wrench_meas.fz"][late:])
    assert np.isnan(force[:late]).all()


@pytest.mark.parametrize("even", ["log", "publish"])
def test_the_even_times_of_messages_are_their_clock(tmp_path: Path, even: str) -> None:
    """A buffer stamps ten messages at once; a topic in another encoding is nobody's."""
    pytest.importorskip("mcap")
    from mcap.writer import Writer

    with (tmp_path / "run.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        force = writer.register_channel(topic="/wrench_meas", message_encoding="json", schema_id=0)
        other = writer.register_channel(topic="/camera", message_encoding="cdr", schema_id=0)
        for k, value in enumerate(TABLE["wrench_meas.fz"]):
            good, bad = 1_000_000 * k, 10_000_000 * (k // 10 + 1)
            log, publish = (good, bad) if even == "log" else (bad, good)
            data = json.dumps({"fz": value}).encode()
            writer.add_message(force, log_time=log, data=data, publish_time=publish)
            writer.add_message(other, log_time=log, data=b"\1", publish_time=publish)
        writer.finish()
    found = read_columns(tmp_path / "run.mcap", WANTED)
    np.testing.assert_allclose(np.diff(found.clock["wrench_meas.fz"]), 1e-3, atol=1e-12)
    channels = "channels: {pose_act.pz: {column: camera.z}}\n"
    path = bounce.write_dataset(tmp_path, files=("run.mcap",), channels=channels)
    with pytest.raises(InputError, match=r"camera: is encoded as 'cdr'"):
        examine(path)


@pytest.mark.usefixtures("tables_as_shipped")
def test_a_plugin_adds_a_format_with_options_of_its_own(tmp_path: Path) -> None:
    plugins.load([str(EXAMPLES / "frames_log.py")])
    names = ("t", "wrench_meas.fz", "pose_act.pz")
    np.column_stack([TABLE[n] for n in names]).astype("<f8").tofile(tmp_path / "run.frames")
    channels = f"format: {{kind: frames, channels: [{', '.join(names)}]}}\n"
    path = bounce.write_dataset(tmp_path, files=("run.frames",), channels=channels)
    record = examine(path).runs[0].record
    np.testing.assert_array_equal(record.column("wrench_meas.fz"), TABLE["wrench_meas.fz"])


def test_raw_counts_of_an_unknown_scaling_are_refused(tmp_path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    path = tmp_path / "run.tdms"
    scaled = {"NI_Number_Of_Scales": 1, "NI_Scale[0]_Scale_Type": "Linear",
              "NI_Scale[0]_Linear_Slope": 2.0, "NI_Scale[0]_Linear_Y_Intercept": 1.0}  # fmt: skip
    for kind, status in (("Linear", "unscaled"), ("Odd", "scaled"), ("Odd", "unscaled")):
        about = scaled | {"NI_Scale[0]_Scale_Type": kind, "NI_Scaling_Status": status}
        with nptdms.TdmsWriter(path) as writer:
            writer.write_segment([nptdms.ChannelObject("log", "fz", np.arange(3.0), about)])
        if (kind, status) == ("Odd", "unscaled"):
            with pytest.raises(InputError, match="fz is scaled by Odd, which cannot"):
                read_columns(path, frozenset(["fz"]))
        else:
            values = [1.0, 3.0, 5.0] if kind == "Linear" else [0.0, 1.0, 2.0]
            assert list(read_columns(path, frozenset(["fz"])).data["fz"]) == values
