"""A facility's log of a run, stamps and channels, and the files in which a set is delivered."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tests.equipment.independent_rig.links import Records

if TYPE_CHECKING:
    from tests.equipment.independent_rig.sets import HiddenSet

POSES, WRENCHES = ("pose_cmd", "pose_act"), ("wrench_meas", "wrench_comp")
PARTS = {
    "pose": ("px", "py", "pz", "qx", "qy", "qz", "qw"),
    "wrench": ("fx", "fy", "fz", "tx", "ty", "tz"),
}
STAMP_DIGITS = 5  # significant, at least, so that stamps of a text file increase


@dataclass(frozen=True)
class Log:
    """The log of a run, n rows.

    Attributes:
        t: (n,) stamps [s]. pose_cmd, pose_act: (n, 7). wrench_meas, wrench_comp: (n, 6).
        tick: [s], of the loop. sigma: (6,) standard deviation of the white noise stated by the
            facility [N, N m].
        run: its number in the set. digits: significant digits of a text file; None: a binary file.
    """

    t: np.ndarray
    pose_cmd: np.ndarray
    pose_act: np.ndarray
    wrench_meas: np.ndarray
    wrench_comp: np.ndarray
    tick: float
    sigma: np.ndarray
    run: int = 0
    digits: int | None = None

    def channels(self) -> dict[str, np.ndarray]:
        """The channels, by name."""
        return {name: getattr(self, name) for name in (*POSES, *WRENCHES)}

    def each(self, change) -> Log:
        """The log with every channel replaced by `change(rows)`; quaternions are normalised."""
        found = {name: change(rows) for name, rows in self.channels().items()}
        for name in POSES:
            found[name][:, 3:] /= np.linalg.norm(found[name][:, 3:], axis=1, keepdims=True)
        return replace(self, **found)


def log_of(records: Records, rate: float, sigma: np.ndarray, run: int) -> Log:
    """The log of a run's records, one row per tick."""
    t, tick = np.arange(len(records.pose_cmd)) / rate, 1.0 / rate
    channels = {name: getattr(records, name) for name in (*POSES, *WRENCHES)}
    return Log(t=t, tick=tick, sigma=sigma, run=run, **channels)


def write_set(folder: str | Path, hidden: HiddenSet) -> Path:
    """Write nominal.yaml, dataset.yaml and run_N.parquet (run_N.csv for a text log)."""
    from ruamel.yaml import YAML

    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    yaml = YAML(typ="safe")
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    entries = [
        {"file": _write_log(folder, log), "set": hidden.facility.runs[log.run]}
        for log in hidden.logs
    ]
    pages: dict[str, Any] = {"nominal.yaml": hidden.facility.scenario}
    pages["dataset.yaml"] = {"scenario": "nominal.yaml", "runs": entries}
    for name, content in pages.items():
        with (folder / name).open("w", encoding="utf-8") as file:
            yaml.dump(plain(content), file)
    return folder


def _write_log(folder: Path, log: Log) -> str:
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = {"t": log.t}
    for name, rows in log.channels().items():
        parts = PARTS[name.split("_")[0]]
        columns |= {f"{name}.{part}": rows[:, j].copy() for j, part in enumerate(parts)}
    if log.digits is None:
        pq.write_table(pa.table(columns), folder / f"run_{log.run}.parquet")
        return f"run_{log.run}.parquet"
    stamps, rest = f"%.{max(log.digits, STAMP_DIGITS)}g", f"%.{log.digits}g"
    np.savetxt(
        folder / f"run_{log.run}.csv",
        np.stack(list(columns.values()), axis=1),
        [stamps, *[rest] * (len(columns) - 1)],
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
