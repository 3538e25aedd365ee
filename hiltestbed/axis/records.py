"""The signals of one file of measured data of an axis, in SI units at common times."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hiltestbed.config.dataset import Channel
from hiltestbed.errors import Fault, InputError
from hiltestbed.frames import Array
from hiltestbed.measured.columns import Columns
from hiltestbed.measured.formats import AnyFormat, read_columns
from hiltestbed.measured.units import UNITS, split_unit, unit_named
from hiltestbed.measured.values import declared

LEAST_ROWS = 60  # of a run: three times the parameters of the largest hypothesis
ANGLE = {"rad": 1.0, "deg": math.pi / 180.0, "rev": 2.0 * math.pi}
CURRENT = {"A": 1.0, "mA": 1e-3}


class Signal(NamedTuple):
    """What is read of a file: its name, its SI unit, and whether a value stands until the next."""

    name: str
    unit: str
    held: bool = False


class RecordFormat(NamedTuple):
    """How a file is read: the mapping of its columns by signal, its format, and the sample rate
    [Hz] where it has no times.
    """

    channels: Mapping[str, Channel]
    format: AnyFormat | None = None
    rate: float | None = None


def read_record(
    path: Path, signals: Sequence[Signal], how: RecordFormat
) -> tuple[Array, list[Array], list[str]]:
    """Times [s] from 0 (N,) of the last of ``signals``, each signal (N,) at them, and remarks.

    Raises:
        InputError: the file cannot be read, or lacks a signal.
    """
    channels = how.channels
    names = {
        s: (channels[s].column if s in channels else None) or s
        for s in ("t", *(s.name for s in signals))
    }
    columns = read_columns(path, frozenset(names.values()), how.format)
    columns.refuse_others(path, names.values())
    missing = [s.name for s in signals if names[s.name] not in columns.data]
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
    values = [
        _in_si(path, s, columns, names[s.name], channels.get(s.name, Channel())) for s in signals
    ]
    last = names[signals[-1].name]
    t = _times(
        path, columns, (names["t"], last), channels.get("t", Channel()), how.rate, len(values[-1])
    )
    if names["t"] not in columns.data:
        values = [
            at_times(path, s, columns.clock.get(names[s.name]), t, v)
            for s, v in zip(signals, values, strict=True)
        ]
    count = min(len(t), *map(len, values))
    rows = np.column_stack([t[:count], *(v[:count] for v in values)])
    good = np.isfinite(rows).all(axis=1)
    remarks = [f"{path.name}: {note}" for note in columns.notes]
    if not good.all():
        remarks.append(f"{path.name}: {int((~good).sum())} of {count} rows lack a sample")
    rows = rows[good]
    back = np.flatnonzero(np.diff(rows[:, 0]) < 0.0)
    if len(back):
        raise _unusable(
            path,
            "t",
            f"runs backwards at {len(back)} place(s), first after row {back[0]}",
            "allowed are rows in order of time; split the file where a second record begins",
        )
    new = np.r_[True, np.diff(rows[:, 0]) > 0.0]
    if not new.all():
        remarks.append(f"{path.name}: {int((~new).sum())} rows repeat a stamp and are left out")
    rows = rows[new]
    if len(rows) < LEAST_ROWS:
        raise _unusable(
            path,
            "",
            f"holds {len(rows)} usable rows; a run needs at least {LEAST_ROWS}",
            "record the run again or take it out of the dataset",
        )
    t, *values = map(np.ascontiguousarray, rows.T)
    return t - t[0], values, remarks


def _unusable(path: Path, key: str, what: str, do: str) -> InputError:
    return InputError(Fault(str(path), None, None, key, f"{what}; {do}"))


def _times(
    path: Path,
    columns: Columns,
    names: tuple[str, str],
    channel: Channel,
    rate: float | None,
    rows: int,
) -> Array:
    """The times of the rows [s]. names: of the columns of times and of a signal."""
    stamps, signal = names
    if stamps in columns.data:
        unit = channel.unit or columns.units.get(stamps) or split_unit(stamps)[1]
        factor = _factor(path, "t", unit, UNITS["s"]) if unit else 1.0
        return columns.data[stamps] * factor * channel.scale + channel.offset
    own = columns.clock.get(signal)
    if own is not None:
        return own
    if rate is not None:
        return np.arange(rows) / rate
    raise _unusable(
        path,
        "channels.t",
        f"names no column of the file (got {stamps!r}), and no rate is given; "
        f"{columns.nearest([stamps])}",
        "name the column of times there, or give the sample rate [Hz] as rate",
    )


def at_times(path: Path, signal: Signal, own: Array | None, t: Array, values: Array) -> Array:
    """A signal at the times ``t``, where it has times of its ``own``: interpolated, or as it stands
    until the next. NaN before the first.

    Raises InputError if its times run backwards.
    """
    if own is None or np.array_equal(own, t):
        return values
    if np.any(np.diff(own) < 0.0):
        raise _unusable(
            path,
            f"channels.{signal.name}",
            "has times of its own that run backwards",
            "allowed are messages in order of time; split the file where a second record begins",
        )
    if signal.held:
        return np.r_[np.nan, values][np.searchsorted(own, t, side="right")]
    return np.interp(t, own, values, left=np.nan, right=np.nan)


def _in_si(path: Path, signal: Signal, columns: Columns, name: str, channel: Channel) -> Array:
    """A signal in its SI unit, NaN where it is missing."""
    values = columns.data[name]
    marks = (*(channel.missing or ()), *columns.missing.get(name, ()))
    if marks:
        values = np.where(declared(values, marks), np.nan, values)
    unit = channel.unit or columns.units.get(name, "").strip() or split_unit(name)[1]
    known = {"rad": ANGLE, "N": UNITS["N"] | CURRENT, "N m": UNITS["N m"] | CURRENT}.get(
        signal.unit, UNITS.get(signal.unit, {})
    )
    factor = _factor(path, signal.name, unit, known) if unit else 1.0
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
