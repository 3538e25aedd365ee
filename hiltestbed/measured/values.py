"""Columns of a file as signals of the trace: missing and repeated samples, unit, scale, offset.
Values that stand for a missing sample (-9999, 1e30, 0 ...) and single readings far from all others
are told by the statistics of their own column.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal

import numpy as np
from numpy.typing import NDArray

from hiltestbed.config.dataset import Channel
from hiltestbed.frames import Array
from hiltestbed.measured.columns import Columns
from hiltestbed.measured.noise import MOVED, step_of
from hiltestbed.measured.record import MAX_BRIDGED, MEASURED_GROUPS, stretches
from hiltestbed.measured.remark import Remark, loss, note
from hiltestbed.measured.units import SI_UNIT, UNITS, factor, split_unit, unit_named
from hiltestbed.signals import GROUPS

SAME = Channel()
EQUAL = 1e-3  # relative difference of a scale from a factor that it stands for
SENSED = "wrench_meas"
HELD_AXES = 3  # that must be constant together
HELD_MOST = 0.5  # part of the rows: a source at half the rate of its log repeats every second
HELD_LONGEST = 12  # successive rows; longer constant stretches are a sensor at rest
# Steps to both neighbours of a value, in steps of the rows around it: a curve that turns in a dead
# zone of n rows jumps by n/2 of its steps at either end, and no more rows than MAX_BRIDGED within
# the range of a column are taken for missing ones.
FAR = 5.0
CHANCE = 0.01  # that a reading looks like a mark: by its repetitions and digits
SAMPLED = 500  # values of a column whose digits are counted
SPIKE_ROWS = 2  # rows of a spike, at most


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
    own, remarks = _unit(run, name, stated, channel)
    return channel.scale * own * values + channel.offset, remarks


def _unit(run: int, name: str, stated: str, channel: Channel) -> tuple[float, list[Remark]]:
    """Factor of the unit, and the remarks where the file and the channel map disagree."""
    mapped = factor(name, channel.unit)
    if not stated:
        return mapped, []
    unit, known = unit_named(stated), UNITS[SI_UNIT[name]]

    def remark(text: str, fix: str = "") -> list[Remark]:
        return [note(run, name, f"is in {stated} by the file{text}", fix)]

    if unit not in known:
        if channel.unit or channel.scale != 1.0 or SI_UNIT[name] == "1":
            return mapped, []
        text = f", which is no unit of this channel: taken as {SI_UNIT[name]}"
        return 1.0, remark(text, f"allowed: {', '.join(known)}; any other by scale")
    own = known[unit]
    if channel.unit is not None:
        text = f", in {channel.unit} by the channel map, which is used"
        return mapped, [] if mapped == own else remark(text)
    if abs(channel.scale) == 1.0:
        return own, [] if own == 1.0 else remark(f": multiplied by {own:.9g}")
    if abs(abs(channel.scale) / own - 1.0) < EQUAL:
        return 1.0, []
    text = (
        f" (a factor of {own:.9g}); the channel map gives the scale {channel.scale:.9g} and no "
        f"unit, so that the scale alone is used"
    )
    fix = f"to convert the unit as well, channels: {{{name}: {{unit: {unit}}}}}"
    return 1.0, remark(text, fix)


def _outlier(run: int, name: str, found: Outliers) -> Remark:
    count, of, first = int(found.rows.sum()), len(found.rows), int(found.rows.argmax())
    key = f"channels: {{{name}: {{missing: "
    text = (
        f"is {found.value:.9g} in {count} of {of} rows, first in row {first + 1}, far from the "
        f"rows around them; all others are within {found.low:.6g} and {found.high:.6g}"
    )
    if found.code:
        text = f"{text}: taken as missing"
        fix = f"to state it, {key}[{found.value:.9g}]}}}}; to use them as they are, {key}[]}}}}"
        return loss(run, name, text, fix)
    fix = f"if it stands for a missing sample, {key}[{found.value:.9g}]}}}}"
    return note(run, name, f"{text}: an outlier, used as it is", fix)


def without_held(run: int, values: Mapping[str, Array]) -> tuple[dict[str, Array], list[Remark]]:
    """The columns, with NaN in the rows of a group that its logger held, and remarks on them: all
    its columns have the numbers of the row before again. Noise never does that, nor a motion that
    is not written in steps.
    """
    out, remarks = dict(values), []
    for group in MEASURED_GROUPS:
        names = [n for n in GROUPS[group].columns if n in values]
        if len(names) < HELD_AXES or len({len(values[n]) for n in names}) != 1:
            continue
        rows = np.column_stack([values[n] for n in names])
        known = (column[np.isfinite(column)] for column in rows.T)
        if not any(len(c) and np.ptp(c) > 0.0 and step_of(c) is None for c in known):
            continue  # nothing moves, or all that does in steps
        held = np.r_[False, (rows[1:] == rows[:-1]).all(axis=1)] & (rows != 0.0).any(axis=1)
        for start, end in stretches(held):
            # what is computed or moves may rest at an end, the noise of a sensor never does
            inside = (start > 1 and end < len(held)) or group == SENSED
            held[start:end] = inside and end - start <= HELD_LONGEST
        if not held.any() or held.mean() > HELD_MOST:
            continue
        out |= {n: np.where(held, np.nan, values[n]) for n in names}
        text = (
            f"repeats the previous row in {int(held.sum())} of {len(held)} rows on all axes: "
            f"held by the logger, and left out"
        )
        remarks.append(loss(run, group, text))
    return out, remarks


@dataclass(frozen=True)
class Outliers:
    """What a column holds of a value that is far from the rest.

    Attributes:
        value: as in the file. rows: ``(rows,)`` bool, where it is.
        code: whether it stands for a missing sample: a reading would be repeated as exactly, or
            have as few digits, with a probability of at most :data:`CHANCE`.
        low, high: range of all other values.
    """

    value: float
    rows: NDArray[np.bool_]
    code: bool
    low: float
    high: float


def outliers(values: Array) -> Iterator[Outliers]:
    """The values in ``(rows,)`` that are isolated: a jump leads to them and a jump leads back, far
    beyond the steps of the rows around them and the noise.

    Within the range of the other values at most MAX_BRIDGED successive rows count, since a dead
    zone holds zero for longer. At the ends one jump is enough. The median step of white noise is
    0.95 sigma.
    """
    at = np.flatnonzero(np.isfinite(values))
    x = values[at]
    if not len(x):
        return
    starts = np.flatnonzero(np.r_[True, x[1:] != x[:-1]])
    ends = np.r_[starts[1:], len(x)]
    changes = np.diff(x[starts])  # between stretches of equal values, as a logger may hold
    if not len(changes):
        return
    steps = np.abs(changes)
    jumps = np.minimum(np.r_[np.inf, steps], np.r_[steps, np.inf])
    back = np.r_[True, changes[1:] * changes[:-1] < 0.0, True]
    back &= jumps > np.r_[0.0, np.abs(changes[1:] + changes[:-1]), 0.0]
    found: dict[float, list[tuple[int, int]]] = {}
    for k in np.flatnonzero(back & (jumps > MOVED * np.median(steps))):
        around = np.r_[steps[max(0, k - 4) : max(0, k - 1)], steps[k + 1 : k + 4]]
        if len(around) and jumps[k] > FAR * np.median(around):
            found.setdefault(float(x[starts[k]]), []).append((int(starts[k]), int(ends[k])))
    count = sum(map(len, found.values()))
    for value, runs in found.items():
        yield from _judged(value, runs, count, values, at)


def _judged(
    value: float, runs: list[tuple[int, int]], count: int, values: Array, at: NDArray[np.intp]
) -> Iterator[Outliers]:
    """What is said of one of ``count`` isolated stretches, if anything."""
    x = values[at]
    rest = x[x != value]
    low, high = float(rest.min()), float(rest.max())
    away = max(low - value, value - high)
    if away <= 0.0:  # within the range of the others
        # jumps as large are part of a column that a converter or a controller moves in steps; the
        # smaller one of two is rarer than half of the chance
        rare = 1.0 - 0.5 * CHANCE
        usual = float(np.quantile(np.abs(np.diff(rest)), rare)) if len(rest) > 1 else 0.0
        jumps = np.r_[np.inf, np.abs(np.diff(x)), np.inf]  # to each row, and from the last
        runs = [(a, b) for a, b in runs if b - a <= MAX_BRIDGED and min(jumps[a], jumps[b]) > usual]
    elif len(rest) < 0.5 * len(x):
        return
    if not runs:
        return
    lengths = [end - start for start, end in runs]
    code = _chance(value, lengths, count, rest) <= CHANCE
    if not code and not (max(lengths) <= SPIKE_ROWS and away > high - low):
        return
    rows = values == value if away > 0.0 else np.zeros(len(values), dtype=bool)
    for start, end in runs:
        rows[at[start:end]] = True
    yield Outliers(value, rows, code, low, high)


def _chance(value: float, lengths: list[int], count: int, rest: Array) -> float:
    """Probability that isolated readings of a column agree, last and are as short by chance."""
    many = len(lengths)
    agree = math.comb(count, many) * float(len(np.unique(rest))) ** (1 - many)
    held = float(np.mean(rest[1:] == rest[:-1])) ** (sum(lengths) - many) if len(rest) > 1 else 1.0
    written, own = _written(rest[:: max(1, len(rest) // SAMPLED)]), _written(np.array([value]))
    # shorter by decimal places if most have as many, as of a fixed format, else by all digits
    kind = 0 if np.subtract(*np.quantile(written[0], (0.75, 0.25))) < 1.0 else 1
    return agree * held * 10.0 ** -max(0.0, float(np.median(written[kind]) - own[kind][0]))


def _written(values: Array) -> tuple[Array, Array]:
    """Decimal places and significant digits of each value, of single precision if it is."""
    with np.errstate(over="ignore"):
        single = values.astype(np.float32)
    texts = [repr(float(v)) if float(f) != float(v) else str(f)
             for v, f in zip(values, single, strict=True)]  # fmt: skip
    parts = [Decimal(text).normalize().as_tuple() for text in texts]
    places = [max(0, -p.exponent) if isinstance(p.exponent, int) else 0 for p in parts]
    digits = [len(p.digits) if any(p.digits) else 0 for p in parts]
    return np.array(places, dtype=np.float64), np.array(digits, dtype=np.float64)


def declared(values: Array, missing: tuple[float, ...]) -> NDArray[np.bool_]:
    """``(rows,)``: where a column has one of the values that stand for a missing sample; equal as
    single-precision numbers, in which a file may hold what a user writes in decimal.
    """
    with np.errstate(over="ignore"):
        single = values.astype(np.float32)
        marks = np.array(missing, dtype=np.float32)
    return np.isin(single, marks[np.isfinite(marks)]) | np.isin(values, missing)
