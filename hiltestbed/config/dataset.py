"""The schema of a set of measured runs: their files, the differences between them, the mapping of
columns to signals.

A dataset file names the facility's believed scenario and, for every run, the file and the keys that
differed. The data themselves are read in :mod:`hiltestbed.measured`.
"""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from hiltestbed.build import runnable_from
from hiltestbed.config.validation import Strictly, validate
from hiltestbed.config.yaml_source import KeyPath, Source, read_source, referenced_source
from hiltestbed.errors import Fault, InputError
from hiltestbed.measured.formats import AnyFormat, data_file, no_file
from hiltestbed.measured.roles import channel_of, role_of
from hiltestbed.plugins import depends
from hiltestbed.run_folder.folders import is_file
from hiltestbed.scenario import Scenario

MISSPELT = 0.8  # likeness of two names, above which one is taken for a misspelling of the other
Check = Literal["unit", "sign", "axes", "start", "attitude", "lever", "copy", "constant", "shift"]


class Channel(Strictly):
    """Mapping of a column of the file to a signal of the trace: SI value = scale x (unit in SI) x
    value in the file + offset.
    """

    column: Annotated[str, Field(min_length=1)] | None = Field(
        default=None, description="name in the file; left out: the trace's own name"
    )
    scale: float = Field(default=1.0, description="factor; -1 for a reversed sign")
    offset: float = Field(
        default=0.0, description="added last, in SI units; for t the shift of the clock [s]"
    )
    unit: str | None = Field(
        default=None,
        description="unit of the column, such as mm, kN, ms or deg/s; left out: that which the "
        "file states, or SI",
    )
    missing: Annotated[tuple[float, ...], Field(strict=False)] | None = Field(
        default=None,
        description="values in the file that stand for a missing sample, such as -9999; [] for "
        "none; left out: isolated values far from all others are recognised",
    )


class RunFile(Strictly):
    """One file of measured data."""

    file: Annotated[str, Field(min_length=1)] = Field(
        description="CSV, Parquet, HDF5, MAT, MDF4, TDMS or MCAP, or a folder of a ROS 2 bag with "
        "one MCAP file, relative to the folder of this file; ${NAME}: an environment variable"
    )
    format: AnyFormat | None = Field(
        default=None, description="format of this file, where it differs from the others"
    )
    channels: dict[str, Channel] = Field(
        default={},
        description="channels that are mapped differently in this file than in the others",
    )

    def path(self, source: Source) -> Path:
        """Where the file is."""
        return data_file(source.folder / os.path.expandvars(self.file))


class RunEntry(RunFile):
    """One file of measured data, and what was different in this run."""

    set: dict[str, Any] = Field(
        default={}, description="settings of this run that differ: dotted scenario key to value"
    )


class Dataset(Strictly):
    """Measured runs of one rig."""

    name: str = Field(default="", description="Name of the data")
    description: str = Field(
        default="", description="Where the data come from, in a sentence or two"
    )
    scenario: Annotated[str, Field(min_length=1)] = Field(
        description="file of the facility's scenario, relative to the dataset's folder, or a "
        "shipped name"
    )
    runs: Annotated[tuple[RunEntry, ...], Field(strict=False, min_length=1)] = Field(
        description="the measured runs, one file each"
    )
    channels: dict[str, Channel] | None = Field(
        default=None,
        description="signal of the trace to its column; a signal left out is expected with the "
        "trace's name and unit",
    )
    format: AnyFormat | None = Field(
        default=None,
        description="how the files are written; left out: by their suffix, and text is recognised",
    )
    missing: Annotated[tuple[float, ...], Field(strict=False)] = Field(
        default=(),
        description="values in all channels that stand for a missing sample, such as -9999",
    )
    accept: Annotated[tuple[Check, ...], Field(strict=False)] = Field(
        default=(),
        description="checks whose errors are overridden, so that the data are used unchanged; a "
        "list of the words in the error messages: unit, sign, axes (exchanged), start (position "
        "and speed at the start), attitude, lever (torque over force), copy (of another channel), "
        "constant (where it should move), shift (by whole rows)",
    )


@depends
def _rebuild() -> None:
    """Include the formats of a plugin in the schema."""
    for model in (RunFile, RunEntry, Dataset):
        model.model_rebuild(force=True)


@dataclass(frozen=True)
class LoadedDataset:
    """A dataset whose scenario and overrides are valid.

    nominal is the scenario in the file; scenarios and files have one entry per run, with that run's
    overrides applied.
    """

    spec: Dataset
    path: Path
    nominal: Scenario
    scenarios: tuple[Scenario, ...]
    files: tuple[Path, ...]


def label_of(path: Path) -> str:
    """What a dataset without a name is called: its file, or the folder of a `dataset.yaml`."""
    return path.stem if path.stem != "dataset" else path.resolve().parent.name


def load_dataset(path: str | Path, set: Mapping[str, Any] | None = None) -> LoadedDataset:
    """The dataset in a YAML file, keys overridden by `set`. Raises InputError with every fault."""
    return dataset_from(read_source(path).with_set(set))


def dataset_from(source: Source, on_record: bool = True) -> LoadedDataset:
    """The dataset in a source that has been read already; ``on_record``: its files must exist.
    Raises InputError with every fault.
    """
    spec = validate(Dataset, source)
    faults = [
        *(missing_files(spec.runs, source) if on_record else ()),
        *_channel_faults(spec, source),
    ]
    nominal_source = referenced_source(source)
    nominal = runnable_from(nominal_source)
    scenarios = []
    for index, run in enumerate(spec.runs):
        try:
            scenarios.append(runnable_from(nominal_source, run.set))
        except InputError as error:
            faults += [source.relocated(fault, ("runs", index, "set")) for fault in error.faults]
    if faults:
        raise InputError(faults)
    files = tuple(run.path(source) for run in spec.runs)
    return LoadedDataset(spec, Path(source.file), nominal, tuple(scenarios), files)


def missing_files(runs: Sequence[RunFile], source: Source) -> Iterator[Fault]:
    """A fault for each run without a file."""
    for index, run in enumerate(runs):
        where = run.path(source)
        if not is_file(where):
            what = f"names no file (got {run.file!r}); {no_file(where)}"
            yield source.fault(("runs", index, "file"), what)


def _channel_faults(spec: Dataset, source: Source) -> Iterator[Fault]:
    yield from _map_faults(spec.channels or {}, source, ("channels",))
    for index, run in enumerate(spec.runs):
        yield from _map_faults(run.channels, source, ("runs", index, "channels"))


def _map_faults(channels: Mapping[str, Channel], source: Source, where: KeyPath) -> Iterator[Fault]:
    from hiltestbed.measured.units import ANGLES, unit_fault
    from hiltestbed.signals import GROUPS

    known = {"t", "contact"} | {column for group in GROUPS.values() for column in group.columns}
    known |= {name for names in ANGLES.values() for name in names}
    allowed = f"allowed: t, contact and {', '.join(f'{group}.*' for group in GROUPS)}"
    unknown: dict[str, list[str]] = {}
    for name in channels:
        if name not in known:
            unknown.setdefault(name.rpartition(".")[0] or name, []).append(name)
    for names in unknown.values():
        guesses = dict.fromkeys(repr(guess) for n in names if (guess := _meant(n, known)))
        hint = f" (did you mean {', '.join(guesses)}?)" if guesses else ""
        several = f"s (got {', '.join(names)})" if len(names) > 1 else ""
        yield source.fault((*where, names[0]), f"unknown channel{several}{hint}; {allowed}")
    for name, channel in channels.items():
        if channel.scale == 0.0:
            what = "is out of range (got 0); allowed is any other number"
            yield source.fault((*where, name, "scale"), what)
        fault = unit_fault(name, channel.unit)
        if fault:
            yield source.fault((*where, name, "unit"), fault)


def _meant(name: str, known: Iterable[str]) -> str | None:
    """The channel that is meant: the nearest by its letters, or a measured one with this part."""
    close = difflib.get_close_matches(name, sorted(known), n=1, cutoff=MISSPELT)
    if close:
        return close[0]
    role = role_of(name)
    guess = channel_of(role, role.part)
    return guess if guess in known else None
