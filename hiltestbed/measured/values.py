"""Columns of a file as signals of the trace: missing and repeated samples, unit, scale, offset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hiltestbed.config.dataset import Channel
from hiltestbed.frames import Array
from hiltestbed.measured.columns import Columns
from hiltestbed.measured.outliers import Outliers, declared, outliers
from hiltestbed.measured.record import stretches
from hiltestbed.measured.remark import Remark, loss, note
from hiltestbed.measured.units import SI_UNIT, UNITS, factor, split_unit, unit_named
from hiltestbed.signals import GROUPS

SAME = Channel()
EQUAL = 1e-3  # relative difference of a scale from a factor that it stands for
HELD = "wrench_meas"  # the group whose repeated rows are looked for
HELD_AXES = 3  # that must be constant together
HELD_MOST = 0.2  # part of the rows; above it, the sensor is slower than its log and repeats most
HELD_LONGEST = 12  # successive rows; longer constant stretches are a sensor at rest


def signal(
    run: int, name: str, column: str, columns: Columns, channel: Channel, missing: Sequence[float]
) -> tuple[Array, list[Remark]]:
    """``(rows,)`` of the channel ``name`` in SI units, NaN where missing, and the remarks on it.

    Args:
        column: its name in the file. missing: values that stand for a missing sample in the whole
            dataset.
    """
    raw = columns.data[column]
    marks = (*missing, *(channel.missing or ()), *columns.missing.get(column, ()))
    values = np.where(declared(raw, marks), np.nan, raw) if marks else raw
    remarks = []
    if channel.missing is None:
        for found in outliers(values):
            remarks.append(_outlier(run, name, found))
            values = np.where(found.rows, np.nan, values) if found.code else values
    scaled, more = in_si(run, name, values, stated_unit(columns, column), channel)
    return scaled, [*remarks, *more]


def stated_unit(columns: Columns, column: str) -> str:
    """The unit that the file states for a column, of its own or at the end of the name; or ""."""
    return columns.units.get(column, "").strip() or split_unit(column)[1]


def in_si(
    run: int, name: str, values: Array, stated: str, channel: Channel
) -> tuple[Array, list[Remark]]:
    """``(rows,)`` values of a column in SI units, and the remarks on its unit.

    The unit of the channel map counts, then a scale in it, then the unit that the file ``stated``.
    """
    own, remark = _unit(run, name, stated, channel)
    scale = channel.scale * own
    scaled = values if scale == 1.0 else scale * values
    return (scaled if channel.offset == 0.0 else scaled + channel.offset), remark


def _unit(run: int, name: str, stated: str, channel: Channel) -> tuple[float, list[Remark]]:
    """Factor of the unit, and the remarks where the file and the channel map disagree."""
    mapped = factor(name, channel.unit)
    if not stated:
        return mapped, []
    unit, known = unit_named(stated), UNITS[SI_UNIT[name]]

    def remark(text: str, fix: str = "", **evidence: float) -> list[Remark]:
        return [note(run, name, f"is in {stated} by the file{text}", fix, **evidence)]

    if unit not in known:
        if channel.unit or channel.scale != 1.0 or SI_UNIT[name] == "1":
            return mapped, []
        text = f", which is no unit of this channel: taken as {SI_UNIT[name]}"
        return 1.0, remark(text, f"allowed: {', '.join(known)}; any other by scale")
    own = known[unit]
    if channel.unit is not None:
        text = f", in {channel.unit} by the channel map, which is used"
        return mapped, [] if mapped == own else remark(text, factor=own)
    if abs(channel.scale) == 1.0:
        return own, [] if own == 1.0 else remark(f": multiplied by {own:.9g}", factor=own)
    if abs(abs(channel.scale) / own - 1.0) < EQUAL:
        return 1.0, []
    text = (
        f" (a factor of {own:.9g}); the channel map gives the scale {channel.scale:.9g} and no "
        f"unit, so that the scale alone is used"
    )
    fix = f"to convert the unit as well, channels: {{{name}: {{unit: {unit}}}}}"
    return 1.0, remark(text, fix, factor=own, scale=channel.scale)


def _outlier(run: int, name: str, found: Outliers) -> Remark:
    count, of, first = int(found.rows.sum()), len(found.rows), int(found.rows.argmax())
    key = f"channels: {{{name}: {{missing: "
    text = (
        f"is {found.value:.9g} in {count} of {of} rows, first in row {first + 1}, far from the "
        f"rows around them; all others are within {found.low:.6g} and {found.high:.6g}"
    )
    evidence = {"value": found.value, "rows": count, "of": of, "first_row": first}
    if found.code:
        text = f"{text}: taken as missing"
        fix = f"to state it, {key}[{found.value:.9g}]}}}}; to use them as they are, {key}[]}}}}"
        return loss(run, name, text, fix, **evidence)
    fix = f"if it stands for a missing sample, {key}[{found.value:.9g}]}}}}"
    return note(run, name, f"{text}: an outlier, used as it is", fix, **evidence)


def without_empty(
    run: int, columns: Columns, source: Mapping[str, str]
) -> tuple[Columns, list[Remark]]:
    """The columns without those that are empty by intention, and a remark on their channels; one
    with stamps of its own is a record that was cut short.
    """
    none = {c for c, values in columns.data.items() if not len(values) and c not in columns.clock}
    empty = [name for name, column in source.items() if column in none]
    columns.data = {name: values for name, values in columns.data.items() if name not in none}
    text = "is empty in the file (0 samples): taken as not measured"
    return columns, [loss(run, ", ".join(empty), text)] if empty else []


def without_held(run: int, values: Mapping[str, Array]) -> tuple[dict[str, Array], list[Remark]]:
    """The columns, with NaN in the rows of the force that its logger held, and a remark on them:
    all axes of a sensor, whose noise never stops, have the numbers of the row before again.
    """
    names = [n for n in GROUPS[HELD].columns if n in values]
    if len(names) < HELD_AXES or len({len(values[n]) for n in names}) != 1:
        return dict(values), []
    rows = np.column_stack([values[n] for n in names])
    held = np.r_[False, (rows[1:] == rows[:-1]).all(axis=1)] & (rows != 0.0).any(axis=1)
    for start, end in stretches(held):
        held[start:end] = end - start <= HELD_LONGEST
    if not held.any() or held.mean() > HELD_MOST:
        return dict(values), []
    out = dict(values) | {n: np.where(held, np.nan, values[n]) for n in names}
    text = (
        f"repeats the previous row in {int(held.sum())} of {len(held)} rows on all axes: "
        f"held by the logger, and left out"
    )
    return out, [loss(run, HELD, text, rows=float(held.sum()))]
