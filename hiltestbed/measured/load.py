"""From a dataset file to records on the loop's ticks, checked, each with the scenario of its
run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hiltestbed.config.dataset import Dataset, LoadedDataset
from hiltestbed.config.dataset import load_dataset as load_specification
from hiltestbed.errors import Fault, InputError
from hiltestbed.measured.checks import check_dataset, check_run
from hiltestbed.measured.reading import read_record
from hiltestbed.measured.record import Record
from hiltestbed.measured.remark import Remark, error, together
from hiltestbed.measured.survey import Survey
from hiltestbed.scenario import Scenario

LINKS = {
    "platform": ("pose_cmd", "pose_act"),
    "contact": ("pose_act", "wrench_meas"),
    "compensation": ("wrench_meas", "wrench_comp"),
    "dynamics": ("wrench_comp", "pose_cmd"),
}
FEWEST = 30  # ticks of a run, at least, to estimate a noise floor


@dataclass(frozen=True)
class MeasuredRun:
    """One run: its record on the ticks, the facility's believed scenario of the run, the survey of
    its check, and its file name.
    """

    record: Record
    scenario: Scenario
    survey: Survey
    name: str = ""

    def touching(self, rows: int) -> np.ndarray:
        """(rows,) bool: in contact, or the delayed sensor still shows the contact."""
        return self.survey.touching(rows, round(self.scenario.sensor.delay * self.scenario.rate))


@dataclass(frozen=True)
class MeasuredDataset:
    """Checked measured data.

    Attributes:
        path: of the dataset file; spec: its content; nominal: its scenario, without the settings of
            single runs.
        files: the data file of each run.
        runs: in the order of the file.
        remarks: losses and notes of all runs (and errors, when it comes from :func:`examine`).
    """

    path: Path
    spec: Dataset
    nominal: Scenario
    files: tuple[Path, ...]
    runs: tuple[MeasuredRun, ...]
    remarks: tuple[Remark, ...]

    @property
    def names(self) -> list[str]:
        """Names of the runs in messages and figures."""
        return [run.name for run in self.runs]

    def links(self) -> tuple[str, ...]:
        """The links whose input and output were measured in at least one run."""
        records = [run.record for run in self.runs]
        ends = LINKS.items()
        return tuple(link for link, (a, b) in ends if any(r.has(a) and r.has(b) for r in records))


def load_dataset(
    path: str | Path | LoadedDataset, set: Mapping[str, Any] | None = None
) -> MeasuredDataset:
    """The measured runs of a dataset, or of a dataset file, on the loop's ticks and checked;
    ``set`` overrides keys of the file.

    Raises InputError with every fault if a file cannot be read or a finding of the check forbids a
    diagnosis (wrong unit, sign, quaternion order ...); MissingExtra if the reader of a format is
    not installed.
    """
    dataset = examine(path, set)
    faults = as_faults(dataset)
    if faults:
        raise InputError(faults)
    return dataset


def examine(
    path: str | Path | LoadedDataset, set: Mapping[str, Any] | None = None
) -> MeasuredDataset:
    """Like :func:`load_dataset`, but findings that forbid a diagnosis are in ``remarks``, and runs
    without a record are left out.

    Raises InputError if the dataset file has a fault or a data file cannot be read.
    """
    loaded = path if isinstance(path, LoadedDataset) else load_specification(path, set)
    spec, names = loaded.spec, _names(loaded.files)
    runs, remarks, faults = [], [], []
    for index, (file, scenario) in enumerate(zip(loaded.files, loaded.scenarios, strict=True)):
        own = spec.runs[index]
        channels, form = dict(spec.channels or {}) | own.channels, own.format or spec.format
        try:
            record, found = read_record(index, file, channels, scenario, form, spec.missing)
        except InputError as fault:
            faults += fault.faults
            continue
        remarks += found
        if record is not None and record.ticks >= FEWEST:
            record, survey, more = check_run(record, scenario)
            runs.append(MeasuredRun(record, scenario, survey, names[index]))
            remarks += more
        elif all(remark.severity != "error" for remark in found):
            text = "holds no channel with enough samples"
            if record is not None:
                text = f"lasts {record.ticks} ticks; a run needs at least {FEWEST}"
            fix = "record the run again or take it out of the dataset"
            remarks.append(error("", index, "", text, fix))
    if faults:
        raise InputError(faults)
    remarks += check_dataset([run.record for run in runs], names, LINKS)
    remarks = [r if r.run is None else replace(r, file=names[r.run]) for r in remarks]
    remarks = [
        r.accepted() if r.severity == "error" and r.check in spec.accept else r for r in remarks
    ]
    return MeasuredDataset(
        loaded.path, spec, loaded.nominal, loaded.files, tuple(runs), tuple(remarks)
    )


def _names(files: Sequence[Path]) -> list[str]:
    """Name of each run: its file name, with as many folders as make it unique."""
    parts, deep = [file.parts for file in files], 1
    while len({p[-deep:] for p in parts}) < len(set(parts)):
        deep += 1
    return ["/".join(p[-deep:]) for p in parts]


def as_faults(dataset: MeasuredDataset) -> list[Fault]:
    """The errors among the remarks, each with its file; channels that share one together."""
    errors = together(r for r in dataset.remarks if r.severity == "error")
    files = [str(dataset.path if r.run is None else dataset.files[r.run]) for r in errors]
    return [
        Fault(file, None, None, r.channel, r.text + (f"; {r.remedy}" if r.remedy else ""))
        for file, r in zip(files, errors, strict=True)
    ]
