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
from hiltestbed.measured.units import UNITS, unit_named
from hiltestbed.measured.values import declared, stated_unit

LEAST_ROWS = 60  # of a run: three times the parameters of the largest hypothesis
# units that a signal may have beside those of its SI unit: of an input by a current
CURRENT = {"A": 1.0, "mA": 1e-3}
MORE_UNITS = {"rad": {"rev": 2.0 * math.pi}, "N": CURRENT, "N m": CURRENT}
IN_ORDER = "in order of time; split the file where a second record begins"


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
    mapped = {n: how.channels.get(n, Channel()) for n in ("t", *(s.name for s in signals))}
    names = {n: channel.column or n for n, channel in mapped.items()}
    columns = read_columns(path, frozenset(names.values()), how.format)
    columns.refuse_others(path, names.values())
    missing = [s.name for s in signals if names[s.name] not in columns.data]
    if missing:
        wanted = [names[s] for s in missing]
        key = ", ".join(f"channels.{s}" for s in missing)
        what = f"names no column of the file (got {', '.join(map(repr, wanted))})"
        raise _unusable(path, key, what, columns.nearest(wanted))
    values = [_in_si(path, s, columns, names[s.name], mapped[s.name]) for s in signals]
    if names["t"] in columns.data:
        t = _in_si(path, Signal("t", "s"), columns, names["t"], mapped["t"])
    else:
        t = columns.clock.get(names[signals[-1].name])
        if t is None and how.rate is None:
            raise _unusable(
                path,
                "channels.t",
                f"names no column of the file (got {names['t']!r}), and no rate is given; "
                f"{columns.nearest([names['t']])}",
                "name the column of times there, or give the sample rate [Hz] as rate",
            )
        t = np.arange(len(values[-1])) / (how.rate or 1.0) if t is None else t
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
    steps = np.diff(rows[:, 0])
    back = np.flatnonzero(steps < 0.0)
    if len(back):
        what = f"runs backwards at {len(back)} place(s), first after row {back[0]}"
        raise _unusable(path, "t", what, f"allowed are rows {IN_ORDER}")
    new = np.r_[True, steps > 0.0]
    if not new.all():
        remarks.append(f"{path.name}: {int((~new).sum())} rows repeat a stamp and are left out")
    rows = rows[new]
    if len(rows) < LEAST_ROWS:
        what = f"holds {len(rows)} usable rows; a run needs at least {LEAST_ROWS}"
        do = "record the run again or take it out of the dataset"
        raise _unusable(path, "", what, do)
    t, *values = map(np.ascontiguousarray, rows.T)
    return t - t[0], values, remarks


def _unusable(path: Path, key: str, what: str, do: str) -> InputError:
    return InputError(Fault(str(path), None, None, key, f"{what}; {do}"))


def at_times(path: Path, signal: Signal, own: Array | None, t: Array, values: Array) -> Array:
    """A signal at the times ``t``, where it has times of its ``own``: interpolated, or as it stands
    until the next. NaN before the first.

    Raises InputError if its times run backwards.
    """
    if own is None or np.array_equal(own, t):
        return values
    if np.any(np.diff(own) < 0.0):
        what = "has times of its own that run backwards"
        raise _unusable(path, f"channels.{signal.name}", what, f"allowed are messages {IN_ORDER}")
    if signal.held:
        return np.r_[np.nan, values][np.searchsorted(own, t, side="right")]
    return np.interp(t, own, values, left=np.nan, right=np.nan)


def _in_si(path: Path, signal: Signal, columns: Columns, name: str, channel: Channel) -> Array:
    """A signal in its SI unit, NaN where it is missing."""
    values = columns.data[name]
    marks = (*(channel.missing or ()), *columns.missing.get(name, ()))
    if marks:
        values = np.where(declared(values, marks), np.nan, values)
    known = UNITS.get(signal.unit, {}) | MORE_UNITS.get(signal.unit, {})
    unit = channel.unit or stated_unit(columns, name) or signal.unit
    named = unit if unit in known else unit_named(unit)
    if named not in known:
        what = f"is no unit of it (got {unit!r}); allowed: {', '.join(known)}"
        do = "give any other by scale, and unit: '1' is not needed then"
        raise _unusable(path, f"channels.{signal.name}.unit", what, do)
    return values * known[named] * channel.scale + channel.offset
