"""A public record of a real machine: its source, its frozen split, and an expert's model of it."""

from __future__ import annotations

import fnmatch
import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files as package_files
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hiltestbed.axis.dataset import AxisDataset, LoadedAxis
from hiltestbed.axis.models import AxisRun as AxisRecord
from hiltestbed.config.yaml_source import Source

Array = NDArray[np.float64]
Predictor = Callable[[AxisRecord], Array]


@dataclass(frozen=True)
class Device:
    """One axis of a machine that others have measured.

    `source` is a public repository (`github:owner/name`) with the paths of the files in it.
    `files` maps the path of each original file below the data folder to its SHA-256. `fit` and
    `left_out` are names of records and never change: what `expert` learns comes from the
    records of `fit` alone. `nominal` is what the owner believed before any record (`mass` and
    `gain` of a drive, `stiffness` and `damping` of a damper, empty for a servo that follows its
    command), `published` the parameters that the source states, in SI units.
    """

    name: str
    title: str
    source: str
    licence: str
    files: Mapping[str, str]
    kind: Literal["drive", "servo", "damper"]
    units: tuple[str, str]
    fit: tuple[str, ...]
    left_out: tuple[str, ...]
    records: Callable[[Path], list[AxisRecord]]
    expert: Callable[[Sequence[AxisRecord]], Predictor]
    nominal: Mapping[str, float] = field(default_factory=dict)
    published: Mapping[str, float] = field(default_factory=dict)

    def loaded(self, records: Sequence[AxisRecord]) -> LoadedAxis:
        """Some of its records as the file of an axis would give them."""
        spec = {
            "axis": self.kind,
            "name": self.name,
            "rotates": self.units[1] in ("rad", "N m"),
            "nominal": dict(self.nominal),
            "runs": [{"file": r.name} for r in records],
        }
        source = Source(self.name, spec)
        return LoadedAxis(
            AxisDataset.model_validate(spec), Path(self.name), source, tuple(records), ()
        )

    def absent(self, data: Path) -> list[str]:
        """Files that are not below `data`, or whose content is not the one that was described."""
        return [
            path
            for path, sha256 in self.files.items()
            if not (file := data / path).is_file()
            or hashlib.sha256(file.read_bytes()).hexdigest() != sha256
        ]


def files(pattern: str) -> dict[str, str]:
    """SHA-256 by path below the data folder of the original files that match.

    `SHA256SUMS` beside this module is in the format of `sha256sum -c`.
    """
    lines = (package_files("hiltestbed.bench.real") / "SHA256SUMS").read_text().splitlines()
    sums = {path: sha256 for sha256, path in (line.split("  ", 1) for line in lines)}
    return {path: sha256 for path, sha256 in sums.items() if fnmatch.fnmatch(path, pattern)}


def split(record: AxisRecord, *names: str) -> list[AxisRecord]:
    """The record cut into parts of equal numbers of rows, one a name; each starts at t = 0."""
    rows = np.array_split(np.arange(record.t.size), len(names))
    parts = zip(names, rows, strict=True)
    return [AxisRecord(n, record.t[i] - record.t[i[0]], record.u[i], record.y[i]) for n, i in parts]


def evenly(record: AxisRecord, period: float) -> AxisRecord:
    """The record on an even grid [s], linear between its rows."""
    t = np.arange(record.t[0], record.t[-1], period)
    return AxisRecord(
        record.name, t - t[0], np.interp(t, record.t, record.u), np.interp(t, record.t, record.y)
    )
