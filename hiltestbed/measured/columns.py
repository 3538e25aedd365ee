"""Columns of one data file, unchanged: names, values, and the clock of each column that has its
own.

A reader is a function ``read(path, wanted) -> Columns``; it loads only the columns in ``wanted``
and lists the names of the others.
"""

from __future__ import annotations

import difflib
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hiltestbed.errors import Fault, InputError
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
        data: name to ``(rows,)`` of the wanted columns that exist.
        clock: name to ``(rows,)`` [s] for columns that carry their own time stamps (MDF4, TDMS,
            MCAP); others share a time column.
    """

    names: tuple[str, ...]
    data: dict[str, Array]
    clock: dict[str, Array] = field(default_factory=dict)


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
    """``values`` as float64 ``(rows,)``. Raises InputError if they are not real numbers."""
    array = np.asarray(values)
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


def split_matrix(name: str, shape: tuple[int, ...]) -> list[tuple[str, tuple[int, ...]]]:
    """Names for the columns of an array that a file stores under one name, each with its index
    along the columns.

    A vector (or a matrix with one column or row) keeps its name. A matrix with the name and the
    width of a group of the trace gets the names of the group's parts (``pose_act`` with 7 columns
    gives ``pose_act.px`` ...). Any other is numbered: ``name.0``, ``name.1`` ...
    """
    if len(shape) == 1 or (len(shape) == 2 and 1 in shape):
        return [(name, ())]
    if len(shape) != 2:
        return []
    group = GROUPS.get(name)
    if group is not None and len(group.parts) == shape[1]:
        return [(column, (j,)) for j, column in enumerate(group.columns)]
    return [(f"{name}.{j}", (j,)) for j in range(shape[1])]


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
