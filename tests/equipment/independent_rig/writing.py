"""Writes a set as a folder of files, as a facility would deliver it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tests.equipment.independent_rig.log import POSES, TWISTS, WRENCHES, Log
from tests.equipment.independent_rig.noise_kinds import STAMP_DIGITS

if TYPE_CHECKING:
    from tests.equipment.independent_rig.sets import HiddenSet

PARTS = {
    "pose": ("px", "py", "pz", "qx", "qy", "qz", "qw"),
    "wrench": ("fx", "fy", "fz", "tx", "ty", "tz"),
    "twist": ("vx", "vy", "vz", "wx", "wy", "wz"),
}


def write_set(folder: str | Path, hidden: HiddenSet, truth: bool = False) -> Path:
    """Write nominal.yaml, dataset.yaml and run_N.parquet (run_N.csv for a text log); with `truth`
    also truth.yaml.
    """
    from ruamel.yaml import YAML

    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    yaml = YAML(typ="safe")
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    entries = [
        {"file": _write_log(folder, log), "set": hidden.facility.runs[log.run]}
        for log in hidden.logs
    ]
    pages = {
        "nominal.yaml": hidden.facility.scenario,
        "dataset.yaml": {"scenario": "nominal.yaml", "runs": entries},
    }
    for name, content in (pages | ({"truth.yaml": hidden.truth} if truth else {})).items():
        with (folder / name).open("w", encoding="utf-8") as file:
            yaml.dump(plain(content), file)
    return folder


def columns_of(log: Log) -> dict[str, np.ndarray]:
    """The columns of a log by name, t first."""
    columns, channels = {"t": log.t}, log.channels()
    for name in (*POSES, *TWISTS, *WRENCHES):
        if name in channels:
            columns |= {
                f"{name}.{part}": channels[name][:, j].copy()
                for j, part in enumerate(PARTS[name.split("_")[0]])
            }
    return columns


def _write_log(folder: Path, log: Log) -> str:
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = columns_of(log)
    if log.digits is None:
        pq.write_table(pa.table(columns), folder / f"run_{log.run}.parquet")
        return f"run_{log.run}.parquet"
    with (folder / f"run_{log.run}.csv").open("w", encoding="utf-8") as file:
        formats = [
            f"%.{max(log.digits, STAMP_DIGITS)}g",
            *[f"%.{log.digits}g"] * (len(columns) - 1),
        ]
        np.savetxt(
            file,
            np.stack(list(columns.values()), axis=1),
            formats,
            ",",
            header=",".join(columns),
            comments="",
        )
    return f"run_{log.run}.csv"


def plain(value: Any) -> Any:
    """`value` without NumPy's types, which YAML cannot write."""
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    return value.item() if isinstance(value, np.generic) else value
