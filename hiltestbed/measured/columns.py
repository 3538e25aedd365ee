"""Columns of one data file, unchanged: names, values, and the clock of each column that has its
own.

A reader (:class:`hiltestbed.measured.data_format.DataFormat`) loads only the columns that are
wanted and lists the names of the others.
"""

from __future__ import annotations

import difflib
import struct
from collections.abc import Iterable, Sequence, Set
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hiltestbed.errors import Fault, InputError
from hiltestbed.measured.stamps import seconds
from hiltestbed.measured.units import split_unit
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


def refuse_large(path: Path, rows: int, columns: int) -> None:
    """Raises InputError if ``rows`` x ``columns`` exceeds SAMPLE_LIMIT; called before any data are
    read.
    """
    if rows * columns > SAMPLE_LIMIT:
        what = (
            f"is too large (got about {rows:.3g} rows of {columns} channels); allowed "
            f"are {SAMPLE_LIMIT:.3g} numbers a run"
        )
        raise unreadable(
            path,
            what,
            "cut the file to the run, thin it out, or store only the channels that are mapped",
        )


def as_numbers(path: Path, name: str, values: object) -> Array:
    """``values`` as float64 ``(rows,)``; dates, times and durations in seconds, see
    :func:`hiltestbed.measured.stamps.seconds`. Raises InputError if they are not real numbers.
    """
    array = np.asarray(values)
    if array.dtype.kind == "m":
        return array / np.timedelta64(1, "ns") * 1e-9
    if array.dtype.kind in "MSUO":
        found = seconds(array)
        array = array if found is None else found
    if array.dtype.kind not in "biuf":
        kind = "complex numbers" if array.dtype.kind == "c" else f"values of type {array.dtype}"
        raise InputError(
            Fault(
                str(path),
                None,
                None,
                name,
                f"is not numeric (got {kind}); allowed are real numbers",
            )
        )
    return np.ascontiguousarray(array, dtype=np.float64)


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
        said = " x ".join(map(str, shape))
        if len(long) != 2:
            self.others[name] = (
                f"is an array of {said} numbers; allowed are one axis of samples and one of "
                f"channels: store each channel under a name of its own"
            )
            return {}
        group = GROUPS.get(name)
        parts = () if group is None else group.parts
        sizes = [shape[k] for k in long]
        of_parts = [k for k, size in enumerate(sizes) if size == len(parts)]
        usual = self.rows if sizes[0] == sizes[1] else int(sizes[1] > sizes[0])
        rows = 1 - of_parts[0] if len(of_parts) == 1 else usual
        width = sizes[1 - rows]
        columns = [f"{name}.{j}" for j in range(width)]
        if group is not None and width == len(parts):
            columns = list(group.columns)
        elif group is not None:
            self.others[name] = (
                f"is an array of {said} numbers; the group has {len(parts)} parts "
                f"({', '.join(parts)}): map those that it holds, such as channels: "
                f"{{{group.columns[0]}: {{column: {columns[0]}}}}}"
            )
        if rows != self.rows:
            self.notes.append(
                f"{name} is an array of {said} numbers: read as {width} channels of "
                f"{sizes[rows]} samples, the rows along the longer axis"
            )
        return {
            column: tuple(
                slice(None) if k == long[rows] else j if k == long[1 - rows] else 0
                for k in range(len(shape))
            )
            for j, column in enumerate(columns)
        }

    def columns(self, path: Path, wanted: Set[str], more: Iterable[str] = ()) -> Columns:
        """The ``wanted`` columns, loaded; ``more``: names in the file that were not added. Raises
        InputError.
        """
        here = {
            name: place
            for name, place in self.places.items()
            if name in wanted or (place[1] is None and any(is_under(w, name) for w in wanted))
        }
        loaded = {name: place for name, place in here.items() if place[1] is not None}
        refuse_large(path, max((max(a.shape) for a, _ in loaded.values()), default=0), len(loaded))
        data = {name: as_numbers(path, name, array[index]) for name, (array, index) in here.items()
                if index is not None}  # fmt: skip
        for name in (n for n in here if n not in loaded):  # no samples: each part has none
            data |= {w: np.zeros(0) for w in sorted(wanted) if is_under(w, name)}
        notes = [n for n in self.notes if any(is_under(w, n.partition(" ")[0]) for w in wanted)]
        return Columns(
            (*self.places, *more),
            data,
            units=self.units,
            missing=self.missing,
            others=self.others,
            notes=tuple(notes),
        )


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
        raise unreadable(
            path,
            f"has a column more than once (got {', '.join(repeated)})",
            "rename or remove the second",
        )
    return {name: places[0] for name, places in found.items() if places}


def near(wanted: Sequence[str], names: Iterable[str]) -> str:
    """The names most similar to the ``wanted`` ones, or the first few names, for an error
    message.
    """
    known = list(names)
    each = 3 if len(wanted) == 1 else 1
    close = list(
        dict.fromkeys(
            match
            for name in wanted
            for match in difflib.get_close_matches(name, known, n=each, cutoff=0.5)
        )
    )
    if close:
        return "nearest: " + ", ".join(close)
    shown = ", ".join(known[:12]) + (f" and {len(known) - 12} more" if len(known) > 12 else "")
    return "the file has: " + (shown or "no columns")
