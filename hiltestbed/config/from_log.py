"""A dataset from a log: the columns that it may hold, as commented YAML with guesses to correct.

A docking dataset, with a scenario beside it, where the log holds a pose and a wrench; an arm where
it holds several joints; an axis (drive, servo or damper) otherwise.
"""

from __future__ import annotations

import difflib
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hiltestbed.config.template import free_file, template
from hiltestbed.errors import InputError
from hiltestbed.frames import Array
from hiltestbed.measured.columns import STAMP, Columns
from hiltestbed.measured.formats import data_file, no_file, read_columns
from hiltestbed.measured.joints import joints_of
from hiltestbed.measured.roles import (
    BARE,
    COMPENSATED,
    PUSHES,
    Role,
    angle_unit,
    by_values,
    length_unit,
    role_of,
    time_unit,
)
from hiltestbed.measured.units import SI_UNIT, UNITS

SHOWN = 12  # columns that a comment lists
FREE = 20  # rows at the start of a run from which the approach is taken
DAMPER = re.compile(r"damper|displac|disp\b|stroke|deflect", re.IGNORECASE)
AXES = ("drive", "servo", "damper")
PARTS = ("pose_cmd.pz", "pose_act.pz", "wrench_meas.fz", "wrench_comp.fz")  # of a rig, at least
KINDS = (
    "drive: force or current to position; servo: command to position; damper: displacement to force"
)
DATASET, ARM = "dataset", "arm"
BELIEVED = {  # of an axis
    "drive": "fill in: {mass: ...} [kg; of an axis that rotates: kg m^2]; gain, viscous, coulomb, "
    "offset",
    "servo": "delay [s], bandwidth [Hz], damping_ratio; left out: it follows its command",
    "damper": "stiffness [N/m], damping [N s/m], preload [N]",
    "arm": "beside the model: gain [N m/A], viscous, coulomb, offset, armature",
    "": "what you believe of it",
}


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


class Entry(NamedTuple):
    """A channel: its column, the unit, and why; no column: the choices that there are. turned:
    whether its sign is the other one.
    """

    channel: str
    column: str
    unit: str
    why: str
    turned: bool = False


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
            yield f"  not used: {_listed(self.not_used)}"
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
    likely, axes = [] if found.bare else _docking(found, False), _axes(found)
    docking = likely or _docking(found, True)
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
        ends = axes.get(chosen, (None, None) if found.bare else _ends(found))
        rotates, entries = _axis(found, chosen, ends)
    others = [found, *(read_log(log) for log in logs[1:])]
    runs = [_run(*pair, found, entries, chosen) for pair in zip(logs, others, strict=True)]
    if chosen == DATASET:
        beside = free_file(f"{path.stem}-scenario")
        text = _dataset_text(path, beside, runs, found, entries)
        beside.write_text(template(beside.stem, _start(found, entries)), encoding="utf-8")
        files, title = (path, beside), DATASET
    else:
        text = _axis_text(path, runs, found, chosen, rotates, entries)
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
    line = f"file: {_quoted(os.path.relpath(path))}"
    if kind == DATASET:
        own, base = _start(other, entries), _start(first, entries)
        differs = {k: v for k, v in _flat(own).items() if _flat(base).get(k) != v and k != "rate"}
        if differs:
            line += f", set: {{{', '.join(f'{k}: {v}' for k, v in differs.items())}}}"
    return f"  - {{{line}}}"


def _flat(start: Mapping[str, Any]) -> dict[str, Any]:
    """Keys of a scenario with dots between them."""
    approach = {f"approach.{k}": v for k, v in start.get("approach", {}).items()}
    return {k: v for k, v in start.items() if k != "approach"} | approach


def read_log(path: Path) -> Log:
    """The columns of a log. Raises InputError if it cannot be read."""
    file = data_file(path)
    if not file.is_file():
        raise InputError(f"--from {path}: names no file; {no_file(file)}")
    known = read_columns(file, frozenset())
    names, bare = known.names, all(name.isdigit() for name in known.names)
    columns = _loaded(file, names)
    roles = {
        name: role_of(name, columns.units.get(name, ""))
        for name in names
        if name in columns.data and _moves(columns.data[name])
    }
    if not roles:
        raise InputError(
            f"{path}: holds no column of numbers that change (columns: {_listed(names)}); allowed "
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


def _moves(values: Array) -> bool:
    known = _known(values)
    return len(known) > 1 and float(np.ptp(known)) > 0.0


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


def _time(log: Log) -> list[Entry]:
    """The entry of the times, if the log has one column of them."""
    for name, role in log.roles.items():
        values = log.data[name]
        if log.own or role.quantity != "time" or (np.diff(_known(values)) < 0).any():
            continue
        if role.unit:
            return [Entry("t", name, role.unit, "unit as stated")]
        if log.dates and values.max() > 60.0:
            why = "dates or times of day, read as seconds from the midnight before the first row"
            return [Entry("t", name, "", why)]
        unit, why = time_unit(values)
        return [Entry("t", name, unit, f"guess: unit {why}")]
    return []


def _ends(log: Log, quantities: Sequence[str] = ()) -> tuple[Role | None, Role | None]:
    """What drives an axis, a command or one of ``quantities``, and its position; None: no column
    may be it.
    """
    roles = list(log.roles.values())
    places = [r for r in roles if not r.commanded and r.quantity == "position"]
    places += [r for r in roles if r.commanded is False and not r.quantity]
    place = places[0] if places else None
    if quantities:
        inputs = [r for q in quantities for r in roles if r.quantity == q and not r.commanded]
        inputs += [r for q in quantities for r in roles if r.quantity == q and r.commanded]
    else:
        inputs = [r for r in roles if r.commanded and r.quantity in ("position", "")]
    return max(inputs, key=lambda r: _likeness(r, place), default=None), place


def _axes(log: Log) -> dict[str, tuple[Role | None, Role | None]]:
    """The kinds of axis that a log may be, the likeliest first, each with its input and output."""
    command, place = _ends(log)
    push = _ends(log, PUSHES)[0]
    joints = joints_of(log.roles)
    out: dict[str, tuple[Role | None, Role | None]] = {}
    if joints:
        out[ARM] = joints[0].effort, joints[0].position
    if place is not None and command is not None:
        out["servo"] = command, place
    if place is not None and push is not None:
        out["drive"] = push, place
        if push.quantity != "current":
            damper = DAMPER.search(f"{log.path.name} {place.column}") and push.quantity == "force"
            last = {"drive": out.pop("drive")} if damper and command is None else {}
            out |= {"damper": (place, push)} | last
    return out


def _axis(log: Log, kind: str, ends: tuple[Role | None, Role | None]) -> tuple[bool, list[Entry]]:
    """Whether an axis turns, and its channels."""
    if kind == ARM:
        return False, _arm(log)
    rotates = any(r is not None and (r.angular or r.quantity == "torque") for r in ends)
    ends_of = {r.column for r in ends if r is not None}
    rest = [n for n, r in log.roles.items() if n not in ends_of and r.quantity != "time"]
    channels = [
        _channel(channel, role, rotates, log, rest)
        for channel, role in zip(("input", "output"), ends, strict=True)
    ]
    if kind == "servo":
        channels = _together(channels, ("input", "output"), log)
    return rotates, [*_time(log), *channels]


def _arm(log: Log) -> list[Entry]:
    """The times, and position and input of each joint."""
    entries, joints = _time(log), joints_of(log.roles)
    for joint in joints:
        slides = joint.position.unit in UNITS["m"]
        for part, role in (("position", joint.position), ("input", joint.effort)):
            entries.append(_channel(f"{joint.name}.{part}", role, not slides, log, ()))
    return _together(entries, [f"{joint.name}.position" for joint in joints], log)


def _likeness(role: Role, other: Role | None) -> float:
    if other is None:
        return 0.0
    return difflib.SequenceMatcher(None, role.column, other.column).ratio()


def _channel(
    channel: str, role: Role | None, rotates: bool, log: Log, rest: Sequence[str]
) -> Entry:
    if role is None:
        return _open(channel, rest)
    values = log.data[role.column]
    if role.quantity in ("position", ""):
        si = "rad" if rotates else "m"
    else:
        si = {"force": "N", "torque": "N m", "current": "A"}[role.quantity]
    return _in_unit(channel, role, si, values)


def _open(channel: str, choices: Sequence[str]) -> Entry:
    return Entry(channel, "", "", f"could not be guessed; choices: {_listed(choices)}")


def _in_unit(channel: str, role: Role, si: str, values: Array) -> Entry:
    """The entry of a column in its unit: as it is stated, or by its size, or the SI unit."""
    if role.unit:
        unit, why = role.unit, "unit as stated"
    elif si == "1":
        unit, why = "", "a quaternion"
    else:
        by_size = {"rad": angle_unit, "m": length_unit}
        unit, why = by_size[si](values) if si in by_size else (si, "not stated")
        why = f"guess: unit {why}"
    return Entry(channel, role.column, unit, f"{_range(values)}; {why}")


def _together(entries: Sequence[Entry], channels: Sequence[str], log: Log) -> list[Entry]:
    """The entries with one unit for ``channels`` that state none: the one that is stated for one of
    them, or that of the largest.
    """
    own = [e for e in entries if e.channel in channels and e.column and e.unit]
    if not own:
        return list(entries)
    stated = [e for e in own if log.roles[e.column].unit]
    unit = (stated or sorted(own, key=lambda e: -np.ptp(_known(log.data[e.column]))))[0].unit
    return [
        e._replace(unit=unit) if e in own and not log.roles[e.column].unit else e for e in entries
    ]


def _known(values: Array) -> Array:
    return values[np.isfinite(values)]


def _docking(log: Log, stated: bool) -> list[Entry]:
    """The channels of a pose and a wrench, and the times; none if the log does not hold both.
    stated: it is known to hold them, so that a position and a force without an axis are z.
    """
    taken: dict[str, Entry] = {}
    for name, role in log.roles.items():
        part = role.part or (_along_z(role) if stated else "")
        if not part or role.quantity == "other":
            continue
        if part[0] in "ft":
            used = set(re.findall("[a-z]+", name.lower())) & set(COMPENSATED.split())
            channel = f"{'wrench_comp' if used else 'wrench_meas'}.{part}"
        else:
            channel = f"{'pose_cmd' if role.commanded else 'pose_act'}.{part}"
        if channel not in taken:
            taken[channel] = _in_unit(channel, role, SI_UNIT[channel], log.data[name])
    # a force and a position alone may as well be those of a damper
    exact = stated or any(c == e.column for c, e in taken.items())
    poses = sum(c.startswith("pose_") for c in taken)
    sides = ("wrench_", "fz"), ("pose_", "pz")
    if log.bare:
        used = {e.column for e in taken.values()}
        rest = [n for n, r in log.roles.items() if n not in used and r.quantity != "time"]
        taken |= {c: _open(c, rest) for c in PARTS if c not in taken}
    elif poses < (1 if exact else 2) or not all(
        any(c.startswith(side) and c.endswith(part) for c in taken) for side, part in sides
    ):
        return []
    entries = [taken[c] for c in SI_UNIT if c in taken]
    for group in ("pose_cmd", "pose_act"):
        for parts in ("p", "r"):
            entries = _together(entries, [f"{group}.{parts}{axis}" for axis in "xyz"], log)
    for group in ("wrench_meas", "wrench_comp"):
        entries = _pushing(entries, group, log)
    return [*_time(log), *entries]


def _along_z(role: Role) -> str:
    return {"force": "fz", "position": "pz"}.get(role.quantity, "")


def _pushing(entries: Sequence[Entry], group: str, log: Log) -> list[Entry]:
    """The entries with the signs of a wrench turned if its largest force along z is a pull."""
    force = next((e for e in entries if e.channel == f"{group}.fz"), None)
    if force is None or not force.column:
        return list(entries)
    values = _known(log.data[force.column])
    values = values - np.median(values[:FREE])
    if values[np.argmax(np.abs(values))] > 0.0:
        return list(entries)
    why = "; guess: turned, so that the largest force pushes"
    return [
        e._replace(turned=True, why=e.why + why) if e.channel.startswith(group) else e
        for e in entries
    ]


def _start(log: Log, entries: Sequence[Entry]) -> dict[str, Any]:
    """What the log shows of its scenario: rate, duration and approach."""
    found = {e.channel: e for e in entries if e.column}
    if "t" not in found:
        return {}
    t = log.data[found["t"].column] * UNITS["s"].get(found["t"].unit or "s", 1.0)
    ticks = _known(t)
    step = float(np.median(np.diff(ticks)))
    rate = float(f"{1.0 / step:.4g}") if step > 0.0 else 0.0
    out: dict[str, Any] = {"duration": float(f"{ticks[-1] - ticks[0]:.6g}")}
    out |= {"rate": int(rate) if rate == int(rate) else rate} if rate else {}
    group = "pose_cmd" if "pose_cmd.pz" in found else "pose_act"
    # a command is reached a tick later
    at = ticks[0] - (step if group == "pose_cmd" else 0.0)
    place, speed = [0.0] * 3, [0.0] * 3
    for axis, letter in enumerate("xyz"):
        entry = found.get(f"{group}.p{letter}")
        if entry is not None:
            values = log.data[entry.column] * UNITS["m"][entry.unit]
            known = np.flatnonzero(np.isfinite(values) & np.isfinite(t))[:FREE]
            if len(known) < 2:
                continue
            slope, begin = np.polyfit(t[known] - at, values[known], 1)
            place[axis], speed[axis] = float(f"{begin:.6g}"), float(f"{slope:.6g}")
    approach = {"velocity": speed, "offset": place[:2]}
    return out | {"approach": ({"gap": -place[2]} if place[2] < 0.0 else {"gap": 0.01}) | approach}


def _dataset_text(
    path: Path, beside: Path, runs: Sequence[str], log: Log, entries: Sequence[Entry]
) -> str:
    lines = [
        *_head(path, log),
        f"# {beside}: rate, duration and approach are those of the log; the rest is an example:",
        "# state what you believe of your rig, its masses and inertias first.",
        f"scenario: {beside}",
        "runs:",
        *runs,
        "  # - {file: ..., set: {approach.velocity.2: 0.05}}   # a further run, and what differs",
        "channels:   # pushing gives fz > 0; if not, scale: -1 for all forces and torques",
        *_lines(entries, log),
    ]
    return "\n".join([*lines, *_rest(log, entries)]) + "\n"


def _axis_text(
    path: Path, runs: Sequence[str], log: Log, kind: str, rotates: bool, entries: Sequence[Entry]
) -> str:
    said = "guess" if kind else "could not be guessed; state one of them"
    about = [
        f"# {KINDS}",
        f"axis: {kind}   # {said}",
        f"rotates: {str(rotates).lower()}   # guess; true: positions in rad, forces in N m",
        f"nominal: {{}}   # {BELIEVED[kind]}",
    ]
    if kind == ARM:
        joints = ", ".join(f"{_quoted(joint.name)}: {{}}" for joint in joints_of(log.roles))
        about = [
            "axis: arm   # motion of the joints to their torques",
            "model: arm.urdf   # state the URDF or MJCF of the arm; the joints by its names:",
            f"joints: {{{joints}}}   # {BELIEVED[kind]}",
        ]
    lines = [
        *_head(path, log),
        *about,
        "runs:",
        *runs,
        "  # - {file: ...}   # further runs; three of different motions are better",
        "channels:",
        *_lines(entries, log),
    ]
    if not log.own and not any(e.channel == "t" for e in entries):
        lines.append(
            "# rate: 1000.0      # [Hz] the log has no column of times: state its rate here"
        )
    return "\n".join([*lines, *_rest(log, entries)]) + "\n"


def _head(path: Path, log: Log) -> list[str]:
    rows = max((len(v) for v in log.data.values()), default=0)
    return [
        f"# From {log.path.name}: {len(log.names)} columns, {rows} rows. Correct the guesses:",
        f"#   hiltestbed check {path} && hiltestbed diagnose {path}",
        *([f"# The log names no columns. They are {BARE}."] if log.bare else []),
    ]


def _lines(entries: Sequence[Entry], log: Log) -> Iterator[str]:
    if not any(e.channel == "t" for e in entries):
        have = "the columns have times of their own" if log.own else (
            f"no column of times was found; choices: {_listed(list(log.roles))}"
        )  # fmt: skip
        yield f"  # t: {have}"
    for e in entries:
        if not e.column:
            yield f"  # {e.channel}: {{column: ...}}   # {e.why}"
            continue
        unit = (f", unit: {e.unit}" if e.unit else "") + (", scale: -1" if e.turned else "")
        yield f"  {e.channel}: {{column: {_quoted(e.column)}{unit}}}   # {e.why}"


def _rest(log: Log, entries: Sequence[Entry]) -> list[str]:
    """What is not used."""
    used = {e.column for e in entries}
    moving = [n for n in log.names if n not in used and n in log.roles]
    still = [n for n in log.names if n not in used and n not in log.roles]
    out = [f"# not used: {_listed(moving)}"] if moving else []
    if log.bare:
        out = [f"# not used: {_quoted(n)}, {_range(log.data[n])}" for n in moving]
    return out + ([f"# constant, empty or no numbers: {_listed(still)}"] if still else [])


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return (", ".join(map(_quoted, names[:SHOWN])) or "none") + more


def _range(values: Array) -> str:
    return f"from {np.nanmin(values):.4g} to {np.nanmax(values):.4g}"


def _quoted(text: str) -> str:
    """A YAML scalar, on one line in a comment, too."""
    return text if re.fullmatch(r"[A-Za-z][\w./]*", text) else json.dumps(text)
