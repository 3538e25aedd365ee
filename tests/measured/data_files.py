"""A record written in each of the data formats, with the units that the file can state."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

Table = dict[str, np.ndarray]  # t, pose_cmd.*, pose_act.*, wrench_meas.*, wrench_comp.*
Units = dict[str, str]
NONE: Units = {}


def _of(table: Table, *groups: str) -> Table:
    return {name: values for name, values in table.items() if name.startswith(groups)}


def _csv(path: Path, table: Table, units: Units = NONE) -> None:
    names = {name: f"{name} [{units[name]}]" if name in units else name for name in table}
    pa_csv.write_csv(pa.table({names[name]: values for name, values in table.items()}), path)


def _parquet(path: Path, table: Table, units: Units = NONE) -> None:
    fields = [pa.field(n, pa.float64(), metadata={"unit": units.get(n, "")}) for n in table]
    pq.write_table(pa.table(list(table.values()), schema=pa.schema(fields)), path)


def _hdf5(path: Path, table: Table, units: Units = NONE) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        file["t"] = table["t"]
        for group in ("pose_cmd", "pose_act"):
            file[group] = np.stack(list(_of(table, group).values()), axis=1)
        for name, values in _of(table, "wrench").items():
            file[name.replace(".", "/")] = values
            file[name.replace(".", "/")].attrs["units"] = np.bytes_(units.get(name, "").encode())


def _mat_5(path: Path, table: Table, units: Units = NONE) -> None:
    import scipy.io

    nested: dict = {"t": table["t"][:, None]}
    for name, values in _of(table, "pose", "wrench").items():
        group, part = name.split(".")
        nested.setdefault(group, {})[part] = values[:, None]
    scipy.io.savemat(path, nested)


def _mat_73(path: Path, table: Table, units: Units = NONE) -> None:
    """As MATLAB's -v7.3 writes it: 512 bytes of its own, column-major matrices, so (1, rows) and
    (parts, rows) in HDF5.
    """
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        file["t"] = table["t"][None, :]
        file["pose_act"] = np.stack(list(_of(table, "pose_act").values()))
        for name, values in _of(table, "wrench", "pose_cmd").items():
            file[name.replace(".", "/")] = values[None, :]
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")


def _mdf(path: Path, table: Table, units: Units = NONE) -> None:
    import asammdf

    with asammdf.MDF(version="4.10") as mdf:
        for group in ("pose", "wrench"):
            columns = _of(table, group).items()
            mdf.append(
                [asammdf.Signal(v, table["t"], name=n, unit=units.get(n, "")) for n, v in columns]
            )
        mdf.save(path)


def _tdms(path: Path, table: Table, units: Units = NONE) -> None:
    import nptdms

    wave = {
        "wf_increment": table["t"][1] - table["t"][0],
        "wf_start_offset": 0.0,
        "wf_samples": len(table["t"]),
    }
    channels = []
    for name, values in _of(table, "pose", "wrench").items():
        group, part = name.split(".")
        unit = {"unit_string": units[name]} if name in units else {}
        channels.append(nptdms.ChannelObject(group, part, values, wave | unit))
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment(channels)


def _mcap(path: Path, table: Table, units: Units = NONE) -> None:
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for group in ("pose_cmd", "pose_act", "wrench_meas", "wrench_comp"):
            topic = writer.register_channel(f"/{group}", message_encoding="json", schema_id=0)
            columns = _of(table, group).items()
            for k, t in enumerate(table["t"]):
                stamp = 1_700_000_000_000_000_000 + round(t * 1e9)
                message = {name.split(".")[1]: float(values[k]) for name, values in columns}
                writer.add_message(topic, stamp, json.dumps(message).encode(), stamp)
        writer.finish()


WRITERS = {
    "run.csv": _csv,
    "run.parquet": _parquet,
    "run.h5": _hdf5,
    "five.mat": _mat_5,
    "seven.mat": _mat_73,
    "run.mf4": _mdf,
    "run.tdms": _tdms,
    "run.mcap": _mcap,
}
