"""Columns of one data file, unchanged: names, values, and the clock of each column that has its
own.

A reader (:class:`hiltestbed.measured.data_format.DataFormat`) loads only the columns that are
wanted and lists the names of the others.
"""

from __future__ import annotations

import difflib
import re
import struct
from collections.abc import Iterable, Iterator, Sequence, Set
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import date
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hiltestbed.errors import Fault, InputError
from hiltestbed.measured.units import UNITS, split_unit
from hiltestbed.signals import GROUPS

if TYPE_CHECKING:
    from hiltestbed.frames import Array

# Errors that third-party parsers raise, besides their own, if the bytes contradict the header.
BROKEN = (
    OSError,
    EOFError,
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    NameError,
    RuntimeError,
    OverflowError,
    struct.error,
)
SAMPLE_LIMIT = 32_000_000  # numbers that may be loaded from one file: 256 MB
STAMP = re.compile(
    r"(?:(\d{1,4})[-./](\d{1,2})[-./](\d{1,4})[T ]+)?"
    r"(\d{1,2}):(\d{2})(?::(\d{2}(?:[.,]\d+)?))?\s*([AaPp][Mm])?\s*(?:Z|UTC|[+-]\d{2}:?\d{2})?"
)


@dataclass
class Columns:
    """Result of a reader.

    Attributes:
        names: every column in the file, read or not.
        data: name to ``(rows,)`` of the wanted columns that exist; without rows if the file has the
            name and no samples.
        clock: name to ``(rows,)`` [s] for columns that carry their own time stamps (MDF4, TDMS,
            MCAP); others share a time column.
        units: name to the unit that the file itself states, as it is written there.
        missing: name to the values that stand for a missing sample, by the file itself.
        others: name of what the file holds but is no column to what it is and what to do.
        notes: how the file was read, where that is not obvious.
        topics: those of a bag, of which each column is a field, with the type of its messages.
    """

    names: tuple[str, ...]
    data: dict[str, Array]
    clock: dict[str, Array] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    missing: dict[str, tuple[float, ...]] = field(default_factory=dict)
    others: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    topics: dict[str, str] = field(default_factory=dict)

    def nearest(self, wanted: Sequence[str]) -> str:
        """What the file has in place of the ``wanted`` columns, for an error message: the topics,
        if one is of none of them; else the nearest columns, of the same topic.
        """
        if not self.topics:
            return near(wanted, self.names)
        dotted = [column_of(name) for name in wanted]
        own = {t for t in self.topics if any(is_under(name, t) for name in dotted)}
        if not all(any(is_under(name, t) for t in own) for name in dotted):
            listed = (f"/{t.replace('.', '/')} ({kind})" for t, kind in sorted(self.topics.items()))
            return f"the topics are {', '.join(listed)}"
        return near(dotted, [n for n in self.names if any(is_under(n, t) for t in own)])

    def refuse_others(self, path: Path, wanted: Iterable[str]) -> None:
        """Raises InputError, a fault for each thing in the file that has the name of a ``wanted``
        column, or of what it is a part of, and is no column.
        """
        names = [column_of(name) if self.topics else name for name in wanted]
        found = [
            Fault(str(path), None, None, other, what)
            for other, what in self.others.items()
            if any(is_under(name, other) for name in names)
            and not any(is_under(column, other) for column in self.data)
        ]
        if found:
            raise InputError(found)


def column_of(text: str) -> str:
    """The name of a topic's field, where ``text`` separates topic and fields by dots or strokes:
    ``/ft/wrench/force/z`` is ``ft.wrench.force.z``.
    """
    return text.strip("/").replace("/", ".")


def unreadable(path: Path, what: str, do: str) -> InputError:
    """The error for a file that cannot be read: what is wrong with it and what to do."""
    return InputError(Fault(str(path), None, None, "", f"{what}; {do}"))


@contextmanager
def whole(path: Path, kind: str, do: str, *own: type[Exception]) -> Iterator[None]:
    """Refuse a file that its parser cannot read, with an error of its ``own`` or of BROKEN."""
    try:
        yield
    except (*own, *BROKEN) as error:
        raise unreadable(path, f"is not a whole {kind} file ({error})", do) from error


def refuse_large(path: Path, rows: int, columns: int) -> None:
    """Raises InputError, before data are read, beyond SAMPLE_LIMIT numbers."""
    if rows * columns > SAMPLE_LIMIT:
        what = (
            f"is too large (got about {rows:.3g} rows of {columns} channels); allowed "
            f"are {SAMPLE_LIMIT:.3g} numbers a run"
        )
        do = "cut the file to the run, thin it out, or store only the channels that are mapped"
        raise unreadable(path, what, do)


def as_numbers(path: Path, name: str, values: object) -> Array:
    """``values`` as float64 ``(rows,)``; dates, times and durations in seconds, see
    :func:`seconds`. Raises InputError if they are not real numbers.
    """
    array = np.asarray(values)
    if array.dtype.kind == "m":
        return array / np.timedelta64(1, "ns") * 1e-9
    if array.dtype.kind in "MSUO":
        found = seconds(array)
        array = array if found is None else found
    if array.dtype.kind not in "biuf":
        kind = "complex numbers" if array.dtype.kind == "c" else f"values of type {array.dtype}"
        what = f"is not numeric (got {kind}); allowed are real numbers"
        raise InputError(Fault(str(path), None, None, name, what))
    return np.ascontiguousarray(array, dtype=np.float64)


def seconds(values: np.ndarray) -> Array | None:
    """``(rows,)`` dates with times, or times of day, as seconds since the midnight before the first
    of them; NaN where empty, None if one is neither.

    Dates are read as year-month-day, or as day-month-year unless no month is that long. All rows
    are taken as of one zone.
    """
    if values.dtype.kind == "M":
        known = values[~np.isnat(values)]
        if not len(known):
            return np.full(len(values), np.nan)
        elapsed = (values - known[0].astype("datetime64[D]")) / np.timedelta64(1, "ns") * 1e-9
        return np.where(np.isnat(values), np.nan, elapsed)
    out, days, first = np.full(values.shape, np.nan), {}, None
    for row, value in enumerate(values.ravel()):
        text = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
        if text is None or text == "":
            continue
        found = STAMP.fullmatch(text.strip()) if isinstance(text, str) else None
        if found is None:
            return None
        *day, hour, minute, second, half = found.groups()
        key = tuple(day)
        if key not in days:
            number = _day_number(key)
            if number is None:
                return None
            days[key] = number
        first = days[key] if first is None else first
        hours = int(hour) % 12 + 12 * (half.lower() == "pm") if half else int(hour)
        of_minute = float((second or "0").replace(",", "."))
        out.flat[row] = (
            (days[key] - first) * UNITS["s"]["d"] + hours * 3600.0 + int(minute) * 60.0 + of_minute
        )
    return out if first is not None else None


def _day_number(day: tuple[str | None, ...]) -> int | None:
    """Number of a day; 0 without a date, None if there is no such day."""
    if day[0] is None or day[1] is None or day[2] is None:
        return 0
    a, b, c = (int(part or 0) for part in day)
    parts = (a, b, c) if len(day[0]) == 4 else (c, a, b) if b > 12 else (c, b, a)
    try:
        return date(*parts).toordinal()
    except ValueError:
        return None


def is_under(name: str, group: str) -> bool:
    """Whether a column is ``group`` itself or a part of it: ``pose_act.px`` of ``pose_act``."""
    return name == group or name.startswith(f"{group}.")


@dataclass
class Arrays:
    """Arrays that a file stores under one name each, as columns: collected by the readers of
    formats that have such arrays.

    The rows of an array lie along its longer axis: a record has more samples than channels. A
    vector (or an array with one axis longer than 1) keeps its name. An array with the name and the
    width of a group of the trace gets the names of the group's parts (``pose_act`` with 7 columns
    gives ``pose_act.px`` ...). Any other is numbered: ``name.0``, ``name.1`` ...

    Attributes:
        rows: the axis along which the format usually has its rows, of two.
        places: column to the array, or the file's handle of it, and its index in it.
        units, missing, others, notes: as in :class:`Columns`.
    """

    rows: int = 0
    places: dict[str, tuple[Any, tuple[Any, ...] | None]] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    missing: dict[str, tuple[float, ...]] = field(default_factory=dict)
    others: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def add(self, name: str, array: Any, unit: str = "", missing: tuple[float, ...] = ()) -> None:
        """The columns of ``array``, anything with a shape that can be indexed."""
        shape = tuple(array.shape)
        found = self._split(name, shape)
        self.places |= {column: (array, index) for column, index in found.items()}
        self.units |= {column: unit for column in found if unit}
        self.missing |= {column: missing for column in found if missing}

    def _split(self, name: str, shape: tuple[int, ...]) -> dict[str, tuple[Any, ...] | None]:
        if 0 in shape:
            return {name: None}
        long = [k for k, size in enumerate(shape) if size > 1] or [0]
        if len(long) == 1:
            return {name: tuple(slice(None) if k in long else 0 for k in range(len(shape)))}
        said = f"is an array of {' x '.join(map(str, shape))} numbers"
        if len(long) != 2:
            self.others[name] = (
                f"{said}; allowed are one axis of samples and one of "
                f"channels: store each channel under a name of its own"
            )
            return {}
        group, sizes = GROUPS.get(name), [shape[k] for k in long]
        usual = self.rows if sizes[0] == sizes[1] else int(sizes[1] > sizes[0])
        of_parts = [k for k, size in enumerate(sizes) if group and size == len(group.parts)]
        rows = 1 - of_parts[0] if len(of_parts) == 1 else usual
        width = sizes[1 - rows]
        columns = [f"{name}.{j}" for j in range(width)]
        if group is not None and width == len(group.parts):
            columns = list(group.columns)
        elif group is not None:
            self.others[name] = (
                f"{said}; the group has {len(group.parts)} parts "
                f"({', '.join(group.parts)}): map those that it holds, such as channels: "
                f"{{{group.columns[0]}: {{column: {columns[0]}}}}}"
            )
        if rows != self.rows:
            self.notes.append(
                f"{name} {said}: read as {width} channels of "
                f"{sizes[rows]} samples, the rows along the longer axis"
            )
        index: list[Any] = [0] * len(shape)
        index[long[rows]] = slice(None)
        out: dict[str, tuple[Any, ...] | None] = {}
        for j, column in enumerate(columns):
            index[long[1 - rows]] = j
            out[column] = tuple(index)
        return out

    def columns(self, path: Path, wanted: Set[str], more: Iterable[str] = ()) -> Columns:
        """The ``wanted`` columns, loaded; ``more``: names not added. Raises InputError."""
        here = {
            n: place for n, place in self.places.items() if n in wanted and place[1] is not None
        }
        refuse_large(path, max((max(a.shape) for a, _ in here.values()), default=0), len(here))
        data = {n: as_numbers(path, n, array[index]) for n, (array, index) in here.items()}
        for name, (_, index) in self.places.items():
            if index is None:  # no samples: each part has none
                data |= {w: np.zeros(0) for w in sorted(wanted) if is_under(w, name)}
        notes = tuple(n for n in self.notes if any(is_under(w, n.split(" ")[0]) for w in wanted))
        names = (*self.places, *more)
        return Columns(names, data, {}, self.units, self.missing, self.others, notes)


def match_names(path: Path, names: Sequence[str], wanted: Set[str]) -> dict[str, int]:
    """Wanted name to the number of its column in a table: by its name, without blanks around it, or
    without the unit that the name ends with (``pose_act.pz [mm]``). Raises InputError if there are
    several.
    """
    bare: dict[str, list[int]] = {}
    exact: dict[str, list[int]] = {}
    for index, name in enumerate(names):
        exact.setdefault(name.strip(), []).append(index)
        bare.setdefault(split_unit(name)[0], []).append(index)
    found = {name: exact.get(name) or bare.get(name, []) for name in sorted(wanted)}
    repeated = [name for name, places in found.items() if len(places) > 1]
    if repeated:
        what = f"has a column more than once (got {', '.join(repeated)})"
        raise unreadable(path, what, "rename or remove the second")
    return {name: places[0] for name, places in found.items() if places}


def near(wanted: Sequence[str], names: Iterable[str]) -> str:
    """The names most similar to the ``wanted`` ones, or the first few names, for a message."""
    known, each = list(names), 3 if len(wanted) == 1 else 1
    close = [difflib.get_close_matches(name, known, n=each, cutoff=0.5) for name in wanted]
    if any(close):
        return "nearest: " + ", ".join(dict.fromkeys(chain.from_iterable(close)))
    shown = ", ".join(known[:12]) + (f" and {len(known) - 12} more" if len(known) > 12 else "")
    return "the file has: " + (shown or "no columns")
