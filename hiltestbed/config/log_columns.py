"""A log as its columns: what each may be, and which of them move."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hiltestbed.errors import InputError
from hiltestbed.frames import Array
from hiltestbed.measured.columns import STAMP, Columns
from hiltestbed.measured.formats import data_file, no_file, read_columns
from hiltestbed.measured.roles import Role, by_values, finite, role_of

SHOWN = 12  # columns that a comment lists


class Log(NamedTuple):
    """A log: its file, the names of its columns, and of those that move the roles and values.

    Attributes:
        own: whether each column has times of its own. dates: whether it writes dates or times.
        bare: whether it numbers its columns in place of names. notes: how it was read.
    """

    path: Path
    names: tuple[str, ...]
    roles: dict[str, Role]
    data: Mapping[str, Array]
    own: bool
    dates: bool
    bare: bool
    notes: tuple[str, ...]


def read_log(path: Path) -> Log:
    """The columns of a log. Raises InputError if it cannot be read."""
    file = data_file(path)
    if not file.is_file():
        raise InputError(f"--from {path}: names no file; {no_file(file)}")
    known = read_columns(file, frozenset())
    names, bare = known.names, all(name.isdigit() for name in known.names)
    columns = _loaded(file, names)
    found = {n: role_of(n, columns.units.get(n, "")) for n in names if n in columns.data}
    spans = {n: finite(columns.data[n]) for n in found}
    moving = {n: r for n, r in found.items() if len(spans[n]) and float(np.ptp(spans[n])) > 0.0}
    # an attitude is whole or none: an angle belongs to it though it does not change
    turned = {(r.part[:1], r.commanded) for r in moving.values() if r.angular}
    roles = {
        n: role
        for n, role in found.items()
        if n in moving or (role.angular and (role.part[:1], role.commanded) in turned)
    }
    if not moving:
        raise InputError(
            f"{path}: holds no column of numbers that change (columns: {listed(names)}); allowed "
            "is a log of at least two rows of a motion; record the run again"
        )
    with file.open("rb") as opened:
        head = opened.read(4096).decode("utf-8", "replace")
    dates = bool(STAMP.search(head))
    roles = by_values({n: columns.data[n] for n in roles}) if bare else roles
    return Log(
        file,
        names,
        roles,
        columns.data,
        bool(columns.clock),
        dates,
        bare,
        known.notes if bare else (),
    )


def _loaded(file: Path, names: Sequence[str]) -> Columns:
    """All columns; one after the other, without those that are no numbers, if need be."""
    try:
        return read_columns(file, frozenset(names))
    except InputError:
        found = Columns(tuple(names), {})
        for name in names:
            try:
                one = read_columns(file, frozenset({name}))
            except InputError:
                continue
            found.data |= one.data
            found.clock |= one.clock
            found.units |= one.units
        return found


def listed(names: Sequence[str]) -> str:
    """The first names, and how many more there are."""
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return (", ".join(map(quoted, names[:SHOWN])) or "none") + more


def range_of(values: Array) -> str:
    """`from -0.1 to 0.2`."""
    return f"from {np.nanmin(values):.4g} to {np.nanmax(values):.4g}"


def quoted(text: str) -> str:
    """A YAML scalar, on one line in a comment, too."""
    return text if re.fullmatch(r"[A-Za-z][\w./]*", text) else json.dumps(text)
