"""One data file to one record: channel map, clock, resampling to the loop's ticks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hiltestbed.config.dataset import Channel
from hiltestbed.errors import Fault, InputError
from hiltestbed.frames import Array, quat_from_attitude_deg
from hiltestbed.measured.clock import (
    UsableRows,
    as_ticks,
    bend,
    check_clock,
    start_of_run,
    to_ticks,
    unrolled,
)
from hiltestbed.measured.columns import Columns, unreadable
from hiltestbed.measured.data_format import DataFormat
from hiltestbed.measured.formats import read_columns
from hiltestbed.measured.noise import digits_of, step_of, white_noise
from hiltestbed.measured.record import MEASURED_GROUPS, Record, place, stretches
from hiltestbed.measured.remark import Remark, loss, note
from hiltestbed.measured.units import ANGLES
from hiltestbed.measured.values import (
    SAME,
    in_si,
    signal,
    stated_unit,
    without_held,
)
from hiltestbed.scenario import Scenario
from hiltestbed.signals import GROUPS

# ticks per row; below it about every tick lies between two rows, above it on a row or on none
BETWEEN = 1.5
# inverse variance factor of samples that a logger has interpolated: the mean of (1 - p)^2 + p^2 is
# 2/3
RESAMPLED = 1.5
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
    try:
        columns = read_columns(file, frozenset(source.values()), form)
    except MemoryError as error:
        raise unreadable(file, "does not fit into memory", "cut the file to the run") from error
    _refuse_missing(file, columns, channels, source)
    remarks = [note(run, "", text) for text in columns.notes]
    # empty by intention; one with stamps of its own is a record that was cut short
    none = {c for c, rows in columns.data.items() if not len(rows) and c not in columns.clock}
    empty = [name for name, column in source.items() if column in none]
    columns.data = {name: rows for name, rows in columns.data.items() if name not in none}
    if empty:
        text = "is empty in the file (0 samples): taken as not measured"
        remarks.append(loss(run, ", ".join(empty), text))
    values = {}
    for name in CHANNELS:
        if source[name] in columns.data:
            mapped = channels.get(name, SAME)
            values[name], found = signal(run, name, source[name], columns, mapped, missing)
            remarks += found
    if not values:
        what = "holds none of the channels " + ", ".join(f"{group}.*" for group in MEASURED_GROUPS)
        what = f"{what} ({columns.nearest(['pose_act'])}); name its columns there"
        raise _refused(file, "channels", what)
    values, source = _attitudes(file, values, source)
    values, held = without_held(run, values)
    stamps, found = _stamps(run, file, columns, values, source, channels)
    clocks, more = _clocks(run, stamps, scenario)
    remarks += [*found, *more]
    usable = {name: (values[name], clock) for name, clock in clocks.items() if clock is not None}
    if len(usable) < len(values):
        return None, remarks
    shared: dict[int, tuple[UsableRows, dict[str, Array]]] = {}
    for name, (column, clock) in usable.items():
        shared.setdefault(id(clock), (clock, {}))[1][name] = column
    regular, found = as_ticks(run, list(shared.values()), scenario.tick)
    usable = {name: (column, regular[id(clock)]) for name, (column, clock) in usable.items()}
    lost, more = _losses(run, usable)
    kept = {name: pair for name, pair in usable.items() if name not in lost}
    record = _on_ticks(run, file, kept, scenario) if kept else None
    return record, [*remarks, *found, *held, *more]


def _refused(file: Path, key: str, what: str) -> InputError:
    return InputError(Fault(str(file), None, None, key, what))


def _refuse_missing(
    file: Path, columns: Columns, channels: Mapping[str, Channel], source: Mapping[str, str]
) -> None:
    """Raises InputError for all mapped columns that the file lacks, or has as something else."""
    columns.refuse_others(file, source.values())
    mapped = {n: source[n] for n, channel in channels.items() if n in source and channel.column}
    missing = {name: column for name, column in mapped.items() if column not in columns.data}
    if missing:
        what = (
            f"names no column of the file (got {', '.join(map(repr, missing.values()))}); "
            f"{columns.nearest(list(missing.values()))}"
        )
        raise _refused(file, ", ".join(f"channels.{name}" for name in missing), what)


def _attitudes(
    file: Path, values: Mapping[str, Array], source: Mapping[str, str]
) -> tuple[dict[str, Array], dict[str, str]]:
    """The channels with attitudes by three angles as quaternions. Raises InputError for a part."""
    values, source = dict(values), dict(source)
    for group, names in ANGLES.items():
        given, parts = [n for n in names if n in values], GROUPS[group].columns[3:]
        if not given:
            continue
        both = [n for n in parts if n in values]
        if len(given) < 3 or both:
            what = (
                f"states its attitude by {', '.join([*given, *both])}; allowed are all of "
                f"{', '.join(names)} or all of {', '.join(parts)}"
            )
            raise _refused(file, group, what)
        angles = np.degrees(np.stack([values.pop(n) for n in names], axis=-1))
        values |= dict(zip(parts, quat_from_attitude_deg(angles).T, strict=True))
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
    """The time stamps [s] of each channel, of the file or of its own; and remarks on their unit."""
    shared = columns.data.get(source["t"])
    if shared is None and not all(source[name] in columns.clock for name in values):
        what = f"has no time column {source['t']!r}; {columns.nearest([source['t']])}"
        raise _refused(file, "t", f"{what}; name it under channels: {{t: {{column: ...}}}}")
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
) -> tuple[dict[str, UsableRows | None], list[Remark]]:
    """The clock of each channel, from the start of the run, and the remarks on them, once."""
    tick, duration = scenario.tick, scenario.duration
    given = {id(t): t for t in stamps.values()}
    distinct = {key: unrolled(run, t) for key, t in given.items()}
    remarks = [remark for _, found in distinct.values() for remark in found]
    firsts = [float(t[np.isfinite(t)][0]) for t, _ in distinct.values() if np.isfinite(t).any()]
    shift, found = start_of_run(run, min(firsts), tick, duration) if firsts else (0.0, [])
    remarks += found
    checked: dict[int, UsableRows | None] = {}
    for key, (t, _) in distinct.items():
        checked[key], found = check_clock(run, t - shift if shift else t, tick, duration)
        remarks += found
    once = [remark for i, remark in enumerate(remarks) if remark not in remarks[:i]]
    return {name: checked[id(t)] for name, t in stamps.items()}, once


def _losses(
    run: int, channels: Mapping[str, tuple[Array, UsableRows]]
) -> tuple[set[str], list[Remark]]:
    """Channels that lack too many samples, and remarks, one for those that lack the same."""
    lost: set[str] = set()
    patterns: dict[bytes, tuple[NDArray[np.bool_], UsableRows, list[str]]] = {}
    for name, (column, clock) in channels.items():
        missing = ~np.isfinite(column[clock.rows])
        if 2 * missing.sum() > len(missing):
            lost.add(name)
        if missing.any():
            patterns.setdefault(missing.tobytes(), (missing, clock, []))[2].append(name)
    remarks = []
    for missing, clock, names in patterns.values():
        start, end = max(stretches(missing), key=lambda stretch: stretch[1] - stretch[0])
        longest, count, of = end - start, int(missing.sum()), len(missing)
        text = (
            f"missing (NaN) in {count} of {of} samples, at most {longest} in a row "
            f"from {clock.t[start]:.6g} s"
        )
        text += "; left out of this run" if 2 * count > of else ""
        remarks.append(loss(run, ", ".join(names), text))
    return lost, remarks


def _on_ticks(
    run: int, file: Path, channels: Mapping[str, tuple[Array, UsableRows]], scenario: Scenario
) -> Record:
    tick, clocks = scenario.tick, [clock for _, clock in channels.values()]
    ticks = round(max(float(clock.t[-1]) for clock in clocks) * scenario.rate) + 1
    data, valid, bends, sampled = {}, {}, {}, {}
    for name, (column, clock) in channels.items():
        group, part = place(name)
        if group not in data:
            shape = (ticks, len(GROUPS[group].parts))
            data[group], valid[group] = np.full(shape, np.nan), np.zeros(shape, dtype=bool)
        samples = clock.t, column[clock.rows]
        straight, measured = to_ticks(*samples, ticks, tick, clock.interval)
        data[group][:, part], valid[group][:, part] = straight, measured
        bent = bend(*samples, straight, measured, tick)
        if bent is not None:
            bends.setdefault(group, np.zeros(data[group].shape))[:, part] = bent
            if clock.interval < BETWEEN * tick:
                as_many = math.sqrt(RESAMPLED * clock.interval / tick)
                sampled[name] = white_noise(samples[1]) * as_many
    columns = {name: column for name, (column, _) in channels.items()}
    steps = _steps(columns)
    return Record(
        run,
        file,
        np.arange(ticks) / scenario.rate,
        data,
        valid,
        absent=tuple(name for name in CHANNELS if name not in channels),
        sample_rate=1 / min(clock.interval for clock in clocks),
        steps=steps,
        digits=_digits(columns, steps),
        bends=bends,
        sampled=sampled,
    )


def _digits(columns: Mapping[str, Array], steps: Mapping[str, float]) -> dict[str, int]:
    """Number of significant digits of the columns that were written with few. A column with
    ``steps`` counts where most columns of the file were written with as many: its smallest step is
    then not the step of all its values.
    """
    counts = {name: digits_of(column) for name, column in columns.items()}
    found = {name: count for name, count in counts.items() if count is not None}
    free = [count for name, count in found.items() if name not in steps]
    usual = max(free, key=free.count, default=0)
    if 2 * free.count(usual) <= len(columns):
        usual = 0
    return {name: count for name, count in found.items() if name not in steps or count == usual}


def _steps(columns: Mapping[str, Array]) -> dict[str, float]:
    """The quantisation steps; a column that hardly moves has that of similar ones."""
    found = {name: step_of(column[np.isfinite(column)]) for name, column in columns.items()}
    steps = {name: step for name, step in found.items() if step is not None}
    for name, column in columns.items():
        alike = [step for other, step in steps.items() if other[:-1] == name[:-1] and other != name]
        if name not in steps and alike and len(np.unique(column[np.isfinite(column)])) < 3:
            steps[name] = max(alike)
    return steps
