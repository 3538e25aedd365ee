"""From a dataset file to records on the loop's ticks, checked, each with the scenario of its run.
The check before a diagnosis gives every finding with its numbers and a proposed fix; here: what a
dataset lacks, and channels that are clipped at a limit or quantised.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hiltestbed.config.dataset import Dataset, LoadedDataset
from hiltestbed.config.dataset import load_dataset as load_specification
from hiltestbed.errors import Fault, InputError
from hiltestbed.frames import Array
from hiltestbed.measured.noise import FREE_MINIMUM
from hiltestbed.measured.plausible import contradictions
from hiltestbed.measured.reading import read_record
from hiltestbed.measured.record import Record, place, stretches
from hiltestbed.measured.remark import Remark, error, loss, note, together
from hiltestbed.measured.survey import Survey, baseline, extent, look, remarks_on
from hiltestbed.scenario import Scenario
from hiltestbed.signals import GROUPS

LINKS = {
    "platform": ("pose_cmd", "pose_act"),
    "contact": ("pose_act", "wrench_meas"),
    "compensation": ("wrench_meas", "wrench_comp"),
    "dynamics": ("wrench_comp", "pose_cmd"),
}
FLAT = 4  # successive equal samples at an extreme value, at least, for clipping to be considered
CORNER = 6.0  # quanta; the rounded top of a smooth signal gives 3, see `_is_corner`
# of the range: least distance of a limit from the free level, since a force of zero between
# contacts is no limit
AWAY = 0.2
# [m], [N], [N m]: below any sensor's resolution; a simulated channel that should be zero may
# contain it
ROUND_OFF = 1e-9
# samples per step over the range, above which a note is given: a CSV file with six digits has
# steps, too
STEPS = 4


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
        return [run.name for run in self.runs]


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
        if record is not None and record.ticks >= FREE_MINIMUM:
            survey, more = check_run(record, scenario)
            runs.append(MeasuredRun(record, scenario, survey, names[index]))
            remarks += more
        elif all(remark.severity != "error" for remark in found):
            text = "holds no channel with enough samples"
            if record is not None:
                text = f"lasts {record.ticks} ticks; a run needs at least {FREE_MINIMUM}"
            fix = "record the run again or take it out of the dataset"
            remarks.append(error("", index, "", text, fix))
    if faults:
        raise InputError(faults)
    remarks += check_dataset([run.record for run in runs], names)
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


def check_run(record: Record, scenario: Scenario) -> tuple[Survey, list[Remark]]:
    """The survey of a record, and all remarks on it."""
    found = look(record, scenario)
    remarks = [
        *clipped_samples(record, found),
        *contradictions(record, found, scenario),
        *quantisation(record),
    ]
    wrong = any(remark.severity == "error" for remark in remarks)
    remarks += [] if wrong else remarks_on(record, found, scenario)
    if record.ticks > scenario.ticks * 1.01 + 1:
        text = f"lasts {record.t[-1]:.6g} s, longer than the scenario's {scenario.duration:.6g} s"
        remarks.append(note(record.run, "t", text))
    return found, remarks


def check_dataset(records: Sequence[Record], names: Sequence[str]) -> list[Remark]:
    """Remarks on links without input or output and on missing axes; ``names``: of the runs."""
    remarks = []
    for group in dict.fromkeys(end for ends in LINKS.values() for end in ends):
        have = [record for record in records if record.has(group)]
        without = [record.run for record in records if not record.has(group)]
        cut = [link for link, ends in LINKS.items() if group in ends]
        if without:
            where = f"not in {', '.join(names[run] for run in without)}" if have else "in no run"
            text = (
                f"was measured {where}: the link{'s' if len(cut) > 1 else ''} "
                f"{' and '.join(cut)} cannot be judged there"
            )
            remarks.append(loss(None, group, text))
        columns = zip(GROUPS[group].columns, GROUPS[group].parts, strict=True)
        parts = [part for column, part in columns if any(column in r.absent for r in have)]
        if parts:
            text = f"lacks {', '.join(parts)} in some or all runs; they are taken as absent"
            remarks.append(loss(None, group, text))
    return remarks


def clipped_samples(record: Record, found: Survey) -> Iterator[Remark]:
    """A remark on each channel with samples at a limit."""
    for name in record.columns():
        group, part = place(name)
        if group != "pose_act" and not group.startswith("wrench"):
            continue
        values = record.column(name)
        mask = _at_limit(values, baseline(record, found, name), record.steps.get(name, 0.0))
        if group == "pose_act":
            mask &= _held_back(record, part, values)
        if mask.any():
            levels = ", ".join(f"{level:.6g}" for level in np.unique(values[mask]))
            text = (
                f"is at its limit ({levels}) in {int(mask.sum())} samples, which it reaches with a "
                f"corner: clipped; larger values are lost"
            )
            yield loss(record.run, name, text, "raise the range of the channel, or run slower")


def _at_limit(values: Array, level: float, quantum: float) -> NDArray[np.bool_]:
    """Samples in flat stretches at the highest or lowest value that begin with a corner."""
    mask = np.zeros(len(values), dtype=bool)
    span = extent(values)
    if span < ROUND_OFF:
        return mask
    for extreme in (np.nanmax(values), np.nanmin(values)):
        if abs(extreme - level) <= AWAY * span:
            continue
        for start, end in stretches(values == extreme):
            if end - start >= FLAT and _is_corner(values, start, end, quantum):
                mask[start:end] = True
    return mask


def _held_back(record: Record, part: int, values: Array) -> NDArray[np.bool_]:
    """Samples of a pose short of its command: one that rests at its command is at no limit."""
    if not record.has("pose_cmd") or part > 2:
        return np.zeros(len(values), dtype=bool)
    least = 0.05 * np.nanmax(values - np.nanmin(values))
    with np.errstate(invalid="ignore"):
        return np.abs(record.data["pose_cmd"][:, part] - values) > least


def _is_corner(values: Array, start: int, end: int, quantum: float) -> bool:
    """Whether the signal enters the flat stretch too steeply for a rounded top.

    A parabola a t^2/2 quantised in steps of q stays on the last step for T = sqrt(2 q/a) on either
    side of its top, and falls by a (2 T)^2/2 - q = 3 q during the next T, however wide the top. A
    clipped signal has no such bound.
    """
    half = max(2, (end - start) // 2)
    falls = [abs(values[start] - values[start - half])] if start >= half else []
    falls += [abs(values[end - 1] - values[end - 1 + half])] if end - 1 + half < len(values) else []
    falls = [fall for fall in falls if np.isfinite(fall)]
    return bool(falls) and min(falls) > CORNER * quantum


def quantisation(record: Record) -> Iterator[Remark]:
    """A note on each quantised channel."""
    for name, step in record.steps.items():
        values = record.column(name)
        if np.isfinite(values).sum() * step >= STEPS * np.ptp(values[record.measured(name)]):
            noise = step / np.sqrt(12)
            text = f"comes in steps of {step:.4g}: a noise of {noise:.3g} (1 sigma) at best"
            yield note(record.run, name, text)
