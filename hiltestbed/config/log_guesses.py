"""What the columns of a log may be in a dataset: of a docking rig, of an axis, of an arm."""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hiltestbed.config.log_columns import Log, listed, range_of
from hiltestbed.frames import Array
from hiltestbed.measured.noise import FREE_MINIMUM
from hiltestbed.measured.plausible import TURNED_DEG
from hiltestbed.measured.roles import (
    PUSHES,
    Role,
    angle_unit,
    channel_of,
    finite,
    joints_of,
    length_unit,
    time_unit,
)
from hiltestbed.measured.units import SI_UNIT, UNITS

DAMPER = re.compile(r"damper|displac|disp\b|stroke|deflect", re.IGNORECASE)
# [rad] 30 deg, from which a start is refused: ports in front of each other are not tilted as much
ATTITUDE = np.radians(TURNED_DEG)
PARTS = ("pose_cmd.pz", "pose_act.pz", "wrench_meas.fz", "wrench_comp.fz")  # of a rig, at least
ARM = "arm"


class Entry(NamedTuple):
    """A channel: its column, the unit, and why; no column: the choices that there are. turned:
    whether its sign is the other one.
    """

    channel: str
    column: str
    unit: str
    why: str
    turned: bool = False


def _time(log: Log) -> list[Entry]:
    """The entry of the times, if the log has one column of them."""
    for name, role in log.roles.items():
        values = log.data[name]
        if log.own or role.quantity != "time" or (np.diff(finite(values)) < 0).any():
            continue
        if role.unit:
            return [Entry("t", name, role.unit, "unit as stated")]
        if log.dates and values.max() > 60.0:
            why = "dates or times of day, read as seconds from the midnight before the first row"
            return [Entry("t", name, "", why)]
        unit, why = time_unit(values)
        return [Entry("t", name, unit, f"guess: unit {why}")]
    return []


def ends_of_axis(log: Log, quantities: Sequence[str] = ()) -> tuple[Role | None, Role | None]:
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

    def likeness(role: Role) -> float:
        name = place.column if place is not None else ""
        return difflib.SequenceMatcher(None, role.column, name).ratio()

    return max(inputs, key=likeness, default=None), place


def axes_of(log: Log) -> dict[str, tuple[Role | None, Role | None]]:
    """The kinds of axis that a log may be, the likeliest first, each with its input and output."""
    command, place = ends_of_axis(log)
    push = ends_of_axis(log, PUSHES)[0]
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


def axis_entries(
    log: Log, kind: str, ends: tuple[Role | None, Role | None]
) -> tuple[bool, list[Entry]]:
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
    return Entry(channel, "", "", f"could not be guessed; choices: {listed(choices)}")


def _in_unit(channel: str, role: Role, si: str, values: Array) -> Entry:
    """The entry of a column in its unit: as it is stated, or by its size, or the SI unit."""
    if role.unit:
        unit, why = role.unit, "unit as stated"
    elif si == "1":
        unit, why = "", "a quaternion"
    else:
        unit, why = si, "not stated"
        if si == "m":
            unit, why = length_unit(values)
        elif si == "rad":
            pose = channel.startswith("pose_")
            unit, why = angle_unit(values, ATTITUDE) if pose else angle_unit(values)
        why = f"guess: unit {why}"
    return Entry(channel, role.column, unit, f"{range_of(values)}; {why}")


def _together(entries: Sequence[Entry], channels: Sequence[str], log: Log) -> list[Entry]:
    """The entries with one unit for ``channels`` that state none: the one that is stated for one of
    them, or degrees if one is too large for rad, or that of the longest travel.
    """
    own = [e for e in entries if e.channel in channels and e.column and e.unit]
    if not own:
        return list(entries)
    stated = [e for e in own if log.roles[e.column].unit]
    travel = {e.channel: np.ptp(finite(log.data[e.column])) for e in own}
    likely = sorted(own, key=lambda e: (e.unit != "deg", -travel[e.channel]))
    unit = (stated or likely)[0].unit
    return [
        e._replace(unit=unit) if e in own and not log.roles[e.column].unit else e for e in entries
    ]


def docking_entries(log: Log, stated: bool) -> list[Entry]:
    """The channels of a pose and a wrench, and the times; none if the log does not hold both.
    stated: it is known to hold them, so that a position and a force without an axis are z.
    """
    taken: dict[str, Entry] = {}
    along_z = {"force": "fz", "position": "pz"}
    for name, role in log.roles.items():
        part = role.part or (along_z.get(role.quantity, "") if stated else "")
        if not part or role.quantity == "other":
            continue
        channel = channel_of(role, part)
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


def _pushing(entries: Sequence[Entry], group: str, log: Log) -> list[Entry]:
    """The entries with the signs of a wrench turned if its largest force along z is a pull."""
    force = next((e for e in entries if e.channel == f"{group}.fz"), None)
    if force is None or not force.column:
        return list(entries)
    values = finite(log.data[force.column])
    values = values - np.median(values[:FREE_MINIMUM])
    if values[np.argmax(np.abs(values))] > 0.0:
        return list(entries)
    why = "; guess: turned, so that the largest force pushes"
    return [
        e._replace(turned=True, why=e.why + why) if e.channel.startswith(group) else e
        for e in entries
    ]


def start_of(log: Log, entries: Sequence[Entry]) -> dict[str, Any]:
    """What the log shows of its scenario: rate, duration and approach."""
    found = {e.channel: e for e in entries if e.column}
    if "t" not in found:
        return {}
    t = log.data[found["t"].column] * UNITS["s"].get(found["t"].unit or "s", 1.0)
    ticks = finite(t)
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
            known = np.flatnonzero(np.isfinite(values) & np.isfinite(t))[:FREE_MINIMUM]
            if len(known) < 2:
                continue
            slope, begin = np.polyfit(t[known] - at, values[known], 1)
            place[axis], speed[axis] = float(f"{begin:.6g}"), float(f"{slope:.6g}")
    approach = {"velocity": speed, "offset": place[:2]}
    return out | {"approach": ({"gap": -place[2]} if place[2] < 0.0 else {"gap": 0.01}) | approach}
