"""A small valid file of each data format, to be mutated."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

Table = dict[str, np.ndarray]


def _csv(path: Path, table: Table) -> None:
    import pyarrow as pa
    import pyarrow.csv as pa_csv

    pa_csv.write_csv(pa.table(table), path)


def _parquet(path: Path, table: Table) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table(table), path)


def _hdf5(path: Path, table: Table) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        for name, values in table.items():
            file[name.replace(".", "/")] = values


def _mat(path: Path, table: Table) -> None:
    import scipy.io

    nested: dict = {}
    for name, values in table.items():
        group, _, part = name.rpartition(".")
        (nested.setdefault(group, {}) if group else nested)[part] = values[:, None]
    scipy.io.savemat(path, nested)


def _mdf(path: Path, table: Table) -> None:
    import asammdf

    with asammdf.MDF(version="4.10") as mdf:
        mdf.append(
            [
                asammdf.Signal(values, table["t"], name=name)
                for name, values in table.items()
                if name != "t"
            ]
        )
        mdf.save(path)


def _tdms(path: Path, table: Table) -> None:
    import nptdms

    properties = {"wf_increment": 1e-3, "wf_start_offset": 0.0, "wf_samples": len(table["t"])}
    with nptdms.TdmsWriter(path) as writer:
        parts = [
            (*name.rpartition(".")[::2], values) for name, values in table.items() if name != "t"
        ]
        writer.write_segment(
            [nptdms.ChannelObject(group, name, values, properties) for group, name, values in parts]
        )


def _mcap(path: Path, table: Table) -> None:
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel(topic="/pose_act", message_encoding="json", schema_id=0)
        for k, t in enumerate(table["t"]):
            stamp = 1_700_000_000_000_000_000 + round(float(t) * 1e9)
            data = json.dumps({"pz": float(table["pose_act.pz"][k])}).encode()
            writer.add_message(channel, log_time=stamp, data=data, publish_time=stamp)
        writer.finish()


WRITERS: dict[str, Callable[[Path, Table], None]] = {
    "csv": _csv,
    "parquet": _parquet,
    "h5": _hdf5,
    "mat": _mat,
    "mf4": _mdf,
    "tdms": _tdms,
    "mcap": _mcap,
}
