"""From a dataset file to records on the loop's ticks, checked, each with the scenario of its run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hiltestbed.dataset import Channel, Dataset
from hiltestbed.dataset import load_dataset as load_specification
from hiltestbed.errors import Fault, HiltestbedError, InputError
from hiltestbed.frames import Array
from hiltestbed.measured.checks import Survey, check_channels, survey
from hiltestbed.measured.clock import Clock, check_clock, start_of_run, to_ticks
from hiltestbed.measured.columns import Columns, near
from hiltestbed.measured.formats import read_columns
from hiltestbed.measured.record import MEASURED_GROUPS, Record, place
from hiltestbed.measured.remark import Remark
from hiltestbed.measured.units import factor
from hiltestbed.scenario import Scenario
from hiltestbed.signals import GROUPS

MISSING_LIMIT = 0.5  # part of its samples that a channel may miss before it is left out
LINKS = {
    "platform": ("pose_cmd", "pose_act"),
    "contact": ("pose_act", "wrench_meas"),
    "compensation": ("wrench_meas", "wrench_comp"),
    "dynamics": ("wrench_comp", "pose_cmd"),
}


@dataclass(frozen=True)
class MeasuredRun:
    """One run: its record on the ticks, the scenario that the facility believes it was, and what the check found in it."""

    record: Record
    scenario: Scenario
    survey: Survey


@dataclass(frozen=True)
class MeasuredDataset:
    """Checked measured data.

    Attributes:
        path: of the dataset file; spec: its content; nominal: its scenario, without any run's differences.
        runs: in the order of the file.
        remarks: losses and notes of all runs (and errors, when it comes from :func:`examine`).
    """

    path: Path
    spec: Dataset
    nominal: Scenario
    runs: tuple[MeasuredRun, ...]
    remarks: tuple[Remark, ...]

    def links(self) -> tuple[str, ...]:
        """The links of the loop whose two ends were measured in at least one run (contact: with the sensor)."""
        return tuple(link for link, ends in LINKS.items() if any(all(run.record.has(end) for end in ends) for run in self.runs))


def load_dataset(path: str | Path, set: Mapping[str, Any] | None = None) -> MeasuredDataset:
    """The measured runs of a dataset file, on the loop's ticks and checked; ``set`` overrides keys of the file.

    Raises InputError with every fault when a file cannot be read or a finding of the check forbids a diagnosis (wrong unit, sign,
    quaternion order ...); MissingExtra when a format's reader is not installed.
    """
    dataset = examine(path, set)
    errors = [remark for remark in dataset.remarks if remark.severity == "error"]
    if errors:
        raise InputError([_as_fault(remark, dataset.path, dataset.spec) for remark in errors])
    return dataset


def examine(path: str | Path, set: Mapping[str, Any] | None = None) -> MeasuredDataset:
    """Like :func:`load_dataset`, but findings that forbid a diagnosis stand in ``remarks``, and runs that hold no record are left out.

    Raises InputError when the dataset file has a fault or a data file cannot be read.
    """
    loaded = load_specification(path, set)
    runs, remarks, faults = [], [], []
    for index, (file, scenario) in enumerate(zip(loaded.files, loaded.scenarios, strict=True)):
        channels = dict(loaded.spec.channels or {}) | loaded.spec.runs[index].channels
        try:
            record, found = read_record(index, file, channels, scenario)
        except InputError as error:
            faults += error.faults
            continue
        remarks += found
        if record is not None:
            result, more = survey(record, scenario)
            runs.append(MeasuredRun(record, scenario, result))
            remarks += more
    if faults:
        raise InputError(faults)
    remarks += check_channels([run.record for run in runs], LINKS)
    return MeasuredDataset(loaded.path, loaded.spec, loaded.nominal, tuple(runs), tuple(remarks))


def _as_fault(remark: Remark, path: Path, spec: Dataset) -> Fault:
    file = path if remark.run is None else path.parent / spec.runs[remark.run].file
    return Fault(str(file), None, None, remark.channel, remark.text + (f"; {remark.fix}" if remark.fix else ""))


def read_record(run: int, file: Path, channels: Mapping[str, Channel], scenario: Scenario) -> tuple[Record | None, list[Remark]]:
    """One file on the loop's ticks; None when its clock cannot be used (the remarks say why). Raises InputError, MissingExtra."""
    wanted = {name: _source(name, channels) for name in ("t", *(c for g in MEASURED_GROUPS for c in GROUPS[g].columns))}
    try:
        columns = read_columns(file, frozenset(wanted.values()))
    except MemoryError as error:
        raise InputError(Fault(str(file), None, None, "", "does not fit into memory; cut the file to the run")) from error
    _refuse_missing(file, columns, channels, wanted)
    values = {name: _scaled(columns.data[source], name, channels) for name, source in wanted.items() if source in columns.data}
    stamps = _stamps(file, columns, values, wanted, channels)
    clocks, remarks = _clocks(run, stamps, scenario)
    if clocks is None:
        return None, remarks
    del values["t"]
    ticks = round(max(clock.t[-1] for clock in clocks.values()) * scenario.rate) + 1
    data, valid, lost = {}, {}, []
    for name, column in values.items():
        clock = clocks[id(stamps[name])]
        missing = _missing(run, name, column[clock.rows], clock)
        remarks += missing
        if any("left out" in remark.text for remark in missing):
            lost.append(name)
            continue
        group, part = place(name)
        shape = (ticks, len(GROUPS[group].parts))
        samples = to_ticks(clock.t, column[clock.rows], ticks, scenario.tick, clock.interval)
        data.setdefault(group, np.full(shape, np.nan))[:, part] = samples[0]
        valid.setdefault(group, np.zeros(shape, dtype=bool))[:, part] = samples[1]
    if not data:
        text = "holds none of the channels " + ", ".join(f"{group}.*" for group in MEASURED_GROUPS) + f" ({near('pose_act', columns.names)})"
        remarks.append(Remark("error", run, "", text, "name the columns under channels:"))
        return None, remarks
    absent = tuple(c for g in MEASURED_GROUPS for c in GROUPS[g].columns if c not in values or c in lost)
    rate = 1 / min(clock.interval for clock in clocks.values())
    return Record(run, file, np.arange(ticks) / scenario.rate, data, valid, {}, absent, rate), remarks
