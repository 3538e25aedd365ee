"""The file that describes measured runs of one axis: a drive, a servo or a damper.

axis: drive
nominal: {mass: 95.1}
runs: [{file: trapezoid.csv}, {file: pulses.csv}]
channels: {t: {column: t}, input: {column: force}, output: {column: position, unit: mm}}
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from hiltestbed.axis.effects.base import AXIS_EFFECTS, AxisEffect, AxisKind
from hiltestbed.axis.models import AxisModel, AxisRun, model_of
from hiltestbed.config.dataset import Channel
from hiltestbed.config.validation import Strictly, validate
from hiltestbed.config.yaml_source import Source, read_source
from hiltestbed.errors import Fault, InputError
from hiltestbed.frames import Array
from hiltestbed.measured.columns import Columns
from hiltestbed.measured.formats import AnyFormat, data_file, no_file, read_columns
from hiltestbed.measured.units import UNITS, split_unit, unit_named
from hiltestbed.measured.values import declared
from hiltestbed.plugins import OneOf, depends
from hiltestbed.run_folder.folders import is_file

LEAST_ROWS = 60  # of a run: three times the parameters of the largest hypothesis
SIGNALS = ("input", "output")
ANGLE = {"rad": 1.0, "deg": math.pi / 180.0, "rev": 2.0 * math.pi}
CURRENT = {"A": 1.0, "mA": 1e-3}
# what each kind of axis relates, by the SI units of an axis that slides and of one that turns
QUANTITIES: dict[AxisKind, tuple[tuple[str, str], tuple[str, str]]] = {
    "drive": (("N", "N m"), ("m", "rad")),
    "servo": (("m", "rad"), ("m", "rad")),
    "damper": (("m", "rad"), ("N", "N m")),
}


class Nominal(Strictly):
    """What the owner believes of the axis; what is left out is none."""

    mass: Annotated[float, Field(gt=0.0)] | None = Field(
        default=None, description="of a drive: moved mass [kg], or inertia [kg m^2] where it turns"
    )
    gain: Annotated[float, Field(gt=0.0)] = Field(
        default=1.0, description="of a drive: force or torque per unit of its input, such as N/A"
    )
    viscous: Annotated[float, Field(ge=0.0)] = Field(
        default=0.0, description="of a drive: viscous friction [N s/m]"
    )
    coulomb: Annotated[float, Field(ge=0.0)] = Field(
        default=0.0, description="of a drive: dry friction [N]"
    )
    offset: float = Field(default=0.0, description="of a drive: constant force against it [N]")
    delay: Annotated[float, Field(ge=0.0)] = Field(
        default=0.0, description="of a servo: from command to position [s]"
    )
    bandwidth: Annotated[float, Field(gt=0.0)] | None = Field(
        default=None, description="of a servo: natural frequency [Hz]; left out: it follows"
    )
    damping_ratio: Annotated[float, Field(gt=0.0)] = Field(
        default=0.7, description="of a servo with a bandwidth"
    )
    stiffness: float = Field(default=0.0, description="of a damper [N/m]")
    damping: Annotated[float, Field(ge=0.0)] = Field(default=0.0, description="of a damper [N s/m]")
    preload: float = Field(default=0.0, description="of a damper: constant force [N]")


NUMBERS: dict[AxisKind, tuple[str, ...]] = {
    "drive": ("mass", "gain", "viscous", "coulomb", "offset"),
    "servo": ("delay", "bandwidth", "damping_ratio"),
    "damper": ("stiffness", "damping", "preload"),
}


class AxisRunEntry(Strictly):
    """One file of measured data."""

    file: Annotated[str, Field(min_length=1)] = Field(
        description="CSV, Parquet, HDF5, MAT, MDF4, TDMS or MCAP, or a folder of a ROS 2 bag with "
        "one MCAP file, relative to the folder of this file; ${NAME}: an environment variable"
    )
    format: AnyFormat | None = Field(
        default=None, description="format of this file, where it differs from the others"
    )
    channels: dict[Literal["t", "input", "output"], Channel] = Field(
        default={}, description="channels that are mapped differently in this file"
    )


class AxisDataset(Strictly):
    """Measured runs of one axis, and what its owner believes of it."""

    axis: Literal["drive", "servo", "damper"] = Field(
        description="drive: force or current to position; servo: command to position; damper: "
        "displacement to force"
    )
    name: str = Field(default="", description="Name of the axis")
    description: str = Field(default="", description="Where the data come from")
    rotates: bool = Field(
        default=False, description="whether it turns: positions in rad, forces as torques in N m"
    )
    nominal: Nominal = Field(default=Nominal(), description="what is believed of it")
    effects: Annotated[
        tuple[Annotated[AxisEffect, OneOf(AXIS_EFFECTS)], ...], Field(strict=False)
    ] = Field(default=(), description="departures from the nominal numbers that are known")
    runs: Annotated[tuple[AxisRunEntry, ...], Field(strict=False, min_length=1)] = Field(
        description="the measured runs, one file each"
    )
    channels: dict[Literal["t", "input", "output"], Channel] = Field(
        default={}, description="columns of time, input and output; left out: columns of that name"
    )
    rate: Annotated[float, Field(gt=0.0)] | None = Field(
        default=None, description="sample rate [Hz] of files without a column of times"
    )
    format: AnyFormat | None = Field(default=None, description="how the files are written")


@depends
def _rebuild() -> None:
    for model in (AxisRunEntry, AxisDataset):
        model.model_rebuild(force=True)


@dataclass(frozen=True)
class LoadedAxis:
    """A valid file with its records.

    Attributes:
        spec: what the file says. path: of the file. source: its tree. records: one of each run.
            remarks: on the data.
    """

    spec: AxisDataset
    path: Path
    source: Source
    records: tuple[AxisRun, ...]
    remarks: tuple[str, ...]

    @property
    def name(self) -> str:
        return self.spec.name or self.path.parent.resolve().name

    def units(self) -> tuple[str, str]:
        """The SI units of input and output."""
        a, b = QUANTITIES[self.spec.axis]
        return a[self.spec.rotates], b[self.spec.rotates]

    def model(self) -> AxisModel:
        """The nominal model of the records."""
        spec = self.spec
        return model_of(spec.axis, self.records, nominal_of(spec), spec.rotates, spec.effects)


def nominal_of(spec: AxisDataset) -> dict[str, float]:
    """The numbers that its owner believes, by name."""
    given = spec.nominal.model_dump()
    return {k: given[k] for k in NUMBERS[spec.axis] if given[k] is not None}


def is_axis(source: Source) -> bool:
    """Whether a file describes an axis."""
    return isinstance(source.data, dict) and "axis" in source.data


def load_axis(path: str | Path | Source, data: bool = True) -> LoadedAxis:
    """The runs of an axis in a YAML file. data: whether the records are read.

    Raises:
        InputError: with every fault of the file and of its data.
    """
    source = path if isinstance(path, Source) else read_source(path)
    spec = validate(AxisDataset, source)
    faults = list(_faults(spec, source))
    if faults:
        raise InputError(faults)
    if not data:
        return LoadedAxis(spec, Path(source.file), source, (), ())
    records, remarks = [], []
    for index, run in enumerate(spec.runs):
        try:
            record, found = _read(spec, run, source)
        except InputError as error:
            faults += error.faults or (source.fault(("runs", index), str(error)),)
            continue
        records.append(record)
        remarks += found
    if faults:
        raise InputError(faults)
    names = [r.name for r in records]
    if len(set(names)) < len(names):
        records = [r._replace(name=f"{i}: {r.name}") for i, r in enumerate(records)]
    return LoadedAxis(spec, Path(source.file), source, tuple(records), tuple(remarks))


def _faults(spec: AxisDataset, source: Source) -> Iterator[Fault]:
    allowed = NUMBERS[spec.axis]
    for key in spec.nominal.model_fields_set:
        if key not in allowed:
            yield source.fault(
                ("nominal", key),
                f"is no number of a {spec.axis}; allowed: {', '.join(allowed)}",
            )
    if spec.axis == "drive" and spec.nominal.mass is None:
        yield source.fault(
            ("nominal",), "lacks mass, the moved mass [kg] or inertia [kg m^2] that is believed"
        )
    for index, effect in enumerate(spec.effects):
        if spec.axis not in effect.axes:
            kinds = [k for k, e in AXIS_EFFECTS.items() if spec.axis in e.axes]
            yield source.fault(
                ("effects", index, "kind"),
                f"does not act on a {spec.axis} (got {effect.kind}); allowed: {', '.join(kinds)}",
            )
    for index, run in enumerate(spec.runs):
        where = data_file(source.folder / os.path.expandvars(run.file))
        if not is_file(where):
            yield source.fault(
                ("runs", index, "file"), f"names no file (got {run.file!r}); {no_file(where)}"
            )


def _read(spec: AxisDataset, run: AxisRunEntry, source: Source) -> tuple[AxisRun, list[str]]:
    path = data_file(source.folder / os.path.expandvars(run.file))
    channels = {**spec.channels, **run.channels}
    names = {s: (channels[s].column if s in channels else None) or s for s in ("t", *SIGNALS)}
    columns = read_columns(path, frozenset(names.values()), run.format or spec.format)
    columns.refuse_others(path, names.values())
    missing = [s for s in SIGNALS if names[s] not in columns.data]
    if missing:
        wanted = [names[s] for s in missing]
        raise InputError(
            Fault(
                str(path),
                None,
                None,
                ", ".join(f"channels.{s}" for s in missing),
                f"names no column of the file (got {', '.join(map(repr, wanted))}); "
                f"{columns.nearest(wanted)}",
            )
        )
    quantities = QUANTITIES[spec.axis]
    u, y = (
        _in_si(path, s, columns, names[s], channels.get(s, Channel()), q[spec.rotates])
        for s, q in zip(SIGNALS, quantities, strict=True)
    )
    t = _times(path, columns, names, channels.get("t", Channel()), spec.rate, len(y))
    u = _at_times(path, spec.axis, columns, names, t, u)
    count = min(len(t), len(u), len(y))
    good = np.isfinite(t[:count]) & np.isfinite(u[:count]) & np.isfinite(y[:count])
    remarks = [f"{path.name}: {note}" for note in columns.notes]
    if not good.all():
        remarks.append(f"{path.name}: {int((~good).sum())} of {count} rows lack a sample")
    t, u, y = t[:count][good], u[:count][good], y[:count][good]
    back = np.flatnonzero(np.diff(t) < 0.0)
    if len(back):
        raise _unusable(
            path,
            "t",
            f"runs backwards at {len(back)} place(s), first after row {back[0]}",
            "allowed are rows in order of time; split the file where a second record begins",
        )
    new = np.r_[True, np.diff(t) > 0.0]
    if not new.all():
        remarks.append(f"{path.name}: {int((~new).sum())} rows repeat a stamp and are left out")
    t, u, y = t[new], u[new], y[new]
    if len(t) < LEAST_ROWS:
        raise _unusable(
            path,
            "",
            f"holds {len(t)} usable rows; a run needs at least {LEAST_ROWS}",
            "record the run again or take it out of the dataset",
        )
    return AxisRun(path.name, t - t[0], u, y), remarks


def _unusable(path: Path, key: str, what: str, do: str) -> InputError:
    return InputError(Fault(str(path), None, None, key, f"{what}; {do}"))


def _times(
    path: Path,
    columns: Columns,
    names: Mapping[str, str],
    channel: Channel,
    rate: float | None,
    rows: int,
) -> Array:
    """The times of the rows [s]."""
    if names["t"] in columns.data:
        known = {**UNITS["s"]}
        unit = channel.unit or columns.units.get(names["t"]) or split_unit(names["t"])[1]
        factor = _factor(path, "t", unit, known) if unit else 1.0
        return columns.data[names["t"]] * factor * channel.scale + channel.offset
    own = columns.clock.get(names["output"])
    if own is not None:
        return own
    if rate is not None:
        return np.arange(rows) / rate
    raise _unusable(
        path,
        "channels.t",
        f"names no column of the file (got {names['t']!r}), and no rate is given; "
        f"{columns.nearest([names['t']])}",
        "name the column of times there, or give the sample rate [Hz] as rate",
    )


def _at_times(
    path: Path, axis: AxisKind, columns: Columns, names: Mapping[str, str], t: Array, u: Array
) -> Array:
    """The input ``u`` at the times ``t`` of the output, where it has other times of its own: a
    displacement is interpolated, a command stands until the next. NaN before the first.

    Raises InputError if its times run backwards.
    """
    if names["t"] in columns.data or names["input"] not in columns.clock:
        return u
    own = columns.clock[names["input"]]
    if np.array_equal(own, t):
        return u
    if np.any(np.diff(own) < 0.0):
        raise _unusable(
            path,
            "channels.input",
            "has times of its own that run backwards",
            "allowed are messages in order of time; split the file where a second record begins",
        )
    if axis == "damper":
        return np.interp(t, own, u, left=np.nan, right=np.nan)
    return np.r_[np.nan, u][np.searchsorted(own, t, side="right")]


def _in_si(
    path: Path, signal: str, columns: Columns, name: str, channel: Channel, si: str
) -> Array:
    """A signal in its SI unit, NaN where it is missing."""
    values = columns.data[name]
    marks = (*(channel.missing or ()), *columns.missing.get(name, ()))
    if marks:
        values = np.where(declared(values, marks), np.nan, values)
    unit = channel.unit or columns.units.get(name, "").strip() or split_unit(name)[1]
    known = {"rad": ANGLE, "N": UNITS["N"] | CURRENT, "N m": UNITS["N m"] | CURRENT}.get(
        si, UNITS.get(si, {})
    )
    factor = _factor(path, signal, unit, known) if unit else 1.0
    return values * factor * channel.scale + channel.offset


def _factor(path: Path, signal: str, unit: str, known: Mapping[str, float]) -> float:
    named = unit if unit in known else unit_named(unit)
    if named is None or named not in known:
        raise _unusable(
            path,
            f"channels.{signal}.unit",
            f"is no unit of it (got {unit!r}); allowed: {', '.join(known)}",
            "give any other by scale, and unit: '1' is not needed then",
        )
    return known[named]
