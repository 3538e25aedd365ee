"""One data file to one record: channel map, clock, resampling to the loop's ticks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from hiltestbed.config.dataset import Channel
from hiltestbed.errors import Fault, InputError
from hiltestbed.frames import Array, quat_from_attitude_deg
from hiltestbed.measured.clock import Clock, bend, check_clock, start_of_run, to_ticks
from hiltestbed.measured.columns import Columns
from hiltestbed.measured.data_format import DataFormat
from hiltestbed.measured.formats import read_columns
from hiltestbed.measured.held import without_held
from hiltestbed.measured.noise import digits_of, step_of, white_noise
from hiltestbed.measured.record import MEASURED_GROUPS, Record, place
from hiltestbed.measured.remark import Remark
from hiltestbed.measured.rollover import unrolled
from hiltestbed.measured.ticks import as_ticks
from hiltestbed.measured.units import ANGLES
from hiltestbed.measured.values import SAME, in_si, signal, stated_unit, without_empty
from hiltestbed.scenario import Scenario
from hiltestbed.signals import GROUPS

# ticks per row; below it about every tick lies between two rows, above it on a row or on none
BETWEEN = 1.5
# inverse variance factor of samples that a logger has interpolated: the mean of (1 - p)^2 + p^2 is
# 2/3
RESAMPLED = 1.5
MISSING_LIMIT = 0.5  # part of its samples that a channel may lack before it is left out
TURNS = tuple(name for names in ANGLES.values() for name in names)
CHANNELS = (*(c for group in MEASURED_GROUPS for c in GROUPS[group].columns), *TURNS)


def read_record(
    run: int,
    file: Path,
    channels: Mapping[str, Channel],
    scenario: Scenario,
    form: DataFormat | None = None,
    missing: Sequence[float] = (),
) -> tuple[Record | None, list[Remark]]:
    """One file on the loop's ticks; None if it cannot be used (the remarks say why).

    Args:
        form: format of the file, None: by its suffix. missing: values that stand for a missing
            sample.

    Raises InputError if the file cannot be read or lacks a mapped column; MissingExtra if its
    reader is not installed.
    """
    source = {name: channels.get(name, SAME).column or name for name in ("t", *CHANNELS)}
    columns = _read(file, frozenset(source.values()), form)
    _refuse_missing(file, columns, channels, source)
    notes = [Remark("note", run, "", text) for text in columns.notes]
    columns, found = without_empty(run, columns, source)
    notes += found
    values = {}
    for name in CHANNELS:
        if source[name] in columns.data:
            mapped = channels.get(name, SAME)
            values[name], found = signal(run, name, source[name], columns, mapped, missing)
            notes += found
    if not values:
        what = "holds none of the channels " + ", ".join(f"{group}.*" for group in MEASURED_GROUPS)
        raise InputError(
            Fault(
                str(file),
                None,
                None,
                "channels",
                f"{what} ({columns.nearest(['pose_act'])}); name its columns there",
            )
        )
    values, source = _attitudes(file, values, source)
    values, held = without_held(run, values)
    stamps, found = _stamps(run, file, columns, values, source, channels)
    clocks, remarks = _clocks(run, stamps, scenario)
    remarks = [*notes, *found, *remarks]
    good = {name: (values[name], clock) for name, clock in clocks.items() if clock is not None}
    if len(good) < len(values):
        return None, remarks
    shared = {
        id(clock): (clock, {n: column for n, (column, other) in good.items() if other is clock})
        for _, clock in good.values()
    }
    regular, found = as_ticks(run, list(shared.values()), scenario.tick)
    good = {name: (column, regular[id(clock)]) for name, (column, clock) in good.items()}
    remarks += found
    lost, more = _losses(run, good)
    remarks += [*held, *more]
    record = _on_ticks(
        run, file, {name: pair for name, pair in good.items() if name not in lost}, scenario
    )
    return record, remarks


def _read(file: Path, wanted: frozenset[str], form: DataFormat | None) -> Columns:
    try:
        return read_columns(file, wanted, form)
    except MemoryError as error:
        raise InputError(
            Fault(str(file), None, None, "", "does not fit into memory; cut the file to the run")
        ) from error


def _refuse_missing(
    file: Path, columns: Columns, channels: Mapping[str, Channel], source: Mapping[str, str]
) -> None:
    """Raises InputError, one fault for all columns that the channel map names and the file lacks,
    and one for each thing in the file whose name is that of wanted columns but is none.
    """
    columns.refuse_others(file, source.values())
    missing = [
        name
        for name in channels
        if name in source and channels[name].column and source[name] not in columns.data
    ]
    if missing:
        wanted = [source[name] for name in missing]
        what = (
            f"names no column of the file (got {', '.join(map(repr, wanted))}); "
            f"{columns.nearest(wanted)}"
        )
        raise InputError(
            Fault(str(file), None, None, ", ".join(f"channels.{name}" for name in missing), what)
        )


def _attitudes(
    file: Path, values: Mapping[str, Array], source: Mapping[str, str]
) -> tuple[dict[str, Array], dict[str, str]]:
    """The channels and their columns with each attitude that was recorded as three angles as a
    quaternion. Raises InputError for one or two angles, or both forms.
    """
    values, source = dict(values), dict(source)
    for group, names in ANGLES.items():
        given, parts = [n for n in names if n in values], GROUPS[group].columns[3:]
        if not given:
            continue
        both = [n for n in parts if n in values]
        if len(given) < 3 or both:
            raise InputError(
                Fault(
                    str(file),
                    None,
                    None,
                    group,
                    f"states its attitude by {', '.join([*given, *both])}; allowed are all of "
                    f"{', '.join(names)} or all of {', '.join(parts)}",
                )
            )
        angles = np.degrees(np.stack([values.pop(n) for n in names], axis=-1))
        attitude = quat_from_attitude_deg(angles)
        values |= {name: attitude[:, j] for j, name in enumerate(parts)}
        source |= dict.fromkeys(parts, source[names[0]])
    return values, source


def _stamps(
    run: int,
    file: Path,
    columns: Columns,
    values: Mapping[str, Array],
    source: Mapping[str, str],
    channels: Mapping[str, Channel],
) -> tuple[dict[str, Array], list[Remark]]:
    """The time stamps [s] of each channel: the time column of the file, or the channel's own clock
    if there is no such column; and remarks on their unit.
    """
    shared = columns.data.get(source["t"])
    if shared is None and not all(source[name] in columns.clock for name in values):
        what = f"has no time column {source['t']!r}; {columns.nearest([source['t']])}"
        raise InputError(
            Fault(
                str(file),
                None,
                None,
                "t",
                f"{what}; name it under channels: {{t: {{column: ...}}}}",
            )
        )
    known: dict[bytes, Array] = {}
    stamps, faults, remarks = {}, [], []
    mapped = channels.get("t", SAME)
    stated = "" if shared is None else stated_unit(columns, source["t"])
    for name, column in values.items():
        raw = columns.clock[source[name]] if shared is None else shared
        if len(raw) != len(column):
            what = (
                f"has {len(column)} samples, its time stamps are {len(raw)}; allowed is "
                f"one stamp a sample"
            )
            faults.append(Fault(str(file), None, None, name, what))
        scaled, remarks = in_si(run, "t", raw, stated, mapped)
        stamps[name] = known.setdefault(raw.tobytes(), scaled)
    if faults:
        raise InputError(faults)
    return stamps, remarks


def _clocks(
    run: int, stamps: Mapping[str, Array], scenario: Scenario
) -> tuple[dict[str, Clock | None], list[Remark]]:
    """The clock of each channel, counted from the start of the run, and the remarks on them, each
    once.
    """
    tick, duration = scenario.tick, scenario.duration
    distinct, remarks = {}, []
    for t in stamps.values():
        if id(t) not in distinct:
            distinct[id(t)], found = unrolled(run, t)
            remarks += [remark for remark in found if remark not in remarks]
    firsts = [float(t[np.isfinite(t)][0]) for t in distinct.values() if np.isfinite(t).any()]
    shift, found = start_of_run(run, min(firsts), tick, duration) if firsts else (0.0, [])
    remarks += found
    checked: dict[int, Clock | None] = {}
    for key, t in distinct.items():
        checked[key], found = check_clock(run, t - shift if shift else t, tick, duration)
        remarks += [remark for remark in found if remark not in remarks]
    return {name: checked[id(t)] for name, t in stamps.items()}, remarks


def _losses(run: int, channels: Mapping[str, tuple[Array, Clock]]) -> tuple[set[str], list[Remark]]:
    """Channels that lack too many samples to be used, and remarks; channels that lack the same
    samples share one.
    """
    lost, patterns = set(), {}
    for name, (column, clock) in channels.items():
        missing = ~np.isfinite(column[clock.rows])
        if missing.sum() > MISSING_LIMIT * len(missing):
            lost.add(name)
        if missing.any():
            patterns.setdefault(missing.tobytes(), (missing, clock, []))[2].append(name)
    return lost, [_missing(run, *pattern) for pattern in patterns.values()]


def _missing(run: int, missing: np.ndarray, clock: Clock, names: list[str]) -> Remark:
    edges = np.flatnonzero(np.diff(np.r_[False, missing, False]))
    starts, lengths = edges[::2], np.diff(edges)[::2]
    longest, count, of = int(lengths.argmax()), int(missing.sum()), len(missing)
    text = (
        f"missing (NaN) in {count} of {of} samples, at most {lengths[longest]} in a row "
        f"from {clock.t[starts[longest]]:.6g} s"
    )
    text += "; left out of this run" if count > MISSING_LIMIT * of else ""
    return Remark(
        "loss",
        run,
        ", ".join(names),
        text,
        "",
        {"missing": count, "of": of, "longest": int(lengths[longest])},
    )


def _on_ticks(
    run: int, file: Path, channels: Mapping[str, tuple[Array, Clock]], scenario: Scenario
) -> Record | None:
    """The record; None if no channel is left."""
    if not channels:
        return None
    clocks = [clock for _, clock in channels.values()]
    ticks = round(max(float(clock.t[-1]) for clock in clocks) * scenario.rate) + 1
    data, valid, bends, sampled = {}, {}, {}, {}
    for name, (column, clock) in channels.items():
        group, part = place(name)
        if group not in data:
            shape = (ticks, len(GROUPS[group].parts))
            data[group], valid[group] = np.full(shape, np.nan), np.zeros(shape, dtype=bool)
        samples = clock.t, column[clock.rows]
        straight, measured = to_ticks(*samples, ticks, scenario.tick, clock.interval)
        data[group][:, part], valid[group][:, part] = straight, measured
        bent = bend(*samples, straight, measured, scenario.tick)
        if bent is not None:
            bends.setdefault(group, np.zeros(data[group].shape))[:, part] = bent
            if clock.interval < BETWEEN * scenario.tick:
                sampled[name] = white_noise(column[clock.rows]) * math.sqrt(
                    RESAMPLED * clock.interval / scenario.tick
                )
    absent = tuple(name for name in CHANNELS if name not in channels)
    rate = 1 / min(clock.interval for clock in clocks)
    found = {name: step_of(column[np.isfinite(column)]) for name, (column, _) in channels.items()}
    steps = {name: step for name, step in found.items() if step is not None}
    _share_steps(steps, {name: column for name, (column, _) in channels.items()})
    digits = _digits({name: column for name, (column, _) in channels.items()}, steps)
    return Record(
        run,
        file,
        np.arange(ticks) / scenario.rate,
        data,
        valid,
        {},
        absent,
        rate,
        steps,
        digits,
        bends,
        sampled,
    )


def _digits(columns: Mapping[str, Array], steps: Mapping[str, float]) -> dict[str, int]:
    """Number of significant digits of the columns that were written with few. A column with
    ``steps`` counts where most columns of the file
    were written with as many: its smallest step is then not the step of all its values.
    """
    found = {
        name: count for name, column in columns.items() if (count := digits_of(column)) is not None
    }
    free = [count for name, count in found.items() if name not in steps]
    usual = max(free, key=free.count, default=0)
    written_so = 2 * free.count(usual) > len(columns)
    return {
        name: count
        for name, count in found.items()
        if name not in steps or (written_so and count == usual)
    }


def _share_steps(steps: dict[str, float], columns: Mapping[str, Array]) -> None:
    """Give a channel that hardly moves the quantisation step of similar channels (forces,
    positions): its own cannot be determined.
    """
    for name, column in columns.items():
        alike = [step for other, step in steps.items() if other[:-1] == name[:-1] and other != name]
        if name not in steps and alike and len(np.unique(column[np.isfinite(column)])) < 3:
            steps[name] = max(alike)
