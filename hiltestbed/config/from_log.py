"""A dataset from a log: the columns that it may hold, as commented YAML with guesses to correct.

A docking dataset, with a scenario beside it, where the log holds a pose and a wrench; an arm where
it holds several joints; an axis (drive, servo or damper) otherwise.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hiltestbed.config.log_columns import Log, listed, quoted, read_log
from hiltestbed.config.log_guesses import (
    Entry,
    axes_of,
    axis_entries,
    docking_entries,
    ends_of_axis,
    start_of,
)
from hiltestbed.config.log_text import axis_text, dataset_text
from hiltestbed.config.template import free_file, template
from hiltestbed.errors import InputError
from hiltestbed.measured.roles import BARE

AXES = ("drive", "servo", "damper")
DATASET = "dataset"


@dataclass(frozen=True)
class FromLog:
    """What was written: the file and those beside it, its kind, its guesses, what is open, the
    columns that are not used, the other kinds of dataset that the log may be, and how it was read.
    """

    files: tuple[Path, ...]
    kind: str
    guesses: dict[str, str]
    open: tuple[str, ...]
    not_used: tuple[str, ...]
    others: tuple[str, ...]
    notes: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """As `--json` prints it."""
        return {
            "file": str(self.files[0]),
            "files": [str(file) for file in self.files],
            "kind": self.kind,
            "channels": self.guesses,
            "open": list(self.open),
            "not_used": list(self.not_used),
            "other_kinds": list(self.others),
            "notes": list(self.notes),
        }

    def lines(self) -> Iterator[str]:
        """For the terminal."""
        files = " and ".join(map(str, self.files))
        yield from (f"{note}; {BARE}" for note in self.notes)
        yield f"{files}: written; {self.kind}, with these guesses:"
        yield from (f"  {channel}: {column}" for channel, column in self.guesses.items())
        if self.open:
            yield f"  not found: {', '.join(self.open)}; the file lists the choices"
        if self.not_used:
            yield f"  not used: {listed(self.not_used)}"
        if self.others:
            yield f"it may also be read with --as {' or --as '.join(self.others)}"
        yield f"next: correct {files}, then hiltestbed check {self.files[0]}"


def write_from_log(name: str, logs: Sequence[Path], kind: str = "") -> FromLog:
    """Write NAME.yaml for logs of one kind, and NAME-scenario.yaml if they are of a docking rig.

    Args:
        logs: one a run; the columns are those of the first. kind: of dataset: `dataset`, or the
            kind of axis; "": the likeliest.

    Raises InputError if a log cannot be read or lacks a column, the first does not hold what the
    ``kind`` needs, or a file exists.
    """
    path = free_file(name)
    found = read_log(logs[0])
    likely, axes = [] if found.bare else docking_entries(found, False), axes_of(found)
    docking = likely or docking_entries(found, True)
    kinds = [DATASET, *axes] if likely else [*axes, *([DATASET] if docking else [])]
    if found.bare:
        kinds = list(dict.fromkeys([*axes, *AXES, DATASET]))
    if kind and kind not in kinds:
        raise InputError(
            f"--as {kind}: {logs[0]} has no columns for it; allowed here: {', '.join(kinds)}"
            if kinds
            else f"--as {kind}: no column of {logs[0]} could be guessed; leave it out"
        )
    chosen = kind or (kinds[0] if likely or axes else "")
    if chosen == DATASET:
        entries, rotates = docking, False
    else:
        ends = axes.get(chosen, (None, None) if found.bare else ends_of_axis(found))
        rotates, entries = axis_entries(found, chosen, ends)
    others = [found, *(read_log(log) for log in logs[1:])]
    runs = [_run(*pair, found, entries, chosen) for pair in zip(logs, others, strict=True)]
    if chosen == DATASET:
        beside = free_file(f"{path.stem}-scenario")
        text = dataset_text(path, beside, runs, found, entries)
        beside.write_text(template(beside.stem, start_of(found, entries)), encoding="utf-8")
        files, title = (path, beside), DATASET
    else:
        text = axis_text(path, runs, found, chosen, rotates, entries)
        files, title = (path,), f"axis: {chosen}" if chosen else "axis"
    path.write_text(text, encoding="utf-8")
    lacking = [e.channel for e in entries if not e.column]
    lacking += [] if found.own or any(e.channel == "t" for e in entries) else ["t"]
    guesses = {e.channel: e.column for e in entries if e.column}
    unused = tuple(n for n in found.roles if n not in guesses.values())
    rest = tuple(k for k in kinds if k != chosen)
    notes = tuple(f"{found.path.name} {note}" for note in found.notes)
    return FromLog(files, title, guesses, tuple(lacking), unused, rest, notes)


def _run(path: Path, other: Log, first: Log, entries: Sequence[Entry], kind: str) -> str:
    """The line of a run: its file, and how its approach differs from that of the first one."""
    lacks = [e.column for e in entries if e.column and e.column not in other.roles]
    if lacks:
        raise InputError(
            f"--from {path}: has no column {lacks[0]!r} that changes, as {first.path} has; allowed "
            "are logs with the same columns, one a run"
        )
    line = f"file: {quoted(os.path.relpath(path))}"
    if kind == DATASET:
        own, base = start_of(other, entries), start_of(first, entries)
        differs = {k: v for k, v in _flat(own).items() if _flat(base).get(k) != v and k != "rate"}
        if differs:
            line += f", set: {{{', '.join(f'{k}: {v}' for k, v in differs.items())}}}"
    return f"  - {{{line}}}"


def _flat(start: Mapping[str, Any]) -> dict[str, Any]:
    """Keys of a scenario with dots between them."""
    approach = {f"approach.{k}": v for k, v in start.get("approach", {}).items()}
    return {k: v for k, v in start.items() if k != "approach"} | approach
