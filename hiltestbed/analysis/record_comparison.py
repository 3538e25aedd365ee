"""Two records of a rig, from this simulator or any other: aligned in time, and the delay of each
signal with the damping that it is worth, -k tau.

For two records a and b of one signal, b(t) = g a(t - tau) + o with a gain g and an offset o. The
peak of the cross-correlation of the slopes gives tau to a sample; about it the squares of the
residual are minimised, a interpolated by a cubic spline. Both are smoothed alike first:
interpolation averages noise, most of all between two samples, and would pull tau there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import minimize_scalar
from scipy.signal import correlate

from hiltestbed.config.dataset import Channel, load_dataset
from hiltestbed.errors import Fault, InputError
from hiltestbed.frames import Array
from hiltestbed.measured.formats import read_columns
from hiltestbed.measured.values import SAME, in_si, signal
from hiltestbed.run_folder.store import SUMMARY, read_run
from hiltestbed.signals import GROUPS

GROUPS_READ = ("pose_cmd", "pose_act", "wrench_true", "wrench_meas", "wrench_comp")
PAIRS = (  # links of the loop within one record: where the signal comes from, and where it goes
    ("pose_cmd", "pose_act", "platform"),
    ("wrench_true", "wrench_meas", "sensor"),
    ("wrench_meas", "wrench_comp", "compensation"),
)
AXES = ("x", "y", "z")
SAME_SIGNAL = 0.5  # share of the variance that must be explained: half
UNSHARP = 1e-3  # [s] of the clocks' offset: the least delay of a force sensor on such a rig
TOUCHES = 0.1  # of the peak force, above which a row counts as in contact
SMOOTH = 2.0  # samples, standard deviation: leaves 6 % of the variance of white noise at a sample
FEWEST = 32  # samples in common


@dataclass(frozen=True)
class Shift:
    """How much later b is than a.

    Attributes:
        delay: tau [s]. sd: its standard deviation [s], from the residual and its correlation from
            sample to sample. gain, offset: g and o. explained: share of b's variance that a
            explains; below a half the two are not one signal.
    """

    delay: float
    sd: float
    gain: float
    offset: float
    explained: float


@dataclass(frozen=True)
class MeasuredDelay:
    """A delay [s] with its standard deviation [s]; ``damping``: -k tau [N s/m], None without k."""

    what: str
    delay: float
    sd: float
    damping: float | None


@dataclass(frozen=True)
class RecordComparison:
    """Two records, aligned.

    Attributes:
        names: of the records. axis: along which they are compared. stiffness: k [N/m], None if
            neither given nor shown. clock: what B's clock shows more than A's at the same instant
            of the signal ``aligned_by`` [s].
        between: delay of each signal of B after that of A, once aligned. within: delays of the
            links within each record.
    """

    names: tuple[str, str]
    axis: str
    stiffness: float | None
    aligned_by: str
    clock: Shift
    between: tuple[MeasuredDelay, ...]
    within: tuple[MeasuredDelay, ...]

    def to_json(self) -> dict[str, Any]:
        """SI units."""
        return {
            "records": list(self.names),
            "axis": self.axis,
            "stiffness": self.stiffness,
            "aligned_by": self.aligned_by,
            "clock_offset": self.clock.delay,
            "clock_offset_sd": self.clock.sd,
            "between": [vars(delay) for delay in self.between],
            "within": [vars(delay) for delay in self.within],
        }

    @property
    def sentence(self) -> str:
        """How the records were aligned, and the stiffness with which a delay is damping."""
        k = "unknown: give --k" if self.stiffness is None else f"{self.stiffness:.4g} N/m"
        differ = (
            " The motions differ, so that only the delays within each record are sharp."
            if self.clock.sd > UNSHARP
            else ""
        )
        return (
            f"Aligned by {self.aligned_by}: B's clock shows {1e3 * self.clock.delay:+.4f} ms "
            f"(± {1e3 * self.clock.sd:.4f}) more than A's. Along {self.axis}; stiffness "
            f"{k}.{differ}"
        )

    def rows(self) -> list[tuple[str, ...]]:
        """Cells: delay, its standard deviation, and its worth as damping."""
        return [
            (
                delay.what,
                f"{1e3 * delay.delay:+.4f}",
                f"{1e3 * delay.sd:.4f}",
                "-" if delay.damping is None else f"{delay.damping:+.2f}",
            )
            for delay in (*self.within, *self.between)
        ]


HEADER = ("what is late", "delay [ms]", "± sd [ms]", "as damping [N s/m]")


def compare_records(
    records: Sequence[Path],
    channels: Path | None = None,
    align: str | None = None,
    stiffness: float | None = None,
) -> RecordComparison:
    """Align two records and list their delays.

    Args:
        records: two run folders or data files. channels: a dataset file, whose channel map tells
            the columns of the data files. align: signal by which the clocks are aligned, such as
            pose_cmd.pz; left out: the first that both have of pose_cmd, pose_act, wrench_meas.
            stiffness: k [N/m]; left out: that which A shows in its contact.

    Raises:
        InputError: not two records, one without usable columns, or nothing in common that moves.
    """
    if len(records) != 2:
        raise InputError(f"compare: foreign records are compared by two (got {len(records)})")
    dataset = None if channels is None else load_dataset(channels)
    mapped = {} if dataset is None else dataset.spec.channels or {}
    tick = None if dataset is None else dataset.nominal.tick
    a, b = (_read(path, mapped, tick) for path in records)
    axis = _axis(a)
    common = [f"{g}.{axis}" for g in GROUPS_READ if f"{g}.{axis}" in a and f"{g}.{axis}" in b]
    shifts = {n: found for n in common if (found := _shift(a, n, b, n)) is not None}
    by = f"{align.rpartition('.')[0]}.{align[-1]}" if align else next(iter(shifts), "")
    if by not in shifts:
        raise InputError(
            f"compare: {align or 'no signal'} does not move alike in both records along {axis}; "
            f"allowed: {', '.join(map(_column, shifts)) or 'none: map their columns (--channels)'}"
        )
    k = stiffness if stiffness is not None else _stiffness(a, axis)
    clock = shifts[by]
    between = tuple(
        _delay(f"{_column(n)}: B after A", s.delay - clock.delay, math.hypot(s.sd, clock.sd), k)
        for n, s in shifts.items()
        if n != by
    )
    within = tuple(
        _delay(
            f"{label}: {link} ({_column(f'{source}.{axis}')} to {_column(f'{out}.{axis}')})",
            s.delay,
            s.sd,
            k,
        )
        for label, record in (("A", a), ("B", b))
        for source, out, link in PAIRS
        if (s := _shift(record, f"{source}.{axis}", record, f"{out}.{axis}")) is not None
    )
    names = (str(records[0]), str(records[1]))
    return RecordComparison(names, axis, k, _column(by), clock, between, within)


def _delay(what: str, delay: float, sd: float, k: float | None) -> MeasuredDelay:
    return MeasuredDelay(what, delay, sd, None if k is None else -k * delay)


Record = dict[str, tuple[Array, Array]]  # group.axis to its times [s] and values


def is_run(path: Path) -> bool:
    """Whether ``path`` is a run folder."""
    return (path / SUMMARY).is_file()


def _column(name: str) -> str:
    """The column of the trace: `pose_act.z` is pose_act.pz."""
    group, _, axis = name.partition(".")
    return f"{group}.{'p' if group.startswith('pose') else 'f'}{axis}"


def _read(path: Path, channels: Mapping[str, Channel], tick: float | None) -> Record:
    if is_run(path):
        trace = read_run(path).trace
        if trace is None:
            raise InputError(f"{path}: has no trace; run the scenario again")
        found = {
            name: (trace.t, trace[_column(name)])
            for group in GROUPS_READ
            for axis in AXES
            if not np.isnan(trace[_column(name := f"{group}.{axis}")]).all()
        }
        return _ends(found)
    names = [f"{group}.{axis}" for group in GROUPS_READ for axis in AXES]
    source = {n: channels.get(_column(n), SAME).column or _column(n) for n in names}
    time = channels.get("t", SAME).column or "t"
    columns = read_columns(path, frozenset({*source.values(), time}))
    found = {}
    for name, column in source.items():
        if column not in columns.data:
            continue
        t = columns.clock.get(column)
        if t is None:
            if time not in columns.data:
                what = (
                    f"no column {time!r} of times; {columns.nearest([time])}; name it in "
                    f"--channels DATASET, channels: {{t: {{column: ...}}}}"
                )
                raise InputError(Fault(str(path), None, None, "t", what))
            t, _ = in_si(0, "t", columns.data[time], "", channels.get("t", SAME))
        values, _ = signal(0, _column(name), column, columns, channels.get(_column(name), SAME), ())
        good = np.isfinite(values) & np.isfinite(t)
        t, order = np.unique(t[good], return_index=True)
        if len(t) > 1:
            found[name] = (t, values[good][order])
    if not found:
        what = (
            f"holds none of the columns {', '.join(f'{g}.*' for g in GROUPS_READ)} "
            f"({columns.nearest(['pose_act'])}); map them with --channels DATASET, as "
            "`hiltestbed new NAME --from LOG` writes it"
        )
        raise InputError(Fault(str(path), None, None, "channels", what))
    return _ends(found, tick)


def _ends(record: Record, tick: float | None = None) -> Record:
    """The record with each command at the end of the tick in whose row it stands, as in a trace;
    ``tick`` [s]: left out, that of the rows.
    """
    for name, (t, values) in record.items():
        if name.startswith("pose_cmd"):
            record[name] = (t + (float(np.median(np.diff(t))) if tick is None else tick), values)
    return record


def _axis(record: Record) -> str:
    """The axis of the largest force, or without one of the largest motion."""
    for group in ("wrench_meas", "wrench_comp", "pose_act", "pose_cmd"):
        spans = {
            x: float(np.ptp(record[f"{group}.{x}"][1])) for x in AXES if f"{group}.{x}" in record
        }
        if spans and max(spans.values()) > 0.0:
            return max(spans, key=lambda x: spans[x])
    return "z"


def _shift(a: Record, first: str, b: Record, second: str) -> Shift | None:
    if first not in a or second not in b:
        return None
    found = shift_between(*a[first], *b[second])
    return found if found is not None and found.explained >= SAME_SIGNAL else None


def _stiffness(record: Record, axis: str) -> float | None:
    """[N/m] k of F = k x + c v + b, by least squares over the rows in contact."""
    force, pose = (record.get(f"{group}.{axis}") for group in ("wrench_meas", "pose_act"))
    if force is None or pose is None:
        return None
    t, f = force
    x = np.interp(t, *pose)
    touching = np.abs(f) > TOUCHES * np.abs(f).max()
    if touching.sum() < len(GROUPS):
        return None
    columns = np.column_stack([x, np.gradient(x, t), np.ones(len(t))])[touching]
    found, *_ = np.linalg.lstsq(columns, f[touching], rcond=None)
    return float(found[0]) if found[0] > 0.0 else None


def shift_between(t_a: Array, a: Array, t_b: Array, b: Array) -> Shift | None:
    """The delay of ``b`` (m,) at ``t_b`` (m,) [s] after ``a`` (n,) at ``t_a`` (n,) [s], which may
    have other rates and clocks; None if one does not move, or too little is in common.
    """
    step = float(max(np.median(np.diff(t_a)), np.median(np.diff(t_b))))
    first, second = _even(t_a, a, step), _even(t_b, b, step)
    slopes = [np.diff(part) for part in (first, second)]
    if min(map(len, slopes)) < FEWEST or any(not np.ptp(part) > 0.0 for part in (first, second)):
        return None
    slopes = [part - part.mean() for part in slopes]
    lag = int(np.argmax(np.abs(correlate(slopes[1], slopes[0])))) - (len(slopes[0]) - 1)
    spline = CubicSpline(step * np.arange(len(first)), first)
    times = step * np.arange(len(second))

    def fitted(delay: float) -> tuple[float, Array, Array, Array]:
        seen = (times >= delay) & (times <= delay + step * (len(first) - 1))
        columns = np.column_stack([spline(times[seen] - delay), np.ones(int(seen.sum()))])
        if len(columns) < FEWEST:
            return np.inf, np.zeros(2), columns, np.zeros(0)
        found: Array = np.linalg.lstsq(columns, second[seen], rcond=None)[0].astype(np.float64)
        rest = second[seen] - columns @ found
        return float(np.mean(rest**2)), found, columns, rest

    # the correlation favours lags at which more of both overlaps: the search may go beyond a sample
    around = (step * (lag - 0.5), step * (lag + 0.5))
    best: Any = minimize_scalar(lambda d: fitted(d)[0], bracket=around)
    delay = float(best.x)
    square, found, columns, rest = fitted(delay)
    if not np.isfinite(square):
        return None
    total = float(np.var(rest + columns @ found))
    slope = np.gradient(columns[:, 0], step) * found[0]
    slope = slope - columns @ np.linalg.lstsq(columns, slope, rcond=None)[0]
    near = float(rest[1:] @ rest[:-1] / max(rest @ rest, 1e-300))
    wider = np.sqrt((1.0 + min(near, 0.999)) / (1.0 - min(near, 0.999)))
    sd = wider * np.sqrt(square / max(float(slope @ slope), 1e-300))
    explained = 1.0 - square / total if total > 0.0 else 0.0
    late = delay + float(t_b[0] - t_a[0])
    return Shift(late, float(sd), float(found[0]), float(found[1]), explained)


def _even(t: Array, values: Array, step: float) -> Array:
    """The values every ``step`` [s] from the first on, smoothed over :data:`SMOOTH` steps."""
    known = np.isfinite(values)
    if known.sum() < 2:
        return np.zeros(0)
    times = np.arange(t[0], t[-1] + 0.5 * step, step)
    # samples that are closer than the step are averaged, so as not to fold their noise
    own = float(np.median(np.diff(t)))
    finer = gaussian_filter1d(values[known], SMOOTH * step / own)
    within = np.clip(times, t[known][0], t[known][-1])
    return np.asarray(CubicSpline(t[known], finer)(within), dtype=np.float64)
